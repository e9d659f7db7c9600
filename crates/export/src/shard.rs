//! Files of a shard, which appear in the export once all of them are complete.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
#[cfg(feature = "parquet")]
use std::ops::Range;
use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::{WorkFolder, write_json};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::WorkUnit;

/// Folder of the records of complete shards.
pub(crate) const RECORDS: &str = "shards";
/// Folder of unfinished shards.
const WORK: &str = ".unfinished";
const BUFFER: usize = 1 << 20;

/// A file of a shard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ShardFile {
    /// Path in the export.
    pub(crate) path: PathBuf,
    /// Length.
    pub(crate) bytes: u64,
    /// SHA-256 in hexadecimal digits.
    pub(crate) sha256: String,
}

/// Record of a complete shard, `shards/NAME.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ShardRecord {
    /// Name of the shard.
    pub(crate) name: String,
    /// Name of the log.
    pub(crate) log: String,
    /// First key frame and the one after the last.
    pub(crate) frames: [usize; 2],
    /// Number of samples.
    pub(crate) samples: usize,
    /// Skipped and missing items, by kind.
    pub(crate) notes: BTreeMap<String, usize>,
    /// Files in order of their paths.
    pub(crate) files: Vec<ShardFile>,
}

impl ShardRecord {
    /// Reads the record of a shard and checks that its files exist with their lengths, with `verify` also their checksums.
    /// `None` if the shard has to be written.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub(crate) fn read(out: &Path, unit: &WorkUnit, verify: bool) -> Result<Option<Self>, FileError> {
        let Some(record) = Self::parse(out, unit) else { return Ok(None) };
        for file in &record.files {
            let path = out.join(&file.path);
            let is_whole = path.metadata().is_ok_and(|data| data.is_file() && data.len() == file.bytes);
            if !is_whole || verify && hash_of(&path)? != file.sha256 {
                return Ok(None);
            }
        }
        Ok(Some(record))
    }

    /// Returns the record of a shard; `None` if there is none of its frames.
    pub(crate) fn parse(out: &Path, unit: &WorkUnit) -> Option<Self> {
        let bytes = std::fs::read(record_path(out, &unit.name)).ok()?;
        let record: Self = serde_json::from_slice(&bytes).ok()?;
        (record.frames == [unit.frames.start, unit.frames.end]).then_some(record)
    }
}

fn record_path(out: &Path, name: &str) -> PathBuf {
    out.join(RECORDS).join(format!("{name}.json"))
}

/// Files of an unfinished shard. They are removed on drop, by a signal, or by the next process that writes the shard.
pub(crate) struct Shard {
    work: WorkFolder,
    out: PathBuf,
    unit: WorkUnit,
    files: Vec<ShardFile>,
    notes: BTreeMap<String, usize>,
}

impl Shard {
    /// Begins a shard of an export in `out`.
    ///
    /// # Errors
    /// Fails with [`FileError::Busy`] if another process writes it, or on an I/O error.
    pub(crate) fn begin(out: &Path, unit: &WorkUnit) -> Result<Self, FileError> {
        let work = WorkFolder::open(out.join(WORK).join(&unit.name), &record_path(out, &unit.name))?;
        work.clear(|_| false)?;
        Ok(Self { work, out: out.to_owned(), unit: unit.clone(), files: Vec::new(), notes: BTreeMap::new() })
    }

    /// Returns the name of the shard.
    pub(crate) fn name(&self) -> &str {
        &self.unit.name
    }

    /// Returns the key frames of the shard.
    #[cfg(feature = "parquet")]
    pub(crate) fn frames(&self) -> Range<usize> {
        self.unit.frames.clone()
    }

    /// Counts skipped items.
    pub(crate) fn note(&mut self, kind: &str, count: usize) {
        if count > 0 {
            *self.notes.entry(kind.to_owned()).or_default() += count;
        }
    }

    /// Begins a file at a path in the export.
    ///
    /// # Errors
    /// Fails if the file cannot be created.
    pub(crate) fn create(&self, path: impl AsRef<Path>) -> Result<HashedFile, FileError> {
        let path = path.as_ref();
        let place = self.work.path().join(path);
        let shown = self.out.join(path);
        if let Some(folder) = place.parent() {
            std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
        }
        let file = File::create(&place).map_err(FileError::io("create", &shown))?;
        let writer = BufWriter::with_capacity(BUFFER, file);
        Ok(HashedFile { writer, hash: Sha256::new(), bytes: 0, path: path.to_owned(), shown })
    }

