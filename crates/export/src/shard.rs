//! Files of a shard, which appear in the export once all of them are complete.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_there, read_table};
use point_skeleton::files::{SharedFolder, is_below, json, write_json};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{ExportOptions, WorkUnit, claim};

/// Folder for the records of complete shards.
const RECORDS: &str = SharedFolder::RECORDS;
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

/// Record of a complete shard, `shards/NAME.json`. It is also the list of the files that later runs may
/// replace.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ShardRecord {
    /// Name of the shard.
    pub(crate) name: String,
    /// Name of the log.
    pub(crate) log: String,
    /// What the shard was made from.
    pub(crate) input: ShardInput,
    /// First key frame and the one after the last.
    pub(crate) frames: [usize; 2],
    /// Number of samples.
    pub(crate) samples: usize,
    /// Skipped and missing items, by kind.
    pub(crate) notes: BTreeMap<String, usize>,
    /// Files in order of their paths.
    pub(crate) files: Vec<ShardFile>,
}

/// Input fingerprints of a shard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ShardInput {
    /// Of the recording.
    pub(crate) log: String,
    /// Of the skeleton's manifest, which has checksums of all points. `None` without maps, or if it is
    /// unknown.
    pub(crate) skeleton: Option<String>,
    /// Of the HD map; `None` if it is not drawn or if there is none.
    pub(crate) map: Option<String>,
    /// Of the template library; `None` without one.
    pub(crate) templates: Option<String>,
}

impl ShardInput {
    /// Returns what differs in the input of another shard; `None` if nothing does. A skeleton that was
    /// removed does not differ.
    fn difference(&self, other: &Self) -> Option<&'static str> {
        match (&self.skeleton, &other.skeleton) {
            _ if self.log != other.log => Some("recording"),
            (Some(ours), Some(theirs)) if ours != theirs => Some("skeleton"),
            _ if self.map != other.map => Some("HD map"),
            _ if self.templates != other.templates => Some("template library"),
            _ => None,
        }
    }
}

impl ShardRecord {
    /// Reads the record of a shard and checks that its files exist with their lengths, with `verify` also
    /// their checksums. `None` if the shard has to be written. With `input`, its fingerprints are compared.
    ///
    /// # Errors
    /// Fails if a file cannot be read, or if the shard has other frames. Fails if it is of another input,
    /// which is written again with `verify`.
    pub(crate) fn read(
        out: &Path,
        unit: &WorkUnit,
        input: Option<&ShardInput>,
        verify: bool,
    ) -> Result<Option<Self>, FileError> {
        let Some(record) = Self::parse(out, unit)? else { return Ok(None) };
        if let Some(difference) = input.and_then(|input| input.difference(&record.input)) {
            if verify {
                return Ok(None);
            }
            let expected = format!("a shard of this {difference}");
            let found = format!(
                "one of another {difference} or state of its name; use another folder, or --verify to write \
                    it again"
            );
            return Err(FileError::content(expected, found, &out.join(record_path(&unit.name))));
        }
        for file in &record.files {
            let path = out.join(&file.path);
            let is_whole = path.metadata().is_ok_and(|data| data.is_file() && data.len() == file.bytes);
            if !is_whole || verify && hash_of(&path)? != file.sha256 {
                return Ok(None);
            }
        }
        Ok(Some(record).filter(|record| !record.files.is_empty()))
    }

