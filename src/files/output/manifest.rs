//! List of the files written into a folder by runs, which later runs may replace, and fingerprints of what
//! they were made from.

use std::collections::BTreeSet;
use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};

use super::whole::write_whole;
use crate::error::FileError;
use crate::files::input::{is_there, read_text};
use crate::files::text::printable_path;

/// Name of an output folder's file list.
pub const FILES: &str = ".pskel-files";
const HEADER: &str = "pskel files 1: ";
/// Mark of the fingerprints in the header.
const INPUTS: &str = " of ";
/// Folder of lost files at the root of some file systems.
const LOST: &str = "lost+found";

/// Content of `.pskel-files`: a header with the kind of the folder and the fingerprints of its inputs
/// (`KIND[ of HASH ..]`), then one relative path per line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in super::super) struct Manifest {
    /// Kind of content: `maps`, `skeleton`, ...
    pub(in super::super) kind: String,
    /// Fingerprints of the inputs; empty if unknown.
    pub(in super::super) inputs: Vec<String>,
    paths: BTreeSet<PathBuf>,
}

impl Manifest {
    /// Creates an empty list.
    pub(in super::super) fn new(kind: &str) -> Self {
        Self { kind: kind.to_owned(), inputs: Vec::new(), paths: BTreeSet::new() }
    }

    /// Lists all files below a folder, which was made from inputs with some fingerprints.
    pub(in super::super) fn of(kind: &str, inputs: &[String], folder: &Path) -> Result<Self, FileError> {
        Ok(Self { kind: kind.to_owned(), inputs: inputs.to_vec(), paths: files_below(folder)? })
    }

    /// Returns the files.
    pub(in super::super) fn paths(&self) -> &BTreeSet<PathBuf> {
        &self.paths
    }

    /// Adds the files of another list.
    pub(in super::super) fn with(mut self, other: &Self) -> Self {
        self.paths.extend(other.paths.iter().cloned());
        self
    }

    /// Reads the list of a folder; `None` if it has none. Ignores a last line without a newline, which a
    /// killed process may leave.
    pub(in super::super) fn read(folder: &Path) -> Result<Option<Self>, FileError> {
        let path = folder.join(FILES);
        if path.is_symlink() {
            return Err(refusal(&path)); // it would be appended to
        }
        if !is_there(&path)? {
            return Ok(None);
        }
        let text = read_text(&path)?;
        let (lines, _) = text.rsplit_once('\n').unwrap_or_default();
        let mut lines = lines.lines();
        let kind = lines.next().and_then(|line| line.strip_prefix(HEADER));
        let kind = kind.ok_or_else(|| {
            FileError::content(format!("a list of files ({HEADER}KIND)"), "another text", &path)
        })?;
        let (kind, inputs) = kind.split_once(INPUTS).unwrap_or((kind, ""));
        let inputs = inputs.split_whitespace().map(str::to_owned).collect();
        let paths: BTreeSet<PathBuf> = lines.map(PathBuf::from).collect();
        match paths.iter().find(|path| !is_below(path)) {
            Some(other) => {
                Err(FileError::content("paths of files below the folder", printable_path(other), &path))
            }
            None => Ok(Some(Self { kind: kind.to_owned(), inputs, paths })),
        }
    }

    /// Writes the list, sorted, and replaces an older one.
    pub(in super::super) fn write(&self, folder: &Path) -> Result<(), FileError> {
        let path = folder.join(FILES);
        write_whole(&path, |out| {
            let mut line =
                |line: String| out.write_all(line.as_bytes()).map_err(FileError::io("write", &path));
            let inputs = if self.inputs.is_empty() { "" } else { INPUTS };
            line(format!("{HEADER}{}{inputs}{}\n", self.kind, self.inputs.join(" ")))?;
            self.paths.iter().try_for_each(|path| line(format!("{}\n", path.display())))
        })
    }

    /// Adds paths, first to the list on disk.
    pub(in super::super) fn add(&mut self, folder: &Path, new: BTreeSet<PathBuf>) -> Result<(), FileError> {
        let new: BTreeSet<PathBuf> = new.difference(&self.paths).cloned().collect();
        if new.is_empty() {
            return Ok(());
        }
        let path = folder.join(FILES);
        // A list with another name belongs to a copy of the folder by hard links.
        if self.paths.is_empty() || path.metadata().is_ok_and(|list| list.nlink() > 1) {
            let all = Self { paths: self.paths.union(&new).cloned().collect(), ..self.clone() };
            all.write(folder)?;
            *self = all;
            return Ok(());
        }
        let text: String = new.iter().map(|path| format!("{}\n", path.display())).collect();
        let appended =
            OpenOptions::new().append(true).open(&path).and_then(|mut f| f.write_all(text.as_bytes()));
        appended.map_err(FileError::io("write", &path))?;
        self.paths.extend(new);
        Ok(())
    }