    /// Ends a file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub(crate) fn close(&mut self, mut file: HashedFile) -> Result<(), FileError> {
        file.writer.flush().map_err(FileError::io("write", &file.shown))?;
        let sha256 = hexadecimal(&file.hash.finalize());
        self.files.push(ShardFile { path: file.path, bytes: file.bytes, sha256 });
        Ok(())
    }

    /// Writes a whole file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub(crate) fn put(&mut self, path: impl AsRef<Path>, bytes: &[u8]) -> Result<(), FileError> {
        let mut file = self.create(path)?;
        file.write_all(bytes).map_err(FileError::io("write", &file.shown.clone()))?;
        self.close(file)
    }

    /// Moves all files into the export, then writes the record.
    ///
    /// # Errors
    /// Fails if a file cannot be moved or written.
    pub(crate) fn publish(mut self, mut record: ShardRecord) -> Result<ShardRecord, FileError> {
        record.notes.append(&mut self.notes);
        self.files.sort_by(|a, b| a.path.cmp(&b.path));
        for file in &self.files {
            let path = self.out.join(&file.path);
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
            }
            std::fs::rename(self.work.path().join(&file.path), &path)
                .map_err(FileError::io("rename to", &path))?;
        }
        let record = ShardRecord { files: std::mem::take(&mut self.files), ..record };
        let path = record_path(&self.out, &self.unit.name);
        let folder = self.out.join(RECORDS);
        std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
        write_json(&path, &record)?;
        Ok(record)
    }
}

/// Removes the folder of unfinished shards if it is empty.
pub(crate) fn remove_work(out: &Path) {
    let _ = std::fs::remove_dir(out.join(WORK)); // another process may use it
}

/// File of a shard that is hashed while it is written.
pub(crate) struct HashedFile {
    writer: BufWriter<File>,
    hash: Sha256,
    bytes: u64,
    /// Path in the export.
    path: PathBuf,
    /// Path for messages.
    pub(crate) shown: PathBuf,
}

impl Write for HashedFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.writer.write(bytes)?;
        self.hash.update(&bytes[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.writer.flush()
    }
}

fn hash_of(path: &Path) -> Result<String, FileError> {
    let mut file = File::open(path).map_err(FileError::io("read", path))?;
    let (mut hash, mut buffer) = (Sha256::new(), vec![0; BUFFER]);
    loop {
        match file.read(&mut buffer).map_err(FileError::io("read", path))? {
            0 => return Ok(hexadecimal(&hash.finalize())),
            read => hash.update(&buffer[..read]),
        }
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit() -> WorkUnit {
        WorkUnit { name: "a-000000".into(), frames: 0..2 }
    }

    fn record() -> ShardRecord {
        let (notes, files) = Default::default();
        ShardRecord { name: unit().name, log: "a".into(), frames: [0, 2], samples: 2, notes, files }
    }

    #[test]
    fn a_shard_appears_whole_and_is_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let find = |verify| ShardRecord::read(out, &unit(), verify).unwrap();
        let mut shard = Shard::begin(out, &unit()).unwrap();
        shard.put("images/1.png", b"abc").unwrap();
        assert!(matches!(Shard::begin(out, &unit()), Err(FileError::Busy { .. })));
        assert!(!out.join("images").exists() && find(false).is_none());
        let written = shard.publish(record()).unwrap();
        // SHA-256 of "abc", from FIPS 180-2.
        let sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(written.files[0].sha256, sha256);
        assert_eq!(
            (find(true), std::fs::read(out.join("images/1.png")).unwrap()),
            (Some(written), b"abc".into())
        );
        remove_work(out);
        assert_eq!(std::fs::read_dir(out).unwrap().count(), 2);
        // Damage: of the same length, then of another one.
        std::fs::write(out.join("images/1.png"), "abd").unwrap();
        assert!(find(false).is_some() && find(true).is_none());
        std::fs::write(out.join("images/1.png"), "ab").unwrap();
        assert!(find(false).is_none());
        std::fs::write(out.join("images/1.png"), "abc").unwrap();
        let longer = WorkUnit { frames: 0..3, ..unit() };
        assert!(ShardRecord::read(out, &longer, false).unwrap().is_none());
    }

    #[test]
    fn an_unfinished_shard_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut shard = Shard::begin(folder.path(), &unit()).unwrap();
        shard.put("a/b.json", b"{}").unwrap();
        drop(shard);
        remove_work(folder.path());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
