//! Files that are written: whole files, output folders that replace only what earlier runs wrote, temporary names.

mod lock;
mod manifest;
mod output;
mod pending;
mod whole;
mod work;

pub use output::{OutputFolder, WholeFolder, check_whole};
pub(crate) use output::{work_of_whole, write_whole_by};
pub use pending::remove_pending;
pub use whole::{check_output_file, write_json, write_whole};
pub(crate) use work::WorkFolder;
