//! Unfinished skeleton builds to resume.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use image::RgbImage;
use point_skeleton::dataset::{DatasetError, ImageRecord, LogReader, Recording, Sweep, SweepRecord};
use point_skeleton::error::FileError;
use point_skeleton::skeleton::{BuildError, BuildInput, BuildOptions, BuildRun, build};
use serde_json::Value;

use super::{LARGE, edit_seeds, edited, seed};
use crate::check::assert_names_file_in;
use crate::folder::Folder;
use crate::synthetic_log::SyntheticLog;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 1] =
    [Target { name: "build", run: resume, seeds, max_len: 512, memory: LARGE }];

/// A log whose last image cannot be read: a build fails after the checkpoints of all earlier frames.
struct Broken(SyntheticLog);

impl LogReader for Broken {
    fn recording(&self) -> &Recording {
        self.0.recording()
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        self.0.read_sweep(record)
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        if self.recording().frames.last().is_some_and(|last| last.t_us == record.t_us) {
            return Err(
                FileError::io("read", Path::new("made"))(std::io::Error::other("a broken disk")).into()
            );
        }
        self.0.read_image(record)
    }
}

/// Files left by an interrupted build.
struct Unfinished {
    folder: Folder,
    /// Names of its files.
    files: Vec<String>,
    synthetic: SyntheticLog,
}

thread_local! {
    static UNFINISHED: RefCell<Unfinished> = RefCell::new(Unfinished::new());
}

const OUT: &str = "s";
const CHECKPOINT: &str = "s.partial/checkpoint.json";

fn options() -> BuildOptions {
    BuildOptions { voxel_m: 0.5, color_window: 0, occlusion_window: 0, ..BuildOptions::default() }
}

fn run_resumed(out: PathBuf, dataset: &dyn LogReader) -> Result<(), BuildError> {
    let run = BuildRun { resume: true, checkpoint_frames: 1, ..BuildRun::default() };
    build(&out, &[BuildInput::all(dataset)], &options(), &|_| Ok(Vec::new()), &run).map(|_| ())
}

impl Unfinished {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let stopped = run_resumed(folder.path().join(OUT), &Broken(SyntheticLog::new(3)));
        assert!(matches!(stopped, Err(BuildError::Interrupted { frames: 2, .. })), "{stopped:?}");
        let folder = Folder::copy_of(folder.path());
        let files = folder.names();
        Self { folder, files, synthetic: SyntheticLog::new(3) }
    }

    /// Changes the file selected by the first byte: JSON by edits, checksums by positions (one byte), each
    /// with its new byte.
    fn change(&mut self, data: &[u8]) {
        let (number, changes) = data.split_first().unwrap_or((&0, &[]));
        let name = self.files[usize::from(*number) % self.files.len()].clone();
        let mut bytes = self.folder.base(&name).to_vec();
        if name.ends_with(".json") {
            let base: Value = serde_json::from_slice(&bytes).expect("JSON");
            bytes = edited(&base, changes).to_string().into_bytes();
        } else {
            for [at, byte] in changes.as_chunks().0 {
                if let Some(place) = bytes.get_mut(usize::from(*at)) {
                    *place = *byte;
                }
            }
        }
        self.folder.put(&name, &bytes);
    }
}

fn resume(data: &[u8]) {
    UNFINISHED.with_borrow_mut(|unfinished| {
        unfinished.folder.rewrite();
        unfinished.change(data);
        let out = unfinished.folder.path(OUT);
        if let Err(error) = run_resumed(out.clone(), &unfinished.synthetic) {
            assert_names_file_in(error, unfinished.folder.root(), data);
        }
        let _ = std::fs::remove_dir_all(out); // if the build succeeded
    });
}

fn seeds() -> Vec<Seed> {
    let unfinished = Unfinished::new();
    let number = unfinished.files.iter().position(|name| name == CHECKPOINT).unwrap_or_default() as u8;
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, number));
    for other in 0..unfinished.files.len() as u8 {
        seeds.push(seed(&format!("file{other}"), [other, 3, 255, 9, 200, 0, 128]));
    }
    seeds
}
