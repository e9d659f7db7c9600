//! Skeleton on disk: a folder with `skeleton.json` and three memory-mapped files of 16-byte points.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use rayon::prelude::*;

use super::entry::Entry;
use super::manifest::{Asset, BuildReport, Chunk, Manifest, Source, Template};
use super::{BuildOptions, Checksum};
use crate::cloud::Point;
use crate::dataset::{Recording, is_fingerprint};
use crate::error::FileError;
use crate::files::input::{is_taken, read_table};
use crate::files::{
    Inputs, SKELETON as KIND, WholeFolder, WorkFolder, check_whole, inputs_of_whole, json, write_json,
    write_whole_by,
};
use crate::gpu::MappedFile;

const MANIFEST: &str = "skeleton.json";
const BACKGROUND: &str = "background.points";
const ACTORS: &str = "actors.points";
const TEMPLATES: &str = "templates.points";

/// Function that generates templates from the assets of a skeleton: manifest entries with their points.
pub type GenerateTemplates<'a> =
    dyn Fn(&[(&Asset, &[Point])]) -> Result<Vec<(Template, Vec<Point>)>, FileError> + 'a;

/// Writer of a skeleton, cloud by cloud: chunks, then assets, then templates, each in their final order.
pub struct SkeletonWriter {
    folder: PathBuf,
    background: PointFile,
    actors: PointFile,
    templates: PointFile,
    manifest: Manifest,
}

impl SkeletonWriter {
    /// Writes the folder under a temporary name beside `path`, then renames it. `fill` adds the clouds and
    /// ends with [`SkeletonWriter::finish`]. An existing skeleton at `path` is replaced.
    ///
    /// # Errors
    /// Returns any error of `fill`. Fails if a file cannot be written or if `path` holds anything but a
    /// skeleton. Partial output is removed.
    pub fn write<E: From<FileError>>(
        path: &Path,
        fill: impl FnOnce(&mut Self) -> Result<(), E>,
    ) -> Result<(), E> {
        WholeFolder::open(path, KIND, &Inputs::default())?.write(|folder| fill(&mut Self::new(folder)?))
    }

    /// Checks that a skeleton may be written at a path: it does not exist, is empty, or is a skeleton without
    /// foreign files, and it is no input.
    ///
    /// # Errors
    /// Fails if the path holds anything else.
    pub fn check_target(path: &Path, inputs: &Inputs) -> Result<(), FileError> {
        check_whole(path, KIND, inputs)
    }

    /// Writes a skeleton of logs with some fingerprints as [`SkeletonWriter::write`] does, in a work folder
    /// that the caller owns.
    pub(super) fn write_by<E: From<FileError>>(
        path: &Path,
        work: &WorkFolder,
        logs: &[String],
        fill: impl FnOnce(&mut Self) -> Result<(), E>,
    ) -> Result<(), E> {
        write_whole_by(work, path, (KIND, logs), |folder| fill(&mut Self::new(folder)?))
    }

    fn new(folder: &Path) -> Result<Self, FileError> {
        let file = |name: &str| PointFile::create(&folder.join(name));
        Ok(Self {
            folder: folder.to_owned(),
            background: file(BACKGROUND)?,
            actors: file(ACTORS)?,
            templates: file(TEMPLATES)?,
            manifest: Manifest::default(),
        })
    }

    /// Adds a chunk of the background.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn chunk(&mut self, chunk: Chunk, points: &[Point]) -> Result<(), FileError> {
        self.manifest.background.push(chunk);
        self.background.add(points)
    }

    /// Adds the asset of a track.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn actor(&mut self, asset: Asset, points: &[Point]) -> Result<(), FileError> {
        self.manifest.actors.push(asset);
        self.actors.add(points)
    }

    /// Adds a template.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn template(&mut self, template: Template, points: &[Point]) -> Result<(), FileError> {
        self.manifest.templates.push(template);
        self.templates.add(points)
    }

    /// Generates templates from the assets written so far and adds them.
    ///
    /// # Errors
    /// Returns any error of `make`. Fails if a file cannot be read or written.
    pub fn templates_from(&mut self, make: &GenerateTemplates) -> Result<(), FileError> {
        self.actors.flush()?;
        let file = MappedFile::open(&self.actors.path)?;
        let clouds = slices(&file, self.manifest.actors.iter().map(|a| a.points));
        let assets: Vec<(&Asset, &[Point])> = self.manifest.actors.iter().zip(clouds).collect();
        for (template, points) in make(&assets)? {
            self.template(template, &points)?;
        }
        Ok(())
    }

    /// Flushes all files, then writes the manifest.
    ///
    /// # Errors
    /// Fails if a file cannot be written, or if a position, bound or size is beyond the limits of all files.
    pub fn finish(
        &mut self,
        sources: Vec<Source>,
        options: BuildOptions,
        report: BuildReport,
    ) -> Result<(), FileError> {
        [&mut self.background, &mut self.actors, &mut self.templates]
            .into_iter()
            .try_for_each(PointFile::flush)?;
        (self.manifest.sources, self.manifest.options, self.manifest.report) = (sources, options, report);
        let path = self.folder.join(MANIFEST);
        // A skeleton that cannot be opened must not replace one that can.
        self.manifest.check(&path)?;
        write_json(&path, &self.manifest)
    }
}

