//! Interrupted and resumed builds, and images that color two frames.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use point_skeleton::dataset::{DatasetError, ImageRecord, LogReader, Recording, Sweep, SweepRecord};
use point_skeleton::error::FileError;
use point_skeleton::skeleton::{
    self, BuildError, BuildInput, BuildOptions, BuildReport, BuildRun, Progress, Skeleton,
};
use pskel_testing::shared::WithLog;
use pskel_testing::six_cameras::{self, FRAMES};
use pskel_testing::tiny_log::tree;

/// A log whose sweeps can be read only a limited number of times.
struct Breaking<'a> {
    drive: &'a dyn LogReader,
    left: AtomicUsize,
}

impl LogReader for Breaking<'_> {
    fn recording(&self) -> &Recording {
        self.drive.recording()
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        let take_one = |left: usize| left.checked_sub(1);
        match self.left.fetch_update(Ordering::SeqCst, Ordering::SeqCst, take_one) {
            Ok(_) => self.drive.read_sweep(record),
            Err(_) => Err(FileError::io("read", &record.path)(std::io::Error::other("a broken disk")).into()),
        }
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        self.drive.read_image(record)
    }
}

/// Small windows, so that a build advances along the log.
fn options(voxel_m: f64) -> BuildOptions {
    BuildOptions { voxel_m, color_window: 2, occlusion_window: 1, ..BuildOptions::default() }
}

fn build(
    out: &Path,
    log: &dyn LogReader,
    options: &BuildOptions,
    [checkpoint_frames, resume]: [usize; 2],
) -> Result<Skeleton, BuildError> {
    let run = BuildRun { checkpoint_frames, resume: resume == 1, ..BuildRun::default() };
    skeleton::build(out, &[BuildInput::all(log)], options, &|_| Ok(Vec::new()), &run)
}

#[test]
fn a_build_resumes_after_any_failure_to_the_same_bytes() {
    let (_files, drive) = six_cameras::read();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sk");
    for voxel_m in [0.0, 0.05] {
        let options = options(voxel_m);
        build(&out, &drive, &options, [100, 0]).unwrap();
        let whole = tree(&out);
        std::fs::remove_dir_all(&out).unwrap();
        let mut retained = 0;
        for reads in 0..FRAMES {
            let breaking = Breaking { drive: &drive, left: AtomicUsize::new(reads) };
            match build(&out, &breaking, &options, [1, 0]) {
                Err(BuildError::Interrupted { frames, path, .. }) => {
                    assert!(frames < FRAMES && path == folder.path().join("sk.partial"), "{frames}");
                    retained = retained.max(frames);
                    build(&out, &drive, &options, [2, 1]).unwrap();
                    assert!(tree(&out) == whole, "voxel {voxel_m}, {reads} reads, {frames} frames");
                    std::fs::remove_dir_all(&out).unwrap();
                }
                Err(BuildError::Dataset(_)) => {}
                other => panic!("{other:?}"),
            }
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
        }
        assert!(retained >= 2, "some builds break late: {retained}");
    }
}

/// Requests a stop after some inquiries.
struct Stopping(AtomicUsize);

impl Progress for Stopping {
    fn start(&self, _: &str, _: usize) {}

    fn step(&self) {}

    fn is_stopped(&self) -> bool {
        self.0.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1)).is_err()
    }
}

#[test]
fn a_build_stops_before_the_next_frame_is_read() {
    let (_files, drive) = six_cameras::read();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sk");
    let options = options(0.0);
    build(&out, &drive, &options, [100, 0]).unwrap();
    let whole = tree(&out);
    std::fs::remove_dir_all(&out).unwrap();
    let stopped = |inquiries: usize, log: &dyn LogReader| {
        let progress = Stopping(AtomicUsize::new(inquiries));
        let run = BuildRun { checkpoint_frames: 1, progress: &progress, ..BuildRun::default() };
        skeleton::build(&out, &[BuildInput::all(log)], &options, &|_| Ok(Vec::new()), &run)
    };
    let unreadable = Breaking { drive: &drive, left: AtomicUsize::new(0) };
    assert!(matches!(stopped(0, &unreadable), Err(BuildError::Stopped)));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
    // The first frame is complete after the two that follow it, which color it too.
    let first = stopped(FRAMES.min(4), &drive).unwrap_err();
    assert!(matches!(first, BuildError::Interrupted { frames, .. } if frames > 0), "{first:?}");
    build(&out, &drive, &options, [2, 1]).unwrap();
    assert!(tree(&out) == whole);
}

/// If cameras are slower than the LiDAR, one image serves two frames, as if the second frame had its own
/// copy.
#[test]
fn an_image_shared_by_two_frames_colors_both() {
    let (_files, drive) = six_cameras::read();
    let folder = tempfile::tempdir().unwrap();
    let reports = |images: Vec<ImageRecord>| {
        let mut log = drive.recording().clone();
        log.frames.truncate(2);
        log.frames[1].images = images;
        let shared = WithLog { drive: &drive, log };
        [options(0.0), BuildOptions::every_camera()].map(|options| {
            build(&folder.path().join("sk"), &shared, &options, [20, 0]).unwrap().manifest.report
        })
    };
    let images = &drive.recording().frames[0].images;
    let copied = |(i, image): (usize, &ImageRecord)| {
        let path = folder.path().join(format!("{i}.jpg"));
        std::fs::copy(&image.path, &path).unwrap();
        ImageRecord { path, ..image.clone() }
    };
    let [same, copies] = [images.clone(), images.iter().enumerate().map(copied).collect()].map(reports);
    // With a color window the first frame's images are cached and not read twice; without a window they are.
    let cameras = images.len();
    assert_eq!(same.each_ref().map(|r| r.images), [cameras, 2 * cameras]);
    assert_eq!(copies.each_ref().map(|r| r.images), [2 * cameras; 2]);
    let uncolored = |reports: &[BuildReport; 2]| reports.each_ref().map(|r| r.dropped_uncolored);
    assert_eq!(uncolored(&same), uncolored(&copies));
    // Without images the second frame would lose all its points.
    let [_, every] = reports(Vec::new());
    assert!(every.dropped_uncolored > same[1].dropped_uncolored + same[1].points_read / 4);
}
