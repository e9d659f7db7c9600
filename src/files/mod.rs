//! File handling: checked file names, limited reads of regular files, atomic writes, output folders that replace only
//! files of earlier runs, and escaping of text from data in messages.

mod check;
pub mod input;
pub mod json;
mod lock;
mod manifest;
mod name;
mod output;
mod pending;
pub(crate) mod sniff;
pub mod text;
mod whole;
mod work;

pub use check::{check_destination, check_output_file, check_outside};
pub(crate) use name::first_twice;
pub use name::{FileName, NameError};
pub use output::resolved_output;
pub use output::{OutputFolder, WholeFolder, check_whole};
pub(crate) use output::{work_of_whole, write_whole_by};
pub use pending::remove_pending;
pub use whole::{write_json, write_whole};
pub use work::WorkFolder;
