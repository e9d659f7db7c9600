//! The Python extension `pskel._pskel`: logs, skeletons, the renderer, simulations and the generator loop.
//!
//! # How it works
//! Every class wraps one type of the library and adds no behavior of its own. Calls that read files, wait for
//! the device or simulate release the interpreter lock (`pool`). Errors of the library become subclasses of
//! `pskel.Error` with the same text; invalid arguments become `ValueError`. Maps are NumPy arrays over all
//! cameras (`maps`). Functions with many keyword arguments receive them by name (`keywords`). Only `command`
//! uses the crate of the command.

mod build;
mod captions;
mod command;
mod error;
mod export;
mod fill;
mod generator;
mod keywords;
mod log;
mod maps;
mod pool;
mod renderer;
mod scene;
mod scores;
mod simulation;
mod skeleton;
mod splat;
mod time;

use mimalloc::MiMalloc;
use pyo3::prelude::pymodule;

/// As in the command: the default allocator returns the memory of every frame's maps to the system, and page
/// faults cost more than the copy.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

#[pymodule]
mod _pskel {
    #[pymodule_export]
    use crate::build::build;
    #[pymodule_export]
    use crate::captions::Captions;
    #[pymodule_export]
    use crate::command::run_command;
    #[pymodule_export]
    use crate::error::{BuildError, Error, LogError, RenderError, SimulationError};
    #[pymodule_export]
    use crate::export::Export;
    #[pymodule_export]
    use crate::fill::fill_holes;
    #[pymodule_export]
    use crate::generator::Generator;
    #[pymodule_export]
    use crate::log::{Log, Scenes};
    #[pymodule_export]
    use crate::maps::lidar::lidar_spec;
    #[pymodule_export]
    use crate::renderer::{Frames, Renderer};
    #[pymodule_export]
    use crate::scene::{Actor, Camera, Scene};
    #[pymodule_export]
    use crate::scores::score_plans;
    #[pymodule_export]
    use crate::simulation::Simulation;
    #[pymodule_export]
    use crate::simulation::roll::ResetAndRoll;
    #[pymodule_export]
    use crate::skeleton::Skeleton;
    #[pymodule_export]
    use crate::splat::splat;
    #[pymodule_export]
    use crate::time::{Committed, Forecast};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::pool::imported();
        crate::log::register_formats();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
