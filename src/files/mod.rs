//! File handling: checked file names, limited reads of regular files, atomic writes, outputs that replace
//! only files of earlier runs and none of their inputs, and escaping of text from data in messages.

pub mod input;
mod inputs;
pub mod json;
mod lock;
mod manifest;
mod mounts;
mod name;
mod output;
mod output_file;
mod pending;
mod place;
mod resolved;
mod shared_folder;
pub(crate) mod sniff;
pub mod text;
mod whole;
mod whole_folder;
mod work;

pub use inputs::Inputs;
pub use lock::lacks_locks;
pub use manifest::{FILES as LISTED_FILES, is_below};
pub(crate) use name::first_twice;
pub use name::{FileName, NameError};
pub use output::{OutputFolder, check_place, own_folder, resolved_output};
pub(crate) use output::{SKELETON, TEMPLATES};
pub use output_file::{FileKind, OutputFile};
pub use pending::remove_pending;
pub use resolved::{is_inside, is_one_file, resolved};
pub use shared_folder::SharedFolder;
pub use whole::{write_json, write_whole};
pub use whole_folder::{WholeFolder, check_whole};
pub(crate) use whole_folder::{inputs_of_whole, work_of_whole, write_whole_by};
pub use work::WorkFolder;
