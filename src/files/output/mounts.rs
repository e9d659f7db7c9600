//! Paths that cannot be renamed, or have nothing beside them.

use std::io::{Error, ErrorKind};
use std::path::Path;

use rustix::fs::{Access, AtFlags, CWD, StatxAttributes, StatxFlags, statx};

/// Returns whether a path is the root of a mount, like the volume of a container: it cannot be renamed, and
/// what is beside it is on another file system.
pub(in super::super) fn is_mounted(path: &Path) -> bool {
    let found = statx(CWD, path, AtFlags::SYMLINK_NOFOLLOW, StatxFlags::empty());
    found.is_ok_and(|found| found.stx_attributes.contains(StatxAttributes::MOUNT_ROOT))
}

/// Returns whether nothing can be created beside a path, for instance because a container's own files are
/// read-only.
pub(in super::super) fn is_beside_read_only(path: &Path) -> bool {
    let found = rustix::fs::access(parent(path), Access::WRITE_OK | Access::EXEC_OK);
    found.is_err_and(|error| error != rustix::io::Errno::NOENT)
}

/// Returns the folder that a path is in; `.` for a name alone.
pub(in super::super) fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Returns whether an error of a rename says that the path itself cannot be renamed or replaced by a rename.
pub(in super::super) fn is_fixed(error: &Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::CrossesDevices
            | ErrorKind::ResourceBusy
            | ErrorKind::PermissionDenied
            | ErrorKind::ReadOnlyFilesystem
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ordinary_folders_are_not_mounted() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!is_mounted(&folder.path().join("none")) && !is_mounted(folder.path()));
        assert!(is_mounted(Path::new("/proc")) && !is_beside_read_only(folder.path()));
        assert!(!is_beside_read_only(&folder.path().join("none/of/these")));
    }
}
