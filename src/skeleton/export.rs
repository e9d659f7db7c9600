//! Export of a skeleton's points to files of other tools.

use std::collections::BTreeSet;
use std::path::Path;

use glam::{DVec3, Vec3};
use serde::Serialize;

use super::{Asset, Skeleton, Template, TemplateKind};
use crate::cloud::{PRECISE_WITHIN_M, Point, PointFormat, Precision, origin_of};
use crate::error::FileError;
use crate::files::{FileName, Inputs, WholeFolder, write_json};

/// Kind of the output folder.
const KIND: &str = "points";
const ORIGINS: &str = "origins.json";

/// Content of `origins.json`.
#[derive(Serialize)]
struct Origins {
    background: BackgroundFile,
    actors: Vec<ActorFile>,
    templates: Vec<TemplateFile>,
}

#[derive(Serialize)]
struct BackgroundFile {
    file: String,
    /// Global position that the coordinates are relative to, meters.
    origin: [f64; 3],
    points: usize,
}

/// Coordinates are relative to the center of the box, x forward.
#[derive(Serialize)]
struct ActorFile {
    file: String,
    track: String,
    category: String,
    class: u8,
    /// Length, width, height of the box, meters.
    size: [f64; 3],
    points: usize,
}

#[derive(Serialize)]
struct TemplateFile {
    file: String,
    kind: TemplateKind,
    class: u8,
    points: usize,
}

impl Skeleton {
    /// Writes all points to a folder: `background`, `actors/TRACK` and `templates/KIND`, without classes, and
    /// `origins.json`, which has the origin of the background's coordinates and the file of each track. An
    /// older export in the folder is replaced once the new one is complete. Returns notes on background
    /// points that are so far from the origin that they lose precision.
    ///
    /// # Errors
    /// Fails if points do not match their checksum, if the folder has other content, or if a file cannot be
    /// written.
    pub fn export(&self, folder: &Path, format: PointFormat) -> Result<Vec<String>, FileError> {
        let mut notes = Vec::new();
        WholeFolder::open(folder, KIND, &Inputs::new([self.path()]))?.write(|folder| {
            let (background, note) = write_background(self, folder, format)?;
            notes.extend(note);
            let origins = Origins {
                background,
                actors: write_actors(self, folder, format)?,
                templates: write_templates(self, folder, format)?,
            };
            write_json(&folder.join(ORIGINS), &origins)
        })?;
        Ok(notes)
    }
}

fn write_background(
    skeleton: &Skeleton,
    folder: &Path,
    format: PointFormat,
) -> Result<(BackgroundFile, Option<String>), FileError> {
    let origins = skeleton.manifest.background.iter().map(|chunk| DVec3::from(chunk.origin));
    let chunks: Vec<(DVec3, &[Point])> = origins.zip(skeleton.background()?).collect();
    let origin = origin_of_background(&chunks);
    let (mut points, mut precision) = (Vec::new(), Precision::default());
    for (chunk_origin, cloud) in chunks {
        let shift = chunk_origin - origin;
        points.extend(cloud.iter().map(|p| {
            let position = (Vec3::from(p.position).as_dvec3() + shift).as_vec3().to_array();
            precision.add(position);
            Point { position, ..*p }
        }));
    }
    let file = format!("background.{}", format.extension());
    format.write(&folder.join(&file), &points, false)?;
    let note = precision.note(points.len(), Some(origin));
    Ok((BackgroundFile { file, origin: origin.to_array(), points: points.len() }, note))
}

/// Returns the middle of the chunks near most points, in whole meters. Chunks are given by their origin and
/// points.
fn origin_of_background<'a>(chunks: &[(DVec3, &'a [Point])]) -> DVec3 {
    let positions = |(origin, cloud): &(DVec3, &'a [Point])| {
        let origin = *origin;
        cloud.iter().map(move |p| origin + Vec3::from(p.position).as_dvec3())
    };
    let most = origin_of(chunks.iter().flat_map(positions));
    let near = || {
        let origins = chunks.iter().map(|(origin, _)| *origin);
        origins.filter(|origin| (origin - most).abs().max_element() <= PRECISE_WITHIN_M)
    };
    let ends = near().reduce(DVec3::min).zip(near().reduce(DVec3::max));
    ends.map_or(most, |(min, max)| ((min + max) / 2.0).round())
}

fn write_actors(
    skeleton: &Skeleton,
    folder: &Path,
    format: PointFormat,
) -> Result<Vec<ActorFile>, FileError> {
    create(&folder.join("actors"))?;
    let mut names = BTreeSet::new();
    let actors = skeleton.manifest.actors.iter().zip(skeleton.actors()?);
    let write = |(asset, points): (&Asset, &[Point])| {
        let file = format!("actors/{}.{}", file_name(&asset.track, &mut names), format.extension());
        format.write(&folder.join(&file), points, false)?;
        let (track, category) = (asset.track.clone(), asset.category.clone());
        let (class, size) = (asset.class as u8, asset.size);
        Ok(ActorFile { file, track, category, class, size, points: points.len() })
    };
    actors.map(write).collect()
}

fn write_templates(
    skeleton: &Skeleton,
    folder: &Path,
    format: PointFormat,
) -> Result<Vec<TemplateFile>, FileError> {
    create(&folder.join("templates"))?;
    let templates = skeleton.manifest.templates.iter().zip(skeleton.templates()?);
    let write = |(template, points): (&Template, &[Point])| {
        let file = format!("templates/{}.{}", template.kind.name(), format.extension());
        format.write(&folder.join(&file), points, false)?;
        Ok(TemplateFile { file, kind: template.kind, class: template.class as u8, points: points.len() })
    };
    templates.map(write).collect()
}

fn create(folder: &Path) -> Result<(), FileError> {
    std::fs::create_dir(folder).map_err(FileError::io("create", folder))
}

/// Returns a unique file name for a track: the beginning of its id with special characters replaced, and a
/// number appended if the name is taken.
fn file_name(track: &str, taken: &mut BTreeSet<String>) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' };
    let name: String = track.chars().take(FileName::MAX_BYTES).map(plain).collect();
    let mut unique = name.clone();
    for number in 2.. {
        if taken.insert(unique.clone()) {
            break;
        }
        unique = format!("{name}-{number}");
    }
    unique
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_become_file_names() {
        let mut taken = BTreeSet::new();
        let mut name = |track| file_name(track, &mut taken);
        assert_eq!(
            [name("ab-1"), name("../x"), name(".._x"), name("___x")],
            ["ab-1", "___x", "___x-2", "___x-3"]
        );
    }
}
