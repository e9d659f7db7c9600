use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use point_skeleton::dataset::{DatasetError, TrackSummary};
use point_skeleton::files::input::is_taken;
use point_skeleton::skeleton::{Skeleton, TemplateLibrary};
use serde_json::Value;

use crate::args::log::LogRoots;
use crate::logs;
use crate::{WrongUsage, print_result};

mod file;
mod log;
mod skeleton;
mod templates;
mod verify;

pub(crate) use skeleton::dropped;

/// Describe a log, a skeleton or a file, and report missing or damaged parts
///
/// Of a log, the tables are read completely; of sweeps and images, only sizes and headers, and the points of
/// a few sweeps. Missing and damaged files are named, and the exit code is then 1.
#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// [FORMAT:]PATH[@VERSION][#SCENE], a skeleton or template folder, or a file (.pcd.bin, .pcd, .feather,
    /// .npy, .ply, .json cameras, JPEG, PNG)
    #[arg(value_name = "LOG|SKELETON|FILE")]
    target: String,
    #[command(flatten)]
    roots: LogRoots,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
    /// List the tracks of a log: id, category, size, times after its first frame, length of the path
    #[arg(long)]
    tracks: bool,
    /// Read all points of a skeleton or of templates and compare them with their checksums; fails if any
    /// differ
    #[arg(long)]
    verify: bool,
}

/// Runs the command: describes the target. Missing and damaged files of a log are an error after the
/// description, as are wrong checksums with --verify.
pub(crate) fn run(args: InfoArgs) -> anyhow::Result<()> {
    let verified = args.verify.then(|| verify::verify(&args.target)).transpose()?;
    let (mut json, mut text) = describe(&args.target, &args.roots, args.tracks)?;
    if let Some(verified) = &verified {
        json["verified"] = verified.json();
        text.push_str(&verified.text());
    }
    if args.json {
        print_result(&serde_json::to_string_pretty(&json)?);
    } else {
        print_result(text.trim_end());
    }
    let damaged = log::damaged(&json);
    anyhow::ensure!(damaged == 0, "missing or damaged files: {damaged}, in {}", args.target);
    verified.map_or(Ok(()), |verified| verified.result(&args.target))
}

fn describe(target: &str, roots: &LogRoots, tracks: bool) -> anyhow::Result<(Value, String)> {
    let path = PathBuf::from(target);
    let is_no_log = |what: &str| match tracks {
        true => Err(WrongUsage(format!("--tracks lists the tracks of a log, and this is {what}: {target}"))),
        false => Ok(()),
    };
    if Skeleton::is_at(&path) {
        is_no_log("a skeleton")?;
        let skeleton = Skeleton::open(&path)?;
        return Ok((skeleton::describe(&skeleton), skeleton::text(&skeleton)));
    }
    if TemplateLibrary::is_at(&path) {
        is_no_log("a template library")?;
        let library = TemplateLibrary::open(&path)?;
        return Ok((templates::describe(&library, &path), templates::text(&library, &path)));
    }
    match logs::locate(target) {
        Ok(locator) => {
            let log = logs::open(&roots.locate(&locator))?;
            let mut json = log::describe(&log)?;
            let mut text = log::text(&json);
            if tracks {
                let list = TrackSummary::of(log.recording());
                text.push_str(&log::tracks_text(log.recording(), &list));
                json["track_list"] = serde_json::to_value(list)?;
            }
            return Ok((json, text));
        }
        // Another file or folder.
        Err(DatasetError::Locator { .. }) if path.exists() || !target.contains(':') => {}
        Err(error) => return Err(WrongUsage(error.to_string()).into()),
    }
    if is_taken(&path) && !path.is_dir() {
        is_no_log("a file")?;
        let json = file::describe(&path)?;
        return Ok((json.clone(), as_lines(&json)));
    }
    let found = what_is_there(&path);
    bail!(
        "expected a log (its path, or FORMAT:PATH, like nuscenes:PATH or town:), a skeleton's folder or a \
            file, found {found}: {target}"
    )
}

fn what_is_there(path: &Path) -> &'static str {
    if path.is_dir() { "another folder" } else { "nothing" }
}

/// Formats an object as aligned lines `key value`.
fn as_lines(json: &Value) -> String {
    let line = |(key, value): (&String, &Value)| match value {
        Value::String(text) => format!("{key:<12} {text}\n"),
        other => format!("{key:<12} {other}\n"),
    };
    json.as_object().map(|object| object.iter().map(line).collect()).unwrap_or_default()
}
