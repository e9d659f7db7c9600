//! Outputs that are single files: checked before any work, against everything that the command reads.

use std::io::{BufWriter, ErrorKind, Read};
use std::path::{Path, PathBuf};

use rustix::fs::{Access, access};

use super::check_above;
use super::manifest::Manifest;
use super::mounts::parent;
use super::whole::{created_at, target, write_json, write_whole};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::files::resolved::is_inside;
use crate::files::{Inputs, SharedFolder};

/// Length of the beginning that identifies the kind of a file, bytes.
const HEAD: u64 = 4096;

/// Kind of an output file, recognized by its beginning. Only files of the same kind are replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileKind {
    /// Description for messages, with an article.
    pub name: &'static str,
    /// Bytes with which every file of the kind begins.
    pub begin: &'static [u8],
    /// Byte sequences; at least one follows within the first 4096 bytes. Empty if the beginning is enough.
    pub marks: &'static [&'static [u8]],
}

/// A file to write. It replaces nothing except an empty file or one of its kind, and is no part of the
/// command's inputs or of another output. Links are followed, also to a file that does not exist yet.
#[derive(Clone, Debug)]
pub struct OutputFile {
    path: PathBuf,
    kind: FileKind,
}

impl OutputFile {
    /// Checks, before any work, that a file may be written.
    ///
    /// # Errors
    /// Fails if the file is one of the inputs or below one, if it belongs to another output or is in a
    /// skeleton or a template library, if a file of another kind, a folder or a device is there, if its
    /// folder does not exist, or if it cannot be written there.
    pub fn open(path: &Path, kind: FileKind, inputs: &Inputs) -> Result<Self, FileError> {
        let path = if path.exists() { path.to_owned() } else { created_at(path) };
        inputs.check_same(&path)?;
        check_other_outputs(&path)?;
        inputs.check_outside(&path)?;
        check_name(&path)?;
        check_above(&path)?;
        check_parent(&path)?;
        kind.check(&path)?;
        check_writable(&path)?;
        Ok(Self { path, kind })
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that a file is outside a folder that the same run writes, whose files could replace it.
    ///
    /// # Errors
    /// Fails if it is in the folder.
    pub fn check_outside(path: &Path, folder: &Path) -> Result<(), FileError> {
        if !is_inside(path, folder) {
            return Ok(());
        }
        let expected = format!("a file outside of the output {}", folder.display());
        Err(FileError::content(expected, "one in it", path))
    }

    /// Writes the file with [`write_whole`].
    ///
    /// # Errors
    /// Returns any error of `fill`. Fails if a file of another kind has appeared since, or on an I/O error.
    pub fn write<E: From<FileError>>(
        &self,
        fill: impl FnOnce(&mut BufWriter<&mut std::fs::File>) -> Result<(), E>,
    ) -> Result<(), E> {
        self.kind.check(&self.path)?;
        write_whole(&self.path, fill)
    }

    /// Writes a value as JSON.
    ///
    /// # Errors
    /// Fails as [`Self::write`].
    pub fn write_json(&self, value: &impl serde::Serialize) -> Result<(), FileError> {
        self.kind.check(&self.path)?;
        write_json(&self.path, value)
    }
}

impl FileKind {
    /// Checks that a path is free, or has an empty file or one of this kind.
    ///
    /// # Errors
    /// Fails if anything else is there, or if it cannot be read.
    pub fn check(&self, path: &Path) -> Result<(), FileError> {
        if !target(path)?.is_file() {
            return Ok(());
        }
        let (file, _) = open_regular(path)?;
        let mut head = Vec::new();
        file.take(HEAD).read_to_end(&mut head).map_err(FileError::io("read", path))?;
        let rest = head.strip_prefix(self.begin);
        let has = |rest: &[u8], mark: &[u8]| rest.windows(mark.len()).any(|part| part == mark);
        let is_marked = |rest: &[u8]| self.marks.is_empty() || self.marks.iter().any(|mark| has(rest, mark));
        if head.is_empty() || rest.is_some_and(is_marked) {
            return Ok(());
        }
        let expected = format!("{} to replace, or none", self.name);
        Err(FileError::content(expected, "another file", path))
    }
}

/// Checks that a file that exists is not listed in an output folder.
fn check_other_outputs(path: &Path) -> Result<(), FileError> {
    if !path.exists() {
        return Ok(());
    }
    let absolute = path.canonicalize().map_err(FileError::io("read", path))?;
    let part = |found: String| FileError::content("a file that is no part of another output", found, path);
    for folder in absolute.ancestors().skip(1) {
        // It has a record per shard instead of one list.
        if SharedFolder::is_at(folder) {
            return Err(part(format!("one of the export {}", folder.display())));
        }
        let Some(manifest) = Manifest::read(folder)? else { continue };
        if absolute.strip_prefix(folder).is_ok_and(|name| manifest.holds(name)) {
            return Err(part(format!("one of {} in {}", manifest.kind, folder.display())));
        }
    }
    Ok(())
}

/// Checks that a path ends with the name of a file, which is not too long.
fn check_name(path: &Path) -> Result<(), FileError> {
    let text = path.as_os_str().as_encoded_bytes();
    let is_unnamed = text.is_empty() || [b"/".as_slice(), b"/."].iter().any(|end| text.ends_with(end));
    // Folders that exist are refused by `FileKind::check`.
    if is_unnamed && !path.is_dir() {
        return Err(FileError::content("the path of a file", "one that ends without a name", path));
    }
    match path.symlink_metadata() {
        Ok(about) if about.is_symlink() && !path.exists() => {
            Err(FileError::content("a file or none", "a link that leads in a circle", path))
        }
        Err(error) if error.kind() == ErrorKind::InvalidFilename => Err(FileError::io("write", path)(error)),
        _ => Ok(()),
    }
}

/// Checks that a file can be created in its folder, or that an existing one can be written to. A link counts
/// as the file to which it leads.
fn check_writable(path: &Path) -> Result<(), FileError> {
    let place = target(path)?;
    match access(parent(&place), Access::WRITE_OK | Access::EXEC_OK) {
        Err(error) if access(&place, Access::WRITE_OK).is_err() => {
            Err(FileError::io("write", path)(error.into()))
        }
        _ => Ok(()),
    }
}

/// Checks that the folder of a file exists.
fn check_parent(path: &Path) -> Result<(), FileError> {
    let folder = parent(path);
    match folder.metadata() {
        Ok(data) if data.is_dir() => Ok(()),
        Ok(_) => Err(FileError::content("a file in a folder", "another file in its place", folder)),
        Err(error) => Err(FileError::io("read", folder)(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KIND: FileKind = FileKind { name: "a report", begin: b"{\n  \"seed\":", marks: &[b"7"] };

    #[test]
    fn only_files_of_the_same_kind_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for (name, text) in
            [("empty", ""), ("own", "{\n  \"seed\": 7}"), ("table", "[\n{\"seed\": 7}]"), ("short", "{")]
        {
            std::fs::write(at(name), text).unwrap();
        }
        std::os::unix::fs::symlink(at("table"), at("link")).unwrap();
        let open = |name: &str| OutputFile::open(&at(name), KIND, &Inputs::default());
        for name in ["new", "empty", "own"] {
            assert_eq!(open(name).unwrap().path(), at(name));
        }
        for name in ["table", "short", "link"] {
            let message = open(name).unwrap_err().to_string();
            assert!(
                message.starts_with("expected a report to replace, or none, found another file: "),
                "{message}"
            );
        }
        for (name, expected) in [
            ("none/new", "cannot read"),
            ("own/new", "expected a file in a folder"),
            (".", "expected a regular file or none, found a folder"),
        ] {
            let message = open(name).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let long = "a".repeat(256);
        for (name, expected) in [
            ("new/", "expected the path of a file, found one that ends without a name"),
            ("new/.", "expected the path of a file"),
            (long.as_str(), "cannot write: File name too long"),
        ] {
            let message = open(name).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        // A file that appears during the work.
        let file = open("new").unwrap();
        std::fs::write(at("new"), "mine").unwrap();
        assert!(file.write_json(&1).is_err());
        assert_eq!(std::fs::read(at("new")).unwrap(), b"mine");
    }

    #[test]
    fn files_of_an_export_are_parts_of_an_output() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("shards")).unwrap();
        for name in ["export.json", "a.json"] {
            std::fs::write(folder.path().join(name), "{\n  \"seed\": 7}").unwrap();
        }
        let open = |name: &str| OutputFile::open(&folder.path().join(name), KIND, &Inputs::default());
        let message = open("a.json").unwrap_err().to_string();
        assert!(message.contains("no part of another output, found one of the export "), "{message}");
        open("new.json").unwrap();
    }

    #[test]
    fn links_may_target_files_that_do_not_exist_yet() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["disk", "log"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        for (target, link) in [
            ("disk/new", "a"),
            ("a", "b"),
            ("log/new", "in-log"),
            ("none/new", "nowhere"),
            ("circle", "circle"),
        ] {
            std::os::unix::fs::symlink(target, at(link)).unwrap();
        }
        let open = |name: &str| OutputFile::open(&at(name), KIND, &Inputs::new([at("log")]));
        for _ in 0..2 {
            open("b").unwrap().write_json(&serde_json::json!({"seed": 7})).unwrap();
            assert!(at("a").is_symlink() && at("b").is_symlink() && at("disk/new").is_file());
        }
        write_json(&at("in-log"), &1).unwrap();
        assert!(at("log/new").is_file() && at("in-log").is_symlink());
        std::fs::remove_file(at("log/new")).unwrap();
        for (name, expected) in [
            ("in-log", "expected an output outside of the input"),
            ("nowhere", "cannot read"),
            ("circle", "expected a file or none, found a link that leads in a circle"),
        ] {
            let message = open(name).unwrap_err().to_string();
            assert!(message.starts_with(expected), "{name}: {message}");
        }
        std::os::unix::fs::symlink("disk/x", at("x")).unwrap();
        assert!(OutputFile::check_outside(&at("x"), &at("disk")).is_err());
    }
}
