//! Output folders that several processes fill at the same time, unit by unit.
//!
//! # How it works
//! A unit is written in a work folder of its own (`OUT/.unfinished/UNIT`), which has its lock. It is
//! published by moving its files to their names and writing its record, which lists them, last. A file may be
//! replaced only if the unit's earlier record lists it. One with the same bytes stays, so that a record that
//! was lost is written again. The work folder lists the files of the earlier record, and each new one just
//! before it is moved. After a killed process, the next owner removes these.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};

use super::manifest::{check_no_linked_folder, is_below, refusal};
use super::pending::{finish_undisturbed, remove};
use super::place::move_entry;
use super::work::WorkFolder;
use crate::error::FileError;
use crate::files::input::{is_taken, is_there, open_regular, read_text};

/// List of the unit's files that may have their names, in a work folder.
const MOVING: &str = "moving";
/// Folder of the unit's files, in a work folder.
const NEW: &str = "new";
const BUFFER: usize = 1 << 20;

/// Unit of a shared output folder, locked by this process. An unpublished one leaves nothing.
#[derive(Debug)]
pub struct SharedFolder {
    out: PathBuf,
    work: WorkFolder,
    /// Path of the record in the folder.
    record: PathBuf,
    /// Files of the unit's earlier record.
    owned: BTreeSet<PathBuf>,
}

impl SharedFolder {
    /// File with the options of all units.
    pub const OPTIONS: &str = "export.json";
    /// Folder for the records of complete units.
    pub const RECORDS: &str = "shards";
    /// Folder of the work folders.
    pub(in super::super) const WORK: &str = ".unfinished";

    /// Returns whether units were published in a folder.
    pub(in super::super) fn is_at(folder: &Path) -> bool {
        [Self::OPTIONS, Self::RECORDS].iter().all(|name| folder.join(name).exists())
    }

    /// Locks the unit `name` of the folder `out`. `record` is the path of its record there. `owned` returns
    /// the files that an earlier record lists; it is called when the unit is locked.
    ///
    /// # Errors
    /// Returns any error of `owned`. Fails with [`FileError::Busy`] if another process writes the unit, if a
    /// link leads out of the folder, or on an I/O error.
    pub fn begin(
        out: &Path,
        name: &str,
        record: &Path,
        owned: impl FnOnce() -> Result<BTreeSet<PathBuf>, FileError>,
    ) -> Result<Self, FileError> {
        let place = Path::new(Self::WORK).join(name);
        for path in [&place, record] {
            check_no_linked_folder(out, path)?;
        }
        let work = WorkFolder::open(out.join(place), &out.join(record))?;
        let owned = owned()?;
        let mut unit = Self { out: out.to_owned(), work, record: record.to_owned(), owned };
        let moved: BTreeSet<PathBuf> =
            MovedFiles::read(unit.work.path())?.difference(&unit.owned).cloned().collect();
        unit.remove_files(&moved)?;
        unit.work.clear(|_| false)?;
        unit.owned.retain(|path| is_below(path));
        Ok(unit)
    }

    /// Checks, before the work, that a file of the unit may be written: that its name is free or has a file.
    /// Whether that file may be replaced depends on its bytes, if the earlier record does not list it.
    ///
    /// # Errors
    /// Fails if a folder has its name, or a link that the earlier record does not list, or if a link on the
    /// way leads out of the folder.
    pub fn check(&self, name: &Path) -> Result<(), FileError> {
        check_no_linked_folder(&self.out, name)?;
        let path = self.out.join(name);
        match path.symlink_metadata() {
            Ok(about) if about.is_file() || !about.is_dir() && self.owned.contains(name) => Ok(()),
            Ok(_) => Err(refusal(&path)),
            Err(_) => Ok(()),
        }
    }