    /// Removes a path and everything below it from the list in memory.
    pub(in super::super) fn forget(&mut self, name: &Path) {
        self.paths.retain(|path| !path.starts_with(name));
    }

    /// Returns whether a relative path is in the list.
    pub(in super::super) fn holds(&self, name: &Path) -> bool {
        self.paths.contains(name)
    }

    /// Returns whether the list is empty.
    pub(in super::super) fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// Returns whether the list has a file below a folder. If such a folder is empty, a run was killed before
    /// it wrote the first of them, or after it removed the last.
    fn holds_below(&self, folder: &Path) -> bool {
        self.paths.range(folder.to_owned()..).next().is_some_and(|path| path.starts_with(folder))
    }

    /// Checks that all files at or below `name` in `folder` are in the list, and that no folder on the way is
    /// a link, which would lead out of the folder.
    pub(in super::super) fn check(&self, folder: &Path, name: &Path) -> Result<(), FileError> {
        check_no_linked_folder(folder, name)?;
        let is_folder = |path: &Path| folder.join(path).symlink_metadata().is_ok_and(|data| data.is_dir());
        let mut foreign = None;
        visit(folder, name, &mut |path| {
            if foreign.is_none() && !self.holds(&path) && !(self.holds_below(&path) && is_folder(&path)) {
                foreign = Some(path);
            }
        })?;
        let Some(path) = foreign else { return Ok(()) };
        Err(refusal(&folder.join(path)))
    }

    /// Checks all files of a folder as [`Self::check`] does, except the work folder and lost files in a mount
    /// point.
    pub(in super::super) fn check_mounted(&self, folder: &Path, work: &str) -> Result<(), FileError> {
        for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
            let name = entry.map_err(FileError::io("read", folder))?.file_name();
            if name != work && name != LOST {
                self.check(folder, Path::new(&name))?;
            }
        }
        Ok(())
    }
}

/// Returns whether a path, by its text alone, names something below the folder that it is relative to: it has
/// neither a root nor `..`. Links are not considered.
pub fn is_below(path: &Path) -> bool {
    path.components().all(|part| matches!(part, Component::Normal(_)))
}

/// Checks that no folder on the way from `folder` to a relative path is a link.
///
/// # Errors
/// Returns an error that names the link.
pub(in super::super) fn check_no_linked_folder(folder: &Path, name: &Path) -> Result<(), FileError> {
    let inner = name.ancestors().skip(1).filter(|inner| *inner != Path::new(""));
    match inner.map(|inner| folder.join(inner)).find(|inner| inner.is_symlink()) {
        Some(link) => Err(refusal(&link)),
        None => Ok(()),
    }
}

/// Returns the error for a file that no run wrote, where a run is to write.
pub(in super::super) fn refusal(path: &Path) -> FileError {
    let found = match path.symlink_metadata() {
        Ok(data) if data.is_symlink() => "a link",
        Ok(data) if data.is_dir() => "another folder",
        _ => "another file",
    };
    FileError::content("only files that pskel wrote where it is to write", found, path)
}

/// Returns all files below a folder, relative to it.
pub(in super::super) fn files_below(folder: &Path) -> Result<BTreeSet<PathBuf>, FileError> {
    let mut paths = BTreeSet::new();
    visit(folder, Path::new(""), &mut |path| {
        paths.insert(path);
    })?;
    Ok(paths)
}

