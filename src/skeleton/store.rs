//! Skeleton on disk: a folder with `skeleton.json`, three files of 16-byte points, and a table of pages for
//! each.
//!
//! # How it works
//! Renderers read pages when they are seen ([`Skeleton::clouds`]). Whoever needs all points maps their file
//! ([`Skeleton::background`]).

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use rayon::prelude::*;

use super::BuildOptions;
use super::entry::Entry;
use super::manifest::{Asset, BuildReport, Chunk, Manifest, PageChecksums, Source, Template};
use crate::cloud::paged::{CloudSummary, PagedFile, PagedWriter, StoredCloud};
use crate::cloud::{Bounds, Cloud, Point};
use crate::dataset::{Recording, is_fingerprint};
use crate::error::FileError;
use crate::files::input::{is_taken, read_table};
use crate::files::{
    Checksum, Inputs, SKELETON as KIND, WholeFolder, WorkFolder, check_whole, inputs_of_whole, json,
    write_json, write_whole_by,
};
use crate::gpu::MappedFile;

const MANIFEST: &str = "skeleton.json";
/// File of points and table of pages.
type PointFiles = [&'static str; 2];
const BACKGROUND: PointFiles = ["background.points", "background.pages"];
const ACTORS: PointFiles = ["actors.points", "actors.pages"];
const TEMPLATES: PointFiles = ["templates.points", "templates.pages"];

/// Function that generates templates from the assets of a skeleton: manifest entries with their points.
pub type GenerateTemplates<'a> =
    dyn Fn(&[(&Asset, &[Point])]) -> Result<Vec<(Template, Vec<Point>)>, FileError> + 'a;

/// Writer of a skeleton, cloud by cloud: chunks, then assets, then templates, each in their final order.
pub struct SkeletonWriter {
    folder: PathBuf,
    background: PagedWriter,
    actors: PagedWriter,
    templates: PagedWriter,
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
        let file = |files: PointFiles| {
            let [points, pages] = files.map(|name| folder.join(name));
            PagedWriter::create(&points, &pages)
        };
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

    /// Adds points to the next chunk, which [`SkeletonWriter::end_chunk`] adds.
    pub(super) fn chunk_points(&mut self, points: &[Point]) -> Result<(), FileError> {
        self.background.append(points)
    }

    /// Adds a chunk of the background with the points passed since the last one.
    pub(super) fn end_chunk(&mut self, origin: [f64; 3]) {
        let cloud = self.background.end();
        let Some(bounds) = cloud.bounds else { return };
        self.manifest.background.push(Chunk { origin, points: cloud.points, bounds, xxh3: cloud.xxh3 });
    }

    /// Adds points to the next asset, which [`SkeletonWriter::end_actor`] adds.
    pub(super) fn actor_points(&mut self, points: &[Point]) -> Result<(), FileError> {
        self.actors.append(points)
    }

    /// Adds the asset of a track with the points passed since the last one; `asset` gets their number, bounds
    /// and checksum.
    pub(super) fn end_actor(&mut self, asset: impl FnOnce(&CloudSummary, Bounds) -> Asset) {
        let cloud = self.actors.end();
        let Some(bounds) = cloud.bounds else { return };
        self.manifest.actors.push(asset(&cloud, bounds));
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
        let file = MappedFile::open(self.actors.path())?;
        let clouds = slices(&file, self.manifest.actors.iter().map(|a| a.points));
        let assets: Vec<(&Asset, &[Point])> = self.manifest.actors.iter().zip(clouds).collect();
        for (template, points) in make(&assets)? {
            self.template(template, &points)?;
        }
        Ok(())
    }

    /// Writes the tables of pages, then the manifest.
    ///
    /// # Errors
    /// Fails if a file cannot be written, or if a position, bound or size is beyond the limits of all files.
    pub fn finish(
        &mut self,
        sources: Vec<Source>,
        options: BuildOptions,
        report: BuildReport,
    ) -> Result<(), FileError> {
        self.manifest.pages = PageChecksums {
            background: self.background.finish()?,
            actors: self.actors.finish()?,
            templates: self.templates.finish()?,
        };
        (self.manifest.sources, self.manifest.options, self.manifest.report) = (sources, options, report);
        let path = self.folder.join(MANIFEST);
        // A skeleton that cannot be opened must not replace one that can.
        self.manifest.check(&path)?;
        write_json(&path, &self.manifest)
    }
}

/// Skeleton on disk.
#[derive(Debug)]
pub struct Skeleton {
    /// Contents of the point files.
    pub manifest: Manifest,
    path: PathBuf,
    background: PointStore,
    actors: PointStore,
    templates: PointStore,
}

impl Skeleton {
    /// Returns whether a folder looks like a skeleton.
    pub fn is_at(path: &Path) -> bool {
        is_taken(&path.join(MANIFEST))
    }

    /// Opens a skeleton's files and validates their sizes against the manifest, and the tables of pages.
    /// Points are validated when they are read.
    ///
    /// # Errors
    /// Fails if a file is missing or damaged, or has another format or version.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let format = (Manifest::FORMAT, Manifest::VERSION);
        let manifest: Manifest = read_manifest(&path.join(MANIFEST), "a skeleton manifest", format)?;
        manifest.check(&path.join(MANIFEST))?;
        let Manifest { pages, background, actors, templates, .. } = &manifest;
        Ok(Self {
            background: PointStore::open(path, BACKGROUND, background, pages.background)?,
            actors: PointStore::open(path, ACTORS, actors, pages.actors)?,
            templates: PointStore::open(path, TEMPLATES, templates, pages.templates)?,
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

    /// Returns all clouds for a rasterizer: background chunks, then assets, then templates. Their points are
    /// read and validated when they are rendered.
    pub fn clouds(&self) -> Vec<Cloud<'_>> {
        let files = [&self.background, &self.actors, &self.templates];
        files.into_iter().flat_map(|store| store.paged.clouds().map(Cloud::Stored)).collect()
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

    /// Validates all points now; returns one error for each chunk, asset and template that is damaged or
    /// cannot be read.
    pub fn damage(&self) -> Vec<FileError> {
        let files = [&self.background, &self.actors, &self.templates];
        let clouds: Vec<StoredCloud> = files.into_iter().flat_map(|store| store.paged.clouds()).collect();
        clouds.par_iter().filter_map(|cloud| cloud.check().err()).collect()
    }
}

/// A file of points.
#[derive(Debug)]
struct PointStore {
    path: PathBuf,
    paged: PagedFile,
    /// Set when all points are first needed.
    mapped: OnceLock<MappedFile>,
    /// Set once all checksums were validated.
    checked: OnceLock<()>,
}

impl PointStore {
    fn open(
        folder: &Path,
        files: PointFiles,
        entries: &[impl Entry],
        xxh3: Checksum,
    ) -> Result<Self, FileError> {
        let [path, table] = files.map(|name| folder.join(name));
        let clouds = entries.iter().enumerate().map(|(i, entry)| (entry.name(i), entry.points()));
        let paged = PagedFile::open(&path, &table, clouds, xxh3)?;
        Ok(Self { path, paged, mapped: OnceLock::new(), checked: OnceLock::new() })
    }

    /// Returns the clouds that entries of a manifest describe; validates their checksums on first use.
    fn clouds(&self, entries: &[impl Entry]) -> Result<Vec<&[Point]>, FileError> {
        if self.checked.get().is_none() {
            let numbered = entries.par_iter().zip(self.slices(entries)?).enumerate();
            let damage = numbered.filter_map(|(i, (entry, cloud))| entry.check(i, cloud, &self.path).err());
            damage.find_first(|_| true).map_or(Ok(()), Err)?;
            // Another thread may have set the same value.
            let _ = self.checked.set(());
        }
        self.slices(entries)
    }

    fn slices(&self, entries: &[impl Entry]) -> Result<Vec<&[Point]>, FileError> {
        let mapped = match self.mapped.get() {
            Some(mapped) => mapped,
            None => {
                let mapped = MappedFile::open(&self.path)?;
                // It may have been replaced since it was opened.
                self.paged.check_size(mapped.as_bytes().len() as u64)?;
                self.mapped.get_or_init(|| mapped)
            }
        };
        Ok(slices(mapped, entries.iter().map(Entry::points)))
    }
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
        let is_older = format == own_format && version.as_u64().is_some_and(|v| v < own_version.into());
        let advice = if is_older { " (written by an earlier version of pskel: make it again)" } else { "" };
        let found = format!("format {format} version {version}{advice}");
        return Err(FileError::content(expected, found, path));
    }
    // From the text, whose errors have a place.
    json::parse(&text, what, path)
}
