//! A skeleton on disk: a folder with `skeleton.json` and three files of 16-byte points that are memory-mapped.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::BuildOptions;
use super::manifest::{Asset, BuildReport, Chunk, Manifest, Source, Template};
use crate::cloud::Point;
use crate::error::{FileError, write_json, write_whole, write_whole_folder};
use crate::gpu::MappedFile;

const MANIFEST: &str = "skeleton.json";
const BACKGROUND: &str = "background.points";
const ACTORS: &str = "actors.points";
const TEMPLATES: &str = "templates.points";

/// A skeleton in memory, as the builder makes it.
#[derive(Clone, Debug, Default)]
pub struct BuiltSkeleton {
    /// Where it comes from.
    pub source: Source,
    /// How it was made.
    pub options: BuildOptions,
    /// What went in and what was left out.
    pub report: BuildReport,
    /// Chunks with their points.
    pub background: Vec<(Chunk, Vec<Point>)>,
    /// Assets with their points, sorted by track.
    pub actors: Vec<(Asset, Vec<Point>)>,
    /// Templates with their points.
    pub templates: Vec<(Template, Vec<Point>)>,
}

impl BuiltSkeleton {
    /// Writes the folder under a temporary name beside `path`, then renames it. An older skeleton at `path` is
    /// replaced; a folder with anything else is refused.
    ///
    /// # Errors
    /// The system's, a folder that is no skeleton; nothing is left half-written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        write_whole_folder(path, MANIFEST, |folder| self.write_into(folder))
    }

    fn write_into(&self, folder: &Path) -> Result<(), FileError> {
        write_points(&folder.join(BACKGROUND), self.background.iter().map(|(_, p)| p))?;
        write_points(&folder.join(ACTORS), self.actors.iter().map(|(_, p)| p))?;
        write_points(&folder.join(TEMPLATES), self.templates.iter().map(|(_, p)| p))?;
        let path = folder.join(MANIFEST);
        write_json(&path, &self.manifest())
    }

    fn manifest(&self) -> Manifest {
        Manifest {
            format: Manifest::FORMAT.into(),
            version: Manifest::VERSION,
            source: self.source.clone(),
            options: self.options.clone(),
            report: self.report.clone(),
            background: self.background.iter().map(|(c, _)| c.clone()).collect(),
            actors: self.actors.iter().map(|(a, _)| a.clone()).collect(),
            templates: self.templates.iter().map(|(t, _)| t.clone()).collect(),
        }
    }
}

fn write_points<'a>(path: &Path, clouds: impl Iterator<Item = &'a Vec<Point>>) -> Result<(), FileError> {
    write_whole(path, |writer| {
        for cloud in clouds {
            writer.write_all(bytemuck::cast_slice(cloud)).map_err(FileError::io("write", path))?;
        }
        Ok(())
    })
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
        path.join(MANIFEST).is_file()
    }

    /// Maps a skeleton's files and checks their sizes against the manifest.
    ///
    /// # Errors
    /// A missing or damaged file, another format or version.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let manifest = read_manifest(&path.join(MANIFEST))?;
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

fn read_manifest(path: &Path) -> Result<Manifest, FileError> {
    let text = std::fs::read(path).map_err(FileError::io("read", path))?;
    let wrong = |e: serde_json::Error| FileError::content("a skeleton manifest", e.to_string(), path);
    // The version first: what else stands there depends on it.
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(wrong)?;
    let (format, version) = (&value["format"], &value["version"]);
    if format != Manifest::FORMAT || version != Manifest::VERSION {
        let expected = format!("format {:?} version {}", Manifest::FORMAT, Manifest::VERSION);
        return Err(FileError::content(expected, format!("format {format} version {version}"), path));
    }
    serde_json::from_value(value).map_err(wrong)
}
