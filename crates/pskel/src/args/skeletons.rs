//! Skeletons of logs.

use std::path::Path;

use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::skeleton::Skeleton;

use crate::warn;

/// Opens a skeleton as [`Skeleton::open_for`], and warns if it was built from another recording of the same
/// name.
///
/// # Errors
/// Fails as [`Skeleton::open_for`], or if the list of its files cannot be read.
pub(crate) fn open_for(path: &Path, log: &Recording) -> Result<Skeleton, FileError> {
    let skeleton = Skeleton::open_for(path, log)?;
    if skeleton.is_of(log)? == Some(false) {
        warn(&format!(
            "the skeleton was built from another recording or state of the name {}: other frames, poses, \
                cameras, files, categories or boxes: {}",
            log.shown_name(),
            path.display()
        ));
    }
    Ok(skeleton)
}