    /// Checks that a file of the unit, which was written, may be moved to its name.
    fn check_written(&self, name: &Path) -> Result<(), FileError> {
        self.check(name)?;
        let path = self.out.join(name);
        let is_foreign = path.symlink_metadata().is_ok() && !self.owned.contains(name);
        if is_foreign && !has_same_bytes(&path, &self.work.path().join(NEW).join(name))? {
            return Err(refusal(&path));
        }
        Ok(())
    }

    /// Returns the path at which to write a file of the unit, and creates its folder.
    ///
    /// # Errors
    /// Fails as [`Self::check`], or if the folder cannot be created.
    pub fn create(&self, name: &Path) -> Result<PathBuf, FileError> {
        self.check(name)?;
        let path = self.work.path().join(NEW).join(name);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
        }
        Ok(path)
    }

    /// Moves the files of the unit to their names, then calls `write_record` with the path of the record.
    /// Files of the earlier record that are not among them are removed. A signal that ends the process waits
    /// for the end.
    ///
    /// # Errors
    /// Returns any error of `write_record`. Fails without moving a file as [`Self::check`], or if a foreign
    /// file has one of the names. Fails on an I/O error; moved files are removed then.
    pub fn publish(
        self,
        files: &BTreeSet<PathBuf>,
        write_record: impl FnOnce(&Path) -> Result<(), FileError>,
    ) -> Result<(), FileError> {
        files.iter().try_for_each(|name| self.check_written(name))?;
        let record = self.out.join(&self.record);
        if record.is_symlink() || record.is_dir() {
            return Err(refusal(&record));
        }
        let mut moved = MovedFiles::create(self.work.path())?;
        moved.add(&self.owned)?;
        finish_undisturbed(|| {
            remove(&record).map_err(FileError::io("replace", &record))?;
            self.remove_files(&self.owned.difference(files).cloned().collect())?;
            let published = self.move_files(files, &mut moved).and_then(|()| write_record(&record));
            if published.is_err() {
                let _ = self.remove_files(&moved.names); // the first error is the one to report
            }
            published
        })
    }

    /// Moves files to their names, and lists each before.
    fn move_files(&self, files: &BTreeSet<PathBuf>, moved: &mut MovedFiles) -> Result<(), FileError> {
        for name in files {
            let path = self.out.join(name);
            if !self.owned.contains(name) {
                if is_taken(&path) {
                    self.check_written(name)?; // foreign, of the same bytes
                    continue;
                }
                moved.add([name])?;
            }
            move_entry(&self.work.path().join(NEW).join(name), &path)?;
        }
        create_parent(&self.out.join(&self.record))
    }

    /// Removes files of the unit, and folders that are then empty.
    fn remove_files(&self, files: &BTreeSet<PathBuf>) -> Result<(), FileError> {
        for name in files {
            check_no_linked_folder(&self.out, name)?;
            let path = self.out.join(name);
            if path.symlink_metadata().is_ok_and(|about| about.is_dir()) {
                continue; // foreign
            }
            remove(&path).map_err(FileError::io("replace", &path))?;
            let above = name.ancestors().skip(1).filter(|above| *above != Path::new(""));
            // Folders with other files stay.
            let _ = above.map(|above| std::fs::remove_dir(self.out.join(above))).find(Result::is_err);
        }
        Ok(())
    }

    /// Returns whether there is a work folder of a unit.
    pub fn has_leftovers(out: &Path, name: &str) -> bool {
        out.join(Self::WORK).join(name).exists()
    }

    /// Removes the folder of the work folders if it is empty.
    pub fn remove_work(out: &Path) {
        let _ = std::fs::remove_dir(out.join(Self::WORK)); // another process may use it
    }
}

/// List of the files that are the unit's while it has no record, also in its work folder.
struct MovedFiles {
    names: BTreeSet<PathBuf>,
    file: File,
    path: PathBuf,
}

impl MovedFiles {
    fn create(work: &Path) -> Result<Self, FileError> {
        let path = work.join(MOVING);
        let file = File::create(&path).map_err(FileError::io("create", &path))?;
        Ok(Self { names: BTreeSet::new(), file, path })
    }

