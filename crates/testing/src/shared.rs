//! Locations of test data, and skeletons built from it.

use std::io::Write;
use std::path::{Path, PathBuf};

use point_skeleton::dataset::{DatasetError, ImageRecord, LogReader, Recording, Sweep, SweepRecord};
use point_skeleton::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton};

/// Returns the folder of recordings and fixtures: `PSKEL_SHARED`, else `../shared` from the project's root.
/// Returns `None` if neither exists; the caller then returns, and the test counts as skipped.
pub fn shared(what: &str) -> Option<PathBuf> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let folder = std::env::var_os("PSKEL_SHARED").map_or_else(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    skip(&format!("{what} is not at {} (set PSKEL_SHARED)", folder.display()));
    None
}

/// Prints that the running test is skipped, and appends its name to the file that `PSKEL_SKIP_LOG` names.
pub fn skip(why: &str) {
    let test = std::thread::current().name().unwrap_or("?").to_owned();
    eprintln!("skipped {test}: {why}");
    if let Some(log) = std::env::var_os("PSKEL_SKIP_LOG") {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(log).unwrap();
        writeln!(file, "{test}").unwrap();
    }
}

/// Returns the folder of fixtures: `PSKEL_FIXTURES`, else `fixtures` in the shared folder.
pub fn fixtures(what: &str) -> Option<PathBuf> {
    std::env::var_os("PSKEL_FIXTURES").map(PathBuf::from).or_else(|| shared(what).map(|s| s.join("fixtures")))
}

/// Builds a skeleton from some frames of a log, without templates.
pub fn skeleton_of(out: &Path, log: &dyn LogReader, frames: &[usize], options: &BuildOptions) -> Skeleton {
    let input = BuildInput { reader: log, frames: frames.to_vec() };
    skeleton::build(out, &[input], options, &|_| Ok(Vec::new()), &BuildRun::default()).unwrap()
}

/// Files of one dataset combined with another log.
pub struct WithLog<'a> {
    pub drive: &'a dyn LogReader,
    pub log: Recording,
}

impl<'a> WithLog<'a> {
    /// Keeps only the sweeps of some frames and drops all images, so that all points are retained, in gray.
    /// Boxes stay, because they define the moving objects.
    pub fn grey(drive: &'a dyn LogReader, retained: &[usize]) -> Self {
        let mut log = drive.recording().clone();
        for (index, frame) in log.frames.iter_mut().enumerate() {
            frame.images.clear();
            if !retained.contains(&index) {
                frame.sweeps.clear();
            }
        }
        Self { drive, log }
    }
}

impl LogReader for WithLog<'_> {
    fn recording(&self) -> &Recording {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        self.drive.read_sweep(record)
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        self.drive.read_image(record)
    }
}

/// Fails unless the message of a peer's error is short, contains `part` and ends with the peer's address.
pub fn assert_error_contains(error: &impl std::fmt::Display, part: &str, address: &impl std::fmt::Display) {
    let message = error.to_string();
    assert!(message.contains(part) && message.ends_with(&address.to_string()), "{message}\nexpected {part}");
    assert!(message.len() < 600, "{message}");
}
