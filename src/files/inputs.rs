//! Files and folders that a command reads, which its outputs must not replace.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::SharedFolder;
use super::output::manifest::FILES;
use super::output::work::OWN_NAME;
use super::resolved::{is_inside, resolved};
use crate::error::FileError;

/// Depth to which folders are searched for links: parts of data sets are commonly links to other disks.
const LINK_DEPTH: usize = 2;

/// Inputs of a command: files, and folders with everything below them.
#[derive(Clone, Debug, Default)]
pub struct Inputs(Vec<PathBuf>);

impl Inputs {
    /// Collects the paths. Those that do not exist have no effect.
    pub fn new<P: Into<PathBuf>>(paths: impl IntoIterator<Item = P>) -> Self {
        Self(paths.into_iter().map(Into::into).collect())
    }

    /// Adds paths.
    #[must_use]
    pub fn and<P: Into<PathBuf>>(mut self, paths: impl IntoIterator<Item = P>) -> Self {
        self.0.extend(paths.into_iter().map(Into::into));
        self
    }

    /// Checks that an output folder is none of the inputs and no part of one: below an input, it is new or an
    /// output of earlier runs.
    ///
    /// # Errors
    /// Fails if it is.
    pub(super) fn check_folder(&self, path: &Path) -> Result<(), FileError> {
        self.check_same(path)?;
        // These alone are the rest of a run that was killed before it listed a file.
        let rest = [OWN_NAME, SharedFolder::WORK, SharedFolder::OPTIONS];
        let has_entries = std::fs::read_dir(path).is_ok_and(|entries| {
            entries.flatten().any(|entry| rest.iter().all(|name| entry.file_name() != *name))
        });
        let is_output = path.join(FILES).exists() || SharedFolder::is_at(path);
        if has_entries && !is_output { self.check_outside(path) } else { Ok(()) }
    }

    /// Checks that a folder that is replaced as a whole is none of the inputs and contains none.
    ///
    /// # Errors
    /// Fails if it is one or contains one.
    pub(super) fn check_whole(&self, path: &Path) -> Result<(), FileError> {
        self.check_same(path)?;
        match self.0.iter().find(|input| input.exists() && is_inside(input, path)) {
            None => Ok(()),
            Some(input) => {
                let expected = format!("an output apart from the input {}", input.display());
                Err(FileError::content(expected, "a folder that contains it", path))
            }
        }
    }

    /// Checks that an output is not below an input folder. Links on the way are followed, and so are links in
    /// the upper levels of the inputs.
    ///
    /// # Errors
    /// Fails if it is.
    pub fn check_outside(&self, path: &Path) -> Result<(), FileError> {
        let place = resolved(path);
        let existing = place.ancestors().skip(1).filter_map(|above| above.metadata().ok());
        let ancestors: Vec<(u64, u64)> = existing.map(|about| identity(&about)).collect();
        let is_above = |folder: &Path| {
            folder.metadata().is_ok_and(|about| about.is_dir() && ancestors.contains(&identity(&about)))
        };
        match self
            .0
            .iter()
            .find(|input| is_above(input) || links_below(input, LINK_DEPTH).iter().any(|l| is_above(l)))
        {
            None => Ok(()),
            Some(input) => {
                let expected = format!("an output outside of the input {}", input.display());
                Err(FileError::content(expected, "one in it", path))
            }
        }
    }

    /// Checks that an output file is none of the input files, under any name.
    pub(super) fn check_same(&self, path: &Path) -> Result<(), FileError> {
        let Ok(found) = path.metadata() else { return Ok(()) };
        let is_same =
            |input: &&PathBuf| input.metadata().is_ok_and(|data| identity(&data) == identity(&found));
        match self.0.iter().find(is_same) {
            None => Ok(()),
            Some(input) => {
                let expected = format!("an output apart from the input {}", input.display());
                Err(FileError::content(expected, "the same", path))
            }
        }
    }
}

