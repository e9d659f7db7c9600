use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use glam::{DVec3, Vec3};
use point_skeleton::cloud::{self, Point, npy, ply};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::{WholeFolder, check_output_file, write_json};
use point_skeleton::skeleton::{Skeleton, TemplateKind};
use serde::Serialize;

use super::{WrongUsage, log_args, say};

/// Convert points: a skeleton to NPY or PLY files, or one such file to the other format
///
/// A skeleton becomes a folder with background, actors/TRACK and templates/KIND, floats Nx6 (x y z r g b), and
/// origins.json, which holds the origin of the background's coordinates and the file of each track.
#[derive(Debug, Args)]
pub(super) struct ConvertArgs {
    /// Skeleton folder, or a file of points
    #[arg(value_name = "SKEL|P.npy|P.ply")]
    input: PathBuf,
    /// Folder or file to write
    #[arg(long, value_name = "PATH", value_parser = log_args::output_folder())]
    out: PathBuf,
    /// Format to write [default: npy for a skeleton; for a file, the extension of --out]
    #[arg(long, value_enum)]
    format: Option<PointFormat>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PointFormat {
    Npy,
    Ply,
}

impl PointFormat {
    fn ending(self) -> &'static str {
        match self {
            Self::Npy => "npy",
            Self::Ply => "ply",
        }
    }

    fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        [Self::Npy, Self::Ply].into_iter().find(|format| format.ending() == ending)
    }

    fn write(self, path: &Path, points: &[Point], with_class: bool) -> Result<(), FileError> {
        match self {
            Self::Npy => npy::write(path, points, with_class),
            Self::Ply => ply::write(path, points),
        }
    }
}

/// Runs the command: reads and writes points.
pub(super) fn run(args: ConvertArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let what = if args.input.is_dir() {
        convert_skeleton(&args.input, &args.out, args.format.unwrap_or(PointFormat::Npy))?
    } else {
        convert_file(&args)?
    };
    say(&format!("converted {what} in {:.2} s: {}", start.elapsed().as_secs_f64(), args.out.display()));
    Ok(())
}

/// Origin file beside points whose coordinates are relative to an origin.
#[derive(Serialize)]
struct FileOrigin {
    origin: [f64; 3],
}

fn convert_file(args: &ConvertArgs) -> anyhow::Result<String> {
    let format = match (args.format, PointFormat::of(&args.out)) {
        (None, None) => {
            return Err(WrongUsage("expected --out ending in .npy or .ply, or --format".to_owned()).into());
        }
        (Some(format), Some(ending)) if format != ending => {
            let message =
                format!("expected --out ending in .{}, found .{}", format.ending(), ending.ending());
            return Err(WrongUsage(message).into());
        }
        (format, ending) => format.or(ending).unwrap_or(PointFormat::Npy),
    };
    check_output_file(&args.out, [args.input.as_path()])?;
    let file = cloud::read(&args.input)?;
    let with_class = file.points.iter().any(|p| p.class() != 0);
    let origin = if file.origin == DVec3::ZERO {
        String::new()
    } else {
        // Written before the points, so that points never exist without their origin.
        let path = args.out.with_extension("origin.json");
        write_json(&path, &FileOrigin { origin: file.origin.to_array() })?;
        format!(", relative to the origin in {}", path.display())
    };
    format.write(&args.out, &file.points, with_class)?;
    Ok(format!("{} points{origin}", file.points.len()))
}

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

fn convert_skeleton(input: &Path, out: &Path, format: PointFormat) -> Result<String, FileError> {
    let skeleton = Skeleton::open(input)?;
    WholeFolder::open(out, "points", &[input])?.write::<FileError>(|folder| {
        let origins = Origins {
            background: write_background(&skeleton, folder, format)?,
            actors: write_actors(&skeleton, folder, format)?,
            templates: write_templates(&skeleton, folder, format)?,
        };
        write_json(&folder.join(ORIGINS), &origins)
    })?;
    let manifest = &skeleton.manifest;
    let points: usize = manifest.background.iter().map(|c| c.points).sum();
    let (actors, templates) = (manifest.actors.len(), manifest.templates.len());
    Ok(format!("{points} background points, {actors} actors, {templates} templates"))
}

fn write_background(
    skeleton: &Skeleton,
    folder: &Path,
    format: PointFormat,
) -> Result<BackgroundFile, FileError> {
    let chunks = &skeleton.manifest.background;
    let origins = || chunks.iter().map(|c| DVec3::from(c.origin));
    let ends = origins().reduce(DVec3::min).zip(origins().reduce(DVec3::max));
    let origin = ends.map_or(DVec3::ZERO, |(min, max)| ((min + max) / 2.0).round());
    let mut points = Vec::new();
    for (chunk, cloud) in chunks.iter().zip(skeleton.background()?) {
        let shift = DVec3::from(chunk.origin) - origin;
        points.extend(cloud.iter().map(|p| {
            let position = (Vec3::from(p.position).as_dvec3() + shift).as_vec3();
            Point { position: position.to_array(), ..*p }
        }));
    }
    let file = format!("background.{}", format.ending());
    format.write(&folder.join(&file), &points, false)?;
    Ok(BackgroundFile { file, origin: origin.to_array(), points: points.len() })
}

fn write_actors(
    skeleton: &Skeleton,
    folder: &Path,
    format: PointFormat,
) -> Result<Vec<ActorFile>, FileError> {
    create(&folder.join("actors"))?;
    let mut names = BTreeSet::new();
    let actors = skeleton.manifest.actors.iter().zip(skeleton.actors()?);
    let write = |(asset, points): (&point_skeleton::skeleton::Asset, &[Point])| {
        let file = format!("actors/{}.{}", file_name(&asset.track, &mut names), format.ending());
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
    let write = |(template, points): (&point_skeleton::skeleton::Template, &[Point])| {
        let known = TemplateKind::NAMES.iter().find(|(_, kind)| *kind == template.kind);
        let name = known.map_or("template", |(name, _)| name);
        let file = format!("templates/{name}.{}", format.ending());
        format.write(&folder.join(&file), points, false)?;
        Ok(TemplateFile { file, kind: template.kind, class: template.class as u8, points: points.len() })
    };
    templates.map(write).collect()
}

fn create(folder: &Path) -> Result<(), FileError> {
    std::fs::create_dir(folder).map_err(FileError::io("create", folder))
}

/// Returns a unique file name for a track: the beginning of its id with special characters replaced, and a number
/// appended if the name is taken.
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
    fn tracks_become_names_of_files() {
        let mut taken = BTreeSet::new();
        let mut name = |track| file_name(track, &mut taken);
        assert_eq!(
            [name("ab-1"), name("../x"), name(".._x"), name("___x")],
            ["ab-1", "___x", "___x-2", "___x-3"]
        );
    }
}