/// Append-only file of points.
struct PointFile {
    path: PathBuf,
    file: BufWriter<File>,
}

impl PointFile {
    fn create(path: &Path) -> Result<Self, FileError> {
        let file = File::create(path).map_err(FileError::io("create", path))?;
        Ok(Self { path: path.to_owned(), file: BufWriter::with_capacity(1 << 20, file) })
    }

    fn add(&mut self, points: &[Point]) -> Result<(), FileError> {
        self.file.write_all(bytemuck::cast_slice(points)).map_err(FileError::io("write", &self.path))
    }

    fn flush(&mut self) -> Result<(), FileError> {
        self.file.flush().map_err(FileError::io("write", &self.path))
    }
}

/// Skeleton on disk, memory-mapped.
#[derive(Debug)]
pub struct Skeleton {
    /// Contents of the point files.
    pub manifest: Manifest,
    path: PathBuf,
    background: MappedPoints,
    actors: MappedPoints,
    templates: MappedPoints,
}

impl Skeleton {
    /// Returns whether a folder looks like a skeleton.
    pub fn is_at(path: &Path) -> bool {
        is_taken(&path.join(MANIFEST))
    }

    /// Maps a skeleton's files and validates their sizes against the manifest. Checksums are validated on
    /// first access.
    ///
    /// # Errors
    /// Fails if a file is missing or damaged, or has another format or version.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let format = (Manifest::FORMAT, Manifest::VERSION);
        let manifest: Manifest = read_manifest(&path.join(MANIFEST), "a skeleton manifest", format)?;
        manifest.check(&path.join(MANIFEST))?;
        let map = |name: &str, points: u128| {
            let file = path.join(name);
            let mapped = MappedFile::open(&file)?;
            let (found, expected) = (mapped.as_bytes().len() as u128, points * size_of::<Point>() as u128);
            if found != expected {
                let expected = format!("{expected} bytes ({points} points)");
                return Err(FileError::content(expected, format!("{found} bytes"), &file));
            }
            Ok(MappedPoints { path: file, map: mapped, checked: OnceLock::new() })
        };
        Ok(Self {
            background: map(BACKGROUND, total(manifest.background.iter().map(|c| c.points)))?,
            actors: map(ACTORS, total(manifest.actors.iter().map(|a| a.points)))?,
            templates: map(TEMPLATES, total(manifest.templates.iter().map(|t| t.points)))?,
            path: path.to_owned(),
            manifest,
        })
    }

    /// Opens a skeleton that was built from a log: its coordinates are in the log's global frame.
    ///
    /// # Errors
    /// Fails as [`Skeleton::open`], or if the skeleton was built from other logs.
    pub fn open_for(path: &Path, log: &Recording) -> Result<Self, FileError> {
        let skeleton = Self::open(path)?;
        if skeleton.manifest.times_us(&log.name).is_none() {
            let logs: Vec<&str> =
                skeleton.manifest.sources.iter().map(|source| source.log.as_str()).collect();
            let (expected, found) =
                (format!("a skeleton of log {}", log.name), format!("one of log {}", logs.join(", ")));
            return Err(FileError::content(expected, found, path));
        }
        Ok(skeleton)
    }

    /// Returns the checksum of a skeleton's manifest, which contains the checksums of all points, as 16
    /// hexadecimal digits. `None` if there is no skeleton.
    ///
    /// # Errors
    /// Fails if the manifest cannot be read.
    pub fn fingerprint_at(path: &Path) -> Result<Option<String>, FileError> {
        let path = path.join(MANIFEST);
        Ok(if is_taken(&path) { Some(Checksum::of(&read_table(&path)?).to_string()) } else { None })
    }

    /// Returns whether the skeleton was built from this recording, rather than from another one or another
    /// state of the same name. `None` without comparable fingerprints, as in earlier versions.
    ///
    /// # Errors
    /// Fails if the list of the skeleton's files cannot be read.
    pub fn is_of(&self, log: &Recording) -> Result<Option<bool>, FileError> {
        let mut known = inputs_of_whole(&self.path, KIND)?;
        known.retain(|input| is_fingerprint(input));
        Ok((!known.is_empty()).then(|| known.contains(&log.fingerprint())))
    }

    /// Checks that the skeleton was built from this recording, see [`Skeleton::is_of`]. Without fingerprints,
    /// the place, the times and the tracks are compared.
    ///
    /// # Errors
    /// Fails if it was built from another recording.
    pub fn check_recording(&self, log: &Recording) -> Result<(), FileError> {
        if self.is_of(log)?.unwrap_or_else(|| self.manifest.resembles(log)) {
            return Ok(());
        }
        let expected = format!(
            "a skeleton of the recording {} with the same frames, poses, cameras, files, categories and \
                boxes",
            log.name
        );
        let found =
            "one of another recording or state of that name; remove it, or use another folder of skeletons";
        Err(FileError::content(expected, found, &self.path))
    }

    /// Returns the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the points of each background chunk.
    ///
    /// # Errors
    /// Fails if the points of a chunk do not match their checksum.
    pub fn background(&self) -> Result<Vec<&[Point]>, FileError> {
        self.background.clouds(&self.manifest.background)
    }

    /// Returns the points of each actor asset.
    ///
    /// # Errors
    /// Fails if the points of an asset do not match their checksum.
    pub fn actors(&self) -> Result<Vec<&[Point]>, FileError> {
        self.actors.clouds(&self.manifest.actors)
    }

    /// Returns the points of each template.
    ///
    /// # Errors
    /// Fails if the points of a template do not match their checksum.
    pub fn templates(&self) -> Result<Vec<&[Point]>, FileError> {
        self.templates.clouds(&self.manifest.templates)
    }

    /// Validates all points now; returns one error for each damaged chunk, asset and template.
    pub fn damage(&self) -> Vec<FileError> {
        let Self { manifest, background, actors, templates, .. } = self;
        let mut damage = background.damage(&manifest.background);
        damage.extend(actors.damage(&manifest.actors));
        damage.extend(templates.damage(&manifest.templates));
        damage
    }
}

