//! A skeleton on disk: a folder with `skeleton.json` and three files of 16-byte points that are memory-mapped.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::manifest::{Asset, BuildReport, Chunk, Manifest, Source, Template};
use super::{BuildOptions, MakeTemplates};
use crate::cloud::Point;
use crate::error::{FileError, check_only_ours, write_json, write_whole_folder, write_whole_folder_by};
use crate::files::input::{is_taken, read_table};
use crate::gpu::MappedFile;

const MANIFEST: &str = "skeleton.json";
const BACKGROUND: &str = "background.points";
const ACTORS: &str = "actors.points";
const TEMPLATES: &str = "templates.points";

/// Writes a skeleton cloud by cloud: first chunks, then assets, then templates, each in the order they are to have.
pub struct SkeletonWriter {
    folder: PathBuf,
    background: PointFile,
    actors: PointFile,
    templates: PointFile,
    manifest: Manifest,
}

impl SkeletonWriter {
    /// Writes the folder under a temporary name beside `path`, then renames it. `fill` adds the clouds and ends with
    /// [`SkeletonWriter::finish`]. An older skeleton at `path` is replaced; a folder with anything else is refused.
    ///
    /// # Errors
    /// Those of `fill`, the system's, a folder that is no skeleton; nothing is left half-written.
    pub fn write<E: From<FileError>>(
        path: &Path,
        fill: impl FnOnce(&mut Self) -> Result<(), E>,
    ) -> Result<(), E> {
        write_whole_folder(path, MANIFEST, |folder| fill(&mut Self::new(folder)?))
    }

    /// Whether a skeleton may be written at a path.
    ///
    /// # Errors
    /// Something else is there.
    pub fn check_target(path: &Path) -> Result<(), FileError> {
        check_only_ours(path, MANIFEST, |name| [MANIFEST, BACKGROUND, ACTORS, TEMPLATES].contains(&name))
    }

    /// The same with the temporary folder in `scratch`, a folder of the same file system.
    pub(super) fn write_by<E: From<FileError>>(
        path: &Path,
        scratch: &Path,
        fill: impl FnOnce(&mut Self) -> Result<(), E>,
    ) -> Result<(), E> {
        write_whole_folder_by(path, MANIFEST, scratch, |folder| fill(&mut Self::new(folder)?))
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
    /// The system's.
    pub fn chunk(&mut self, chunk: Chunk, points: &[Point]) -> Result<(), FileError> {
        self.manifest.background.push(chunk);
        self.background.add(points)
    }

    /// Adds the asset of a track.
    ///
    /// # Errors
    /// The system's.
    pub fn actor(&mut self, asset: Asset, points: &[Point]) -> Result<(), FileError> {
        self.manifest.actors.push(asset);
        self.actors.add(points)
    }

    /// Adds a template.
    ///
    /// # Errors
    /// The system's.
    pub fn template(&mut self, template: Template, points: &[Point]) -> Result<(), FileError> {
        self.manifest.templates.push(template);
        self.templates.add(points)
    }

    /// Adds what is made from the assets written so far.
    ///
    /// # Errors
    /// Those of `make`, the system's.
    pub fn templates_from(&mut self, make: &MakeTemplates) -> Result<(), FileError> {
        self.actors.flush()?;
        let file = MappedFile::open(&self.actors.path)?;
        let clouds = slices(&file, self.manifest.actors.iter().map(|a| a.points));
        let assets: Vec<(&Asset, &[Point])> = self.manifest.actors.iter().zip(clouds).collect();
        for (template, points) in make(&assets)? {
            self.template(template, &points)?;
        }
        Ok(())
    }

    /// Writes what remains, and the manifest, the last of all.
    ///
    /// # Errors
    /// The system's.
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
        write_json(&self.folder.join(MANIFEST), &self.manifest)
    }
}

/// A file of points that grows.
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

/// A skeleton on disk, memory-mapped.
#[derive(Debug)]
pub struct Skeleton {
    /// What it holds.
    pub manifest: Manifest,
    path: PathBuf,
    background: MappedFile,
    actors: MappedFile,
    templates: MappedFile,
}

impl Skeleton {
    /// Whether a folder looks like a skeleton.
    pub fn is_at(path: &Path) -> bool {
        is_taken(&path.join(MANIFEST))
    }

    /// Maps a skeleton's files and checks their sizes against the manifest.
    ///
    /// # Errors
    /// A missing or damaged file, another format or version.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let format = (Manifest::FORMAT, Manifest::VERSION);
        let manifest: Manifest = read_manifest(&path.join(MANIFEST), "a skeleton manifest", format)?;
        let map = |name: &str, points: u128| {
            let file = path.join(name);
            let mapped = MappedFile::open(&file)?;
            let (found, expected) = (mapped.as_bytes().len() as u128, points * size_of::<Point>() as u128);
            if found != expected {
                let expected = format!("{expected} bytes ({points} points)");
                return Err(FileError::content(expected, format!("{found} bytes"), &file));
            }
            Ok(mapped)
        };
        Ok(Self {
            background: map(BACKGROUND, total(manifest.background.iter().map(|c| c.points)))?,
            actors: map(ACTORS, total(manifest.actors.iter().map(|a| a.points)))?,
            templates: map(TEMPLATES, total(manifest.templates.iter().map(|t| t.points)))?,
            path: path.to_owned(),
            manifest,
        })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Points of each background chunk.
    pub fn background(&self) -> Vec<&[Point]> {
        slices(&self.background, self.manifest.background.iter().map(|c| c.points))
    }

    /// Points of each actor asset.
    pub fn actors(&self) -> Vec<&[Point]> {
        slices(&self.actors, self.manifest.actors.iter().map(|a| a.points))
    }

    /// Points of each template.
    pub fn templates(&self) -> Vec<&[Point]> {
        slices(&self.templates, self.manifest.templates.iter().map(|t| t.points))
    }
}

/// Without overflow, whatever a manifest claims.
fn total(points: impl Iterator<Item = usize>) -> u128 {
    points.map(|p| p as u128).sum()
}

/// Cuts a file of points into clouds of given lengths, which [`Skeleton::open`] has checked.
fn slices(file: &MappedFile, lengths: impl Iterator<Item = usize>) -> Vec<&[Point]> {
    // An empty file has no map, thus no alignment.
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

/// Reads a manifest of a format and version; `what` it is is for messages.
pub(in crate::skeleton) fn read_manifest<T: serde::de::DeserializeOwned>(
    path: &Path,
    what: &str,
    (own_format, own_version): (&str, u32),
) -> Result<T, FileError> {
    let text = read_table(path)?;
    let wrong = |e: serde_json::Error| FileError::content(what, e.to_string(), path);
    // The version first: what else stands there depends on it.
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(wrong)?;
    let (format, version) = (&value["format"], &value["version"]);
    if format != own_format || version != own_version {
        let expected = format!("format {own_format:?} version {own_version}");
        return Err(FileError::content(expected, format!("format {format} version {version}"), path));
    }
    serde_json::from_value(value).map_err(wrong)
}