fn identity(about: &Metadata) -> (u64, u64) {
    (about.dev(), about.ino())
}

/// Returns the links in a folder, down to a depth.
fn links_below(folder: &Path, depth: usize) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut links = Vec::new();
    for entry in entries.flatten() {
        match entry.file_type() {
            Ok(kind) if kind.is_symlink() => links.push(entry.path()),
            Ok(kind) if kind.is_dir() && depth > 1 => links.extend(links_below(&entry.path(), depth - 1)),
            _ => {}
        }
    }
    links
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn outputs_in_input_folders_are_found_through_links() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("data/tables")).unwrap();
        std::fs::create_dir_all(at("disk/images/front")).unwrap();
        symlink(at("disk/images"), at("data/images")).unwrap();
        symlink(at("data"), at("link")).unwrap();
        symlink(at("data/tables/a.json"), at("name.json")).unwrap();
        std::fs::write(at("data/tables/a.json"), "").unwrap();
        let inputs = Inputs::new([at("data"), at("none"), at("name.json")]);
        for name in [
            "data/new",
            "data/tables/a.json",
            "link/new",
            "link/tables/new",
            "disk/images/front/new",
            "name.json",
            "data/new/folder/file",
            "none/../data/new",
        ] {
            let message = inputs.check_outside(&at(name)).unwrap_err().to_string();
            assert!(message.starts_with("expected an output outside of the input "), "{name}: {message}");
        }
        for name in ["new", "disk/new", "data2/new", "other/new/file"] {
            inputs.check_outside(&at(name)).unwrap();
        }
    }

    #[test]
    fn inputs_are_recognized_by_identity() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("out/sk")).unwrap();
        std::fs::write(at("file"), "").unwrap();
        std::fs::hard_link(at("file"), at("hard")).unwrap();
        symlink(at("file"), at("soft")).unwrap();
        symlink(at("out"), at("folder")).unwrap();
        let inputs = Inputs::new([at("file"), at("out/sk")]);
        for name in ["file", "hard", "soft", "folder/sk"] {
            let message = inputs.check_same(&at(name)).unwrap_err().to_string();
            assert!(
                message.contains("apart from the input") && message.contains("found the same"),
                "{message}"
            );
        }
        inputs.check_folder(&at("out")).unwrap();
        // Below an input: a part of it, a new folder, and an output of an earlier run.
        std::fs::create_dir_all(at("out/sk/part")).unwrap();
        std::fs::create_dir_all(at("out/sk/maps")).unwrap();
        std::fs::write(at("out/sk/part/a"), "").unwrap();
        std::fs::write(at("out/sk/maps").join(FILES), "").unwrap();
        let message = inputs.check_folder(&at("out/sk/part")).unwrap_err().to_string();
        assert!(message.starts_with("expected an output outside of the input "), "{message}");
        inputs.check_folder(&at("out/sk/new")).unwrap();
        inputs.check_folder(&at("out/sk/maps")).unwrap();
        std::fs::create_dir_all(at("out/sk/killed").join(OWN_NAME)).unwrap();
        inputs.check_folder(&at("out/sk/killed")).unwrap();
        // An export, also one that was killed before it had a shard.
        std::fs::create_dir_all(at("out/sk/export").join(SharedFolder::WORK)).unwrap();
        std::fs::write(at("out/sk/export").join(SharedFolder::OPTIONS), "").unwrap();
        inputs.check_folder(&at("out/sk/export")).unwrap();
        std::fs::write(at("out/sk/export/a.tar"), "").unwrap();
        inputs.check_folder(&at("out/sk/export")).unwrap_err();
        std::fs::create_dir(at("out/sk/export").join(SharedFolder::RECORDS)).unwrap();
        inputs.check_folder(&at("out/sk/export")).unwrap();
        let message = inputs.check_whole(&at("folder")).unwrap_err().to_string();
        assert!(message.contains("found a folder that contains it"), "{message}");
    }
}