    fn add<'a>(&mut self, names: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), FileError> {
        let names: Vec<&PathBuf> = names.into_iter().collect();
        let text: String = names.iter().map(|name| format!("{}\n", name.display())).collect();
        self.file.write_all(text.as_bytes()).map_err(FileError::io("write", &self.path))?;
        self.names.extend(names.into_iter().cloned());
        Ok(())
    }

    /// Reads the names that a killed process left, without a last one that it did not write whole.
    fn read(work: &Path) -> Result<BTreeSet<PathBuf>, FileError> {
        let path = work.join(MOVING);
        if !is_there(&path)? {
            return Ok(BTreeSet::new());
        }
        let text = read_text(&path)?;
        let (lines, _) = text.rsplit_once('\n').unwrap_or_default();
        Ok(lines.lines().map(PathBuf::from).filter(|path| is_below(path)).collect())
    }
}

/// Returns whether two files have the same content.
fn has_same_bytes(a: &Path, b: &Path) -> Result<bool, FileError> {
    let ((a_file, a_length), (b_file, b_length)) = (open_regular(a)?, open_regular(b)?);
    if a_length != b_length {
        return Ok(false);
    }
    let [mut a_bytes, mut b_bytes] =
        [a_file, b_file].map(|file| BufReader::with_capacity(BUFFER, file).bytes());
    let same = (&mut a_bytes).zip(&mut b_bytes).try_fold(true, |same, (x, y)| Ok(same && x? == y?));
    same.map_err(FileError::io("read", a))
}

