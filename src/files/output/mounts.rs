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

/// Returns the free space for files of this user where a path is or will be, bytes; `None` if it is unknown.
pub(crate) fn free_bytes(path: &Path) -> Option<u64> {
    let existing = path.ancestors().map(|path| path.join(".")).find(|path| path.is_dir())?;
    let found = rustix::fs::statvfs(existing).ok()?;
    Some(found.f_bavail.saturating_mul(found.f_frsize))
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
    fn free_space_is_that_of_the_file_system() {
        let folder = tempfile::tempdir().unwrap();
        let free = free_bytes(folder.path()).unwrap();
        assert!(free > 0 && free_bytes(&folder.path().join("a/b")).unwrap().abs_diff(free) < 8 << 30);
        assert!(free_bytes(Path::new("none")).is_some() && free_bytes(Path::new("/proc/none")) == Some(0));
    }

    #[test]
    fn ordinary_folders_are_not_mounted() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!is_mounted(&folder.path().join("none")) && !is_mounted(folder.path()));
        assert!(is_mounted(Path::new("/proc")) && !is_beside_read_only(folder.path()));
        assert!(!is_beside_read_only(&folder.path().join("none/of/these")));
    }
}