    /// Returns the record of a shard; `None` if there is none, or an empty file.
    ///
    /// # Errors
    /// Fails if the file is not the record of this shard, or if it cannot be read.
    pub(crate) fn parse(out: &Path, unit: &WorkUnit) -> Result<Option<Self>, FileError> {
        let path = out.join(record_path(&unit.name));
        if !is_there(&path)? {
            return Ok(None);
        }
        let bytes = read_table(&path)?;
        if bytes.is_empty() {
            return Ok(None); // after a power failure
        }
        let record: Self = json::parse(&bytes, "the record of a shard", &path)?;
        if !record.files.iter().all(|file| is_below(&file.path)) {
            return Err(FileError::content("paths below the export", "another path", &path));
        }
        let [first, end] = record.frames;
        if record.name != unit.name || (first..end) != unit.frames {
            let expected =
                format!("shard {} of frames {}..{}", unit.name, unit.frames.start, unit.frames.end);
            let found = format!("shard {} of frames {first}..{end}; use another folder", record.name);
            return Err(FileError::content(expected, found, &path));
        }
        Ok(Some(record))
    }
}

/// Returns the path of a record in the export.
fn record_path(name: &str) -> PathBuf {
    Path::new(RECORDS).join(format!("{name}.json"))
}

/// Files of an unfinished shard. They are removed on drop, by a signal, or by the next process that writes
/// the shard.
pub(crate) struct Shard {
    folder: SharedFolder,
    out: PathBuf,
    unit: WorkUnit,
    /// Options of the export; `None` if nothing is to be published.
    options: Option<ExportOptions>,
    files: Vec<ShardFile>,
    notes: BTreeMap<String, usize>,
}

impl Shard {
    /// Begins a shard of an export in `out`.
    ///
    /// # Errors
    /// Fails with [`FileError::Busy`] if another process writes it, or on an I/O error.
    pub(crate) fn begin(out: &Path, unit: &WorkUnit) -> Result<Self, FileError> {
        let owned = || {
            let earlier = ShardRecord::parse(out, unit)?;
            Ok(earlier.into_iter().flat_map(|record| record.files).map(|file| file.path).collect())
        };
        let folder = SharedFolder::begin(out, &unit.name, &record_path(&unit.name), owned)?;
        Ok(Self {
            folder,
            out: out.to_owned(),
            unit: unit.clone(),
            options: None,
            files: Vec::new(),
            notes: BTreeMap::new(),
        })
    }

    /// Binds the shard to the options of its export. They are compared now and again when the shard is
    /// published: another process that found no shard may replace them meanwhile.
    ///
    /// # Errors
    /// Fails if the export has other options.
    pub(crate) fn with_options(self, options: &ExportOptions) -> Result<Self, FileError> {
        claim::check(&self.out, options)?;
        Ok(Self { options: Some(options.clone()), ..self })
    }

    /// Removes what a process left that was killed after it had written the record.
    pub(crate) fn remove_leftovers(out: &Path, unit: &WorkUnit) {
        if SharedFolder::has_leftovers(out, &unit.name) {
            // The shard is complete in any case; another process may be removing them.
            drop(Self::begin(out, unit));
        }
    }

    /// Checks that a file at a path in the export may be written, for use before the work.
    ///
    /// # Errors
    /// Fails if a file that is not of this shard is there.
    #[cfg(feature = "video")]
    pub(crate) fn check(&self, path: impl AsRef<Path>) -> Result<(), FileError> {
        self.folder.check(path.as_ref())
    }

    /// Returns the name of the shard.
    pub(crate) fn name(&self) -> &str {
        &self.unit.name
    }

    /// Returns the key frames of the shard.
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
        let (place, shown) = (self.folder.create(path)?, self.out.join(path));
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
    /// Fails if the export has other options by now, or if a file cannot be moved or written.
    pub(crate) fn publish(mut self, mut record: ShardRecord) -> Result<ShardRecord, FileError> {
        self.options.as_ref().map_or(Ok(()), |options| claim::check(&self.out, options))?;
        record.notes.append(&mut self.notes);
        self.files.sort_by(|a, b| a.path.cmp(&b.path));
        let paths = self.files.iter().map(|file| file.path.clone()).collect();
        let record = ShardRecord { files: self.files, ..record };
        self.folder.publish(&paths, |path| write_json(path, &record))?;
        Ok(record)
    }
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
mod tests;
