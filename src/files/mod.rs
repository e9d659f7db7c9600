//! File handling: checked file names, limited reads of regular files, atomic writes, outputs that replace
//! only files of earlier runs and none of their inputs, and escaping of text from data in messages.

mod checksum;
pub mod input;
mod inputs;
pub mod json;
mod lock;
mod name;
mod output;
mod resolved;
pub(crate) mod sniff;
pub mod text;

pub use checksum::Checksum;
pub(crate) use checksum::Hasher;
pub use inputs::Inputs;
pub use lock::lacks_locks;
pub(crate) use name::first_twice;
pub use name::{FileName, NameError};
pub use output::manifest::{FILES as LISTED_FILES, is_below};
pub(crate) use output::mounts::free_bytes;
pub use output::output_file::{FileKind, OutputFile};
pub use output::pending::remove_pending;
pub use output::shared_folder::SharedFolder;
pub use output::whole::{write_json, write_whole};
pub use output::whole_folder::{WholeFolder, check_whole};
pub(crate) use output::whole_folder::{inputs_of_whole, work_of_whole, write_whole_by};
pub use output::work::WorkFolder;
pub use output::{OutputFolder, check_place, own_folder, resolved_output};
pub(crate) use output::{SKELETON, TEMPLATES};
pub use resolved::{is_inside, is_one_file, resolved};