/// Calls `see` with every file at or below `name`, relative to `folder`, except the list itself. An empty
/// folder counts as a file. Links are not followed.
fn visit(folder: &Path, name: &Path, see: &mut impl FnMut(PathBuf)) -> Result<(), FileError> {
    let path = folder.join(name);
    let Ok(data) = std::fs::symlink_metadata(&path) else { return Ok(()) };
    if !data.is_dir() {
        if name != Path::new(FILES) {
            see(name.to_owned());
        }
        return Ok(());
    }
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(&path).map_err(FileError::io("read", &path))? {
        entries.push(entry.map_err(FileError::io("read", &path))?.file_name());
    }
    if entries.is_empty() && name != Path::new("") {
        see(name.to_owned());
    }
    entries.sort();
    entries.iter().try_for_each(|entry| visit(folder, &name.join(entry), see))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_folders_of_listed_files_are_not_foreign() {
        let folder = tempfile::tempdir().unwrap();
        let mut manifest = Manifest::new("maps");
        manifest.add(folder.path(), ["a/b/c.png", "d.png"].map(PathBuf::from).into()).unwrap();
        let check = |name: &str| manifest.check(folder.path(), Path::new(name));
        std::fs::create_dir_all(folder.path().join("a/b")).unwrap();
        check("a").unwrap();
        // Cases: a file in place of such a folder, another empty folder, and a folder with a foreign file.
        std::fs::remove_dir(folder.path().join("a/b")).unwrap();
        std::fs::write(folder.path().join("a/b"), "foreign").unwrap();
        assert!(check("a").unwrap_err().to_string().ends_with("a/b"));
        std::fs::remove_file(folder.path().join("a/b")).unwrap();
        std::fs::create_dir(folder.path().join("a/bb")).unwrap();
        assert!(check("a").unwrap_err().to_string().ends_with("a/bb"));
        std::fs::remove_dir(folder.path().join("a/bb")).unwrap();
        std::fs::create_dir(folder.path().join("a/b")).unwrap();
        std::fs::write(folder.path().join("a/b/e.png"), "foreign").unwrap();
        assert!(check("a").unwrap_err().to_string().ends_with("a/b/e.png"));
    }

    #[test]
    fn files_behind_links_are_foreign() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut manifest = Manifest::new("maps");
        manifest.add(folder.path(), ["a/b/c.png"].map(PathBuf::from).into()).unwrap();
        std::fs::create_dir(other.path().join("b")).unwrap();
        std::fs::write(other.path().join("b/c.png"), "precious").unwrap();
        std::os::unix::fs::symlink(other.path(), folder.path().join("a")).unwrap();
        for name in ["a", "a/b", "a/b/c.png", "a/new"] {
            let message = manifest.check(folder.path(), Path::new(name)).unwrap_err().to_string();
            assert!(message.contains("found a link: ") && message.ends_with("/a"), "{message}");
        }
    }

    #[test]
    fn rejects_a_link_as_list() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        Manifest::of("maps", &[], other.path()).unwrap().write(other.path()).unwrap();
        std::os::unix::fs::symlink(other.path().join(FILES), folder.path().join(FILES)).unwrap();
        assert!(Manifest::read(folder.path()).unwrap_err().to_string().contains("found a link: "));
    }

    #[test]
    fn lists_have_only_files_below_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        for line in ["../victim", "/etc/victim", "a/../../victim"] {
            std::fs::write(folder.path().join(FILES), format!("{HEADER}maps\na.png\n{line}\n")).unwrap();
            let message = Manifest::read(folder.path()).unwrap_err().to_string();
            let expected = format!("expected paths of files below the folder, found {line}: ");
            assert!(message.starts_with(&expected) && message.ends_with(FILES), "{message}");
        }
    }

    #[test]
    fn lists_of_copies_by_hard_links_are_not_appended_to() {
        let (folder, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut manifest = Manifest::new("maps");
        manifest.add(folder.path(), ["a.png"].map(PathBuf::from).into()).unwrap();
        std::fs::hard_link(folder.path().join(FILES), copy.path().join(FILES)).unwrap();
        let before = std::fs::read(copy.path().join(FILES)).unwrap();
        manifest.add(folder.path(), ["b.png"].map(PathBuf::from).into()).unwrap();
        assert_eq!(std::fs::read(copy.path().join(FILES)).unwrap(), before);
        assert_eq!(Manifest::read(folder.path()).unwrap(), Some(manifest));
    }

    #[test]
    fn inputs_are_in_the_header() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a of b"), "").unwrap();
        for inputs in [&[][..], &["0a"], &["0a", "1b"]] {
            let inputs: Vec<String> = inputs.iter().map(|&hash| hash.into()).collect();
            let written = Manifest::of("skeleton", &inputs, folder.path()).unwrap();
            written.write(folder.path()).unwrap();
            assert_eq!(Manifest::read(folder.path()).unwrap(), Some(written));
        }
    }
}
