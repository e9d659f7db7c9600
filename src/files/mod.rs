//! Files: names that become paths, what may be read, and text from data in messages.

pub mod input;
mod name;
pub mod text;

pub use name::{FileName, NameError, first_twice};