/// Memory-mapped file of points.
#[derive(Debug)]
struct MappedPoints {
    path: PathBuf,
    map: MappedFile,
    /// Set once all checksums were validated.
    checked: OnceLock<()>,
}

impl MappedPoints {
    /// Returns the clouds that entries of a manifest describe; validates their checksums on first use.
    fn clouds(&self, entries: &[impl Entry]) -> Result<Vec<&[Point]>, FileError> {
        if self.checked.get().is_none() {
            self.damage(entries).into_iter().next().map_or(Ok(()), Err)?;
            // Another thread may have set the same value.
            let _ = self.checked.set(());
        }
        Ok(self.slices(entries))
    }

    /// Returns an error for each cloud that does not match its checksum, in the order of the file.
    fn damage(&self, entries: &[impl Entry]) -> Vec<FileError> {
        let clouds = self.slices(entries);
        let numbered = entries.par_iter().zip(clouds).enumerate();
        numbered.filter_map(|(i, (entry, cloud))| entry.check(i, cloud, &self.path).err()).collect()
    }

    fn slices(&self, entries: &[impl Entry]) -> Vec<&[Point]> {
        slices(&self.map, entries.iter().map(Entry::points))
    }
}

/// Sums in `u128`, so that no manifest can cause an overflow.
fn total(points: impl Iterator<Item = usize>) -> u128 {
    points.map(|p| p as u128).sum()
}

/// Splits a file of points into clouds of given lengths, whose sum [`Skeleton::open`] has validated.
fn slices(file: &MappedFile, lengths: impl Iterator<Item = usize>) -> Vec<&[Point]> {
    // An empty file has no mapping, thus no alignment.
    let bytes = file.as_bytes();
    let mut rest: &[Point] = if bytes.is_empty() { &[] } else { bytemuck::cast_slice(bytes) };
    lengths
        .map(|length| {
            let (cloud, tail) = rest.split_at(length);
            rest = tail;
            cloud
        })
        .collect()
}

/// Reads a manifest of a format and version; `what` describes it in messages.
pub(in crate::skeleton) fn read_manifest<T: serde::de::DeserializeOwned>(
    path: &Path,
    what: &str,
    (own_format, own_version): (&str, u32),
) -> Result<T, FileError> {
    let text = read_table(path)?;
    // The version is checked first, since the other fields depend on it.
    let value: serde_json::Value = json::parse(&text, what, path)?;
    let (format, version) = (&value["format"], &value["version"]);
    if format != own_format || version != own_version {
        let expected = format!("format {own_format:?} version {own_version}");
        return Err(FileError::content(expected, format!("format {format} version {version}"), path));
    }
    // From the text, whose errors have a place.
    json::parse(&text, what, path)
}
