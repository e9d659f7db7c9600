//! The Python extension `pskel._pskel`: logs, skeletons and the renderer, with maps as NumPy arrays.
//!
//! # How it works
//! Every class wraps one type of the library and adds no behavior of its own. Calls that read files or wait for the
//! device release the interpreter lock. Errors of the library become subclasses of `pskel.Error` with the same text.

mod arrays;
mod command;
mod error;
mod log;
mod renderer;
mod skeleton;
mod splat;
mod state;

use pyo3::prelude::pymodule;

#[pymodule]
mod _pskel {
    #[pymodule_export]
    use crate::command::run_command;
    #[pymodule_export]
    use crate::error::{BuildError, Error, LogError, RenderError};
    #[pymodule_export]
    use crate::log::Log;
    #[pymodule_export]
    use crate::renderer::Renderer;
    #[pymodule_export]
    use crate::skeleton::{Skeleton, build};
    #[pymodule_export]
    use crate::splat::splat;
    #[pymodule_export]
    use crate::state::State;
}
