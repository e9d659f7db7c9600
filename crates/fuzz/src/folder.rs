use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// Folder whose files a target changes and restores before its next run.
pub(crate) struct Folder {
    folder: TempDir,
    base: BTreeMap<String, Vec<u8>>,
    changed: BTreeSet<String>,
}

impl Folder {
    /// Creates a folder with some files, by their relative path.
    pub(crate) fn new(base: BTreeMap<String, Vec<u8>>) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut folder = Self { folder, base: BTreeMap::new(), changed: BTreeSet::new() };
        for (name, bytes) in &base {
            folder.put(name, bytes);
        }
        Self { base, changed: BTreeSet::new(), ..folder }
    }

    /// Creates a folder with a copy of another one's files.
    pub(crate) fn copy_of(other: &Path) -> Self {
        let mut files = BTreeMap::new();
        gather(other, "", &mut files);
        Self::new(files)
    }

    pub(crate) fn root(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.root().join(name)
    }

    /// Returns the original content of a file.
    pub(crate) fn base(&self, name: &str) -> &[u8] {
        &self.base[name]
    }

    /// Returns the names of all original files.
    pub(crate) fn names(&self) -> Vec<String> {
        self.base.keys().cloned().collect()
    }

    /// Restores all files, including those removed by other code.
    pub(crate) fn rewrite(&mut self) {
        self.changed.clear();
        self.base.iter().for_each(|(name, bytes)| write(&self.path(name), bytes));
    }

    /// Restores the files that were changed.
    pub(crate) fn reset(&mut self) {
        for name in std::mem::take(&mut self.changed) {
            match self.base.get(&name) {
                Some(bytes) => write(&self.path(&name), bytes),
                None => std::fs::remove_file(self.path(&name)).expect("a file of ours"),
            }
        }
    }

    /// Writes a file.
    pub(crate) fn put(&mut self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        write(&path, bytes);
        self.changed.insert(name.to_owned());
        path
    }

    /// Marks a file as changed by other code, and returns its path.
    pub(crate) fn touch(&mut self, name: &str) -> PathBuf {
        self.changed.insert(name.to_owned());
        self.path(name)
    }
}

fn write(path: &Path, bytes: &[u8]) {
    if std::fs::write(path, bytes).is_err() {
        std::fs::create_dir_all(path.parent().unwrap_or(path)).expect("a folder of ours");
        std::fs::write(path, bytes).expect("a file of ours");
    }
}

fn gather(folder: &Path, prefix: &str, files: &mut BTreeMap<String, Vec<u8>>) {
    for entry in std::fs::read_dir(folder).expect("a folder of ours") {
        let entry = entry.expect("a file of ours");
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            gather(&entry.path(), &format!("{name}/"), files);
        } else {
            files.insert(name, std::fs::read(entry.path()).expect("a file of ours"));
        }
    }
}