fn create_parent(path: &Path) -> Result<(), FileError> {
    let Some(parent) = path.parent() else { return Ok(()) };
    std::fs::create_dir_all(parent).map_err(FileError::io("create", parent))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn paths(names: &[&str]) -> BTreeSet<PathBuf> {
        names.iter().map(PathBuf::from).collect()
    }

    fn begin(out: &Path, owned: &[&str]) -> Result<SharedFolder, FileError> {
        SharedFolder::begin(out, "a", Path::new("records/a.json"), || Ok(paths(owned)))
    }

    fn write(unit: &SharedFolder, names: &[&str], text: &str) -> Result<(), FileError> {
        for name in names {
            std::fs::write(unit.create(Path::new(name))?, text).unwrap();
        }
        Ok(())
    }

    fn record(path: &Path) -> Result<(), FileError> {
        std::fs::write(path, "record").map_err(FileError::io("write", path))
    }

    fn listed(out: &Path) -> Vec<String> {
        let files = crate::files::output::manifest::files_below(out).unwrap();
        files.iter().map(|path| path.display().to_string()).collect()
    }

    #[test]
    fn files_of_the_earlier_record_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let unit = begin(out, &[]).unwrap();
        assert!(matches!(begin(out, &[]), Err(FileError::Busy { .. })));
        write(&unit, &["a/1", "a/b/2"], "old").unwrap();
        unit.publish(&paths(&["a/1", "a/b/2"]), record).unwrap();
        SharedFolder::remove_work(out);
        assert_eq!(listed(out), ["a/1", "a/b/2", "records/a.json"]);
        // Without the record, and after a file of someone else appeared, nothing is replaced.
        let unit = begin(out, &[]).unwrap();
        write(&unit, &["a/1", "c"], "new").unwrap();
        let message = unit.publish(&paths(&["a/1", "c"]), record).unwrap_err().to_string();
        assert!(message.contains("found another file: ") && message.ends_with("/a/1"), "{message}");
        assert!(!out.join("c").exists() && std::fs::read(out.join("a/1")).unwrap() == b"old");
        // A lost record is written again if the bytes are the same.
        let unit = begin(out, &[]).unwrap();
        write(&unit, &["a/1"], "old").unwrap();
        unit.publish(&paths(&["a/1"]), record).unwrap();
        let unit = begin(out, &["a/1", "a/b/2"]).unwrap();
        write(&unit, &["a/1", "c"], "new").unwrap();
        std::fs::write(out.join("c"), "foreign").unwrap();
        assert!(unit.publish(&paths(&["a/1", "c"]), record).is_err());
        assert_eq!(std::fs::read(out.join("c")).unwrap(), b"foreign");
        assert_eq!(std::fs::read(out.join("a/1")).unwrap(), b"old");
        std::fs::remove_file(out.join("c")).unwrap();
        // Files that are no longer written disappear.
        let unit = begin(out, &["a/1", "a/b/2"]).unwrap();
        write(&unit, &["a/1", "c"], "new").unwrap();
        unit.publish(&paths(&["a/1", "c"]), record).unwrap();
        SharedFolder::remove_work(out);
        assert_eq!(listed(out), ["a/1", "c", "records/a.json"]);
        assert_eq!(std::fs::read(out.join("a/1")).unwrap(), b"new");
    }

    #[test]
    fn files_moved_by_a_killed_process_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let mut unit = begin(out, &[]).unwrap();
        write(&unit, &["a/1", "a/2", "a/3"], "half").unwrap();
        std::fs::create_dir(out.join("a")).unwrap();
        std::fs::write(out.join("a/3"), "half").unwrap();
        let mut moved = MovedFiles::create(unit.work.path()).unwrap();
        unit.move_files(&paths(&["a/1", "a/3"]), &mut moved).unwrap();
        moved.file.write_all(b"a/mine").unwrap(); // a name that was cut
        unit.work.keep(true); // as after SIGKILL
        drop(unit);
        for name in ["a/2", "a/mine"] {
            std::fs::write(out.join(name), "").unwrap();
        }
        drop(begin(out, &[]).unwrap());
        SharedFolder::remove_work(out);
        assert_eq!(listed(out), ["a/2", "a/3", "a/mine", "records"]);
    }

    #[test]
    fn files_of_a_record_that_a_killed_process_removed_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        for name in ["b/1", "b/2"] {
            std::fs::create_dir_all(out.join("b")).unwrap();
            std::fs::write(out.join(name), "old").unwrap();
        }
        let mut unit = begin(out, &["b/1", "b/2"]).unwrap();
        write(&unit, &["b/1"], "new").unwrap();
        let mut moved = MovedFiles::create(unit.work.path()).unwrap();
        moved.add(&unit.owned).unwrap();
        unit.move_files(&paths(&["b/1"]), &mut moved).unwrap();
        unit.work.keep(true); // as after SIGKILL
        drop(unit);
        drop(begin(out, &[]).unwrap());
        SharedFolder::remove_work(out);
        assert_eq!(listed(out), ["records"]);
    }

    #[test]
    fn a_failed_publication_leaves_nothing_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let unit = begin(folder.path(), &[]).unwrap();
        write(&unit, &["a/1", "b"], "1").unwrap();
        std::fs::write(folder.path().join("b"), "1").unwrap(); // foreign, of the same bytes
        let full = |path: &Path| Err(FileError::io("write", path)(std::io::ErrorKind::StorageFull.into()));
        assert!(unit.publish(&paths(&["a/1", "b"]), full).is_err());
        SharedFolder::remove_work(folder.path());
        assert_eq!(listed(folder.path()), ["b", "records"]);
    }

    #[test]
    fn links_are_not_followed() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        for name in [".unfinished", "records", "a"] {
            symlink(other.path(), folder.path().join(name)).unwrap();
            let written = begin(folder.path(), &["a/1"]).and_then(|unit| write(&unit, &["a/1"], "1"));
            assert!(written.unwrap_err().to_string().contains("found a link: "), "{name}");
            std::fs::remove_file(folder.path().join(name)).unwrap();
        }
        assert_eq!(std::fs::read_dir(other.path()).unwrap().count(), 0);
    }
}
