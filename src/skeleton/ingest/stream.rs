//! Sequential frames of a log with colored points.
//!
//! # How it works
//! A point can take its color from images of some frames before and after its own. Occlusion in such an image
//! is determined by the sweeps around that image. Sweeps and images are therefore retained in a window that
//! moves along the log, so memory does not grow with the log's length. Frames that have left the window are
//! emitted while the next ones are read.

use std::collections::VecDeque;

use glam::DAffine3;
use rayon::prelude::*;

use super::color;
use super::color::estimator::{Candidate, ColorView};
use super::error::BuildError;
use super::occlusion::OcclusionGrid;
use super::projector::{Pixels, PointColumns};
use super::request::{BuildInput, Progress};
use super::sweep::SweepCloud;
use crate::dataset::{DatasetError, Frame, ImageRecord, LogReader, Recording, SweepRecord, TrackBox};
use crate::geometry::{Camera, View};
use crate::skeleton::{BuildOptions, Coloring, Projector, Splitter, Trajectories};

/// Number of frames whose sweeps are read at once.
const READ_AHEAD: usize = 4;

/// Bytes of an image's pixel, with its part of the occlusion map.
const IMAGE_BYTES: u64 = 4;

/// Reader of a log for a build.
pub(super) struct Stream<'a> {
    reader: &'a dyn LogReader,
    pub(super) log: &'a Recording,
    pub(super) frames: Vec<&'a Frame>,
    pub(super) trajectories: Trajectories,
    options: &'a BuildOptions,
    has_images: bool,
}

/// Colored points of a frame.
#[derive(Default)]
pub(super) struct FrameCloud {
    /// One cloud per sweep.
    pub(super) sweeps: Vec<SweepCloud>,
    /// Image count of the frame.
    pub(super) images: usize,
    /// Number of sweeps and images that were skipped because their files are damaged.
    pub(super) damaged: [usize; 2],
}

impl<'a> Stream<'a> {
    pub(super) fn new(input: &BuildInput<'a>, options: &'a BuildOptions) -> Result<Self, BuildError> {
        let log = input.reader.recording();
        let frame =
            |&i: &usize| log.frames.get(i).ok_or(BuildError::Frame { frames: log.frames.len(), found: i });
        let frames: Vec<&Frame> = input.frames.iter().map(frame).collect::<Result<_, _>>()?;
        let trajectories = Trajectories::new(log, &frames);
        let has_images = frames.iter().any(|f| !f.images.is_empty());
        Ok(Self { reader: input.reader, log, frames, trajectories, options, has_images })
    }

    /// Returns two half widths in frames: of the images that may color a point, and of the sweeps that
    /// determine occlusion in an image.
    fn windows(&self) -> [usize; 2] {
        match (self.has_images, self.options.occlusion_test) {
            (false, _) => [0, 0],
            (true, false) => [self.options.color_window, 0],
            (true, true) => [self.options.color_window, self.options.occlusion_window],
        }
    }

    /// Returns the sweeps of a frame that are used.
    pub(super) fn sweeps<'f>(&self, frame: &'f Frame) -> impl Iterator<Item = &'f SweepRecord> {
        let between = self.options.between_sweeps;
        frame.sweeps.iter().filter(move |sweep| sweep.is_key || between)
    }

    /// Returns the mean number of points in the sweeps of a frame, the first one that has sweeps; 0 if none
    /// can be read.
    pub(super) fn points_of_a_sweep(&self) -> u64 {
        let first = self.frames.iter().find(|frame| self.sweeps(frame).next().is_some());
        let sweeps: Vec<&SweepRecord> = first.iter().flat_map(|frame| self.sweeps(frame)).collect();
        // A damaged file is reported when its turn comes.
        let read = sweeps.par_iter().filter_map(|sweep| self.reader.read_sweep(sweep).ok());
        let points: usize = read.map(|sweep| sweep.points.len()).sum();
        (points / sweeps.len().max(1)) as u64
    }

    /// Returns the memory of the window that moves along the log, bytes, for some number of points in a
    /// sweep.
    pub(super) fn window_bytes(&self, points: u64) -> u64 {
        let [color, hide] = self.windows();
        let most =
            |count: &dyn Fn(&usize) -> u64| (0..self.frames.len()).map(|i| count(&i)).max().unwrap_or(0);
        let pixels = |record: &ImageRecord| u64::from(record.camera.width) * u64::from(record.camera.height);
        let image_bytes = most(&|frame| self.records(*frame).into_iter().map(pixels).sum()) * IMAGE_BYTES;
        let sweep_bytes = most(&|frame| self.sweeps(self.frames[*frame]).count() as u64)
            * points
            * size_of::<Candidate>() as u64;
        let frames = |count: usize| count.min(self.frames.len()) as u64;
        // The images of a frame are decoded while the window's are in memory.
        frames(2 * color + 2) * image_bytes + frames(2 * color.max(hide) + 1 + READ_AHEAD) * sweep_bytes
    }

    /// Emits the frames from index `first` on, in order. The emitted frames do not depend on `first`.
    ///
    /// # Errors
    /// Fails if sweeps or images cannot be read, or if `progress` requests a stop, before each frame that is
    /// read. Returns any error of `emit`.
    pub(super) fn run(
        &self,
        first: usize,
        progress: &dyn Progress,
        mut emit: impl FnMut(FrameCloud) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let [color, hide] = self.windows();
        let keep = color.max(hide);
        let first_view = first.saturating_sub(color);
        let mut window = Window { start: first_view.saturating_sub(hide), clouds: VecDeque::new() };
        let mut views: VecDeque<(usize, Vec<ColorView>)> = VecDeque::new();
        let mut leaving: Vec<FrameCloud> = Vec::new();
        for step in first_view..self.frames.len() + keep {
            if progress.is_stopped() {
                return Err(BuildError::Stopped);
            }
            // `emit` stays on this thread, on which progress callbacks may depend.
            let mut read = Ok(());
            rayon::in_place_scope(|scope| {
                scope.spawn(|_| read = self.read_step(step, &mut window, &mut views, progress));
                leaving.drain(..).try_for_each(&mut emit)
            })?;
            read?;
            if let Some(frame) = step.checked_sub(color).filter(|f| (first..self.frames.len()).contains(f)) {
                self.color_frame(&mut window.clouds[frame - window.start].sweeps, &views);
            }
            while views.front().is_some_and(|(frame, _)| frame + 2 * color <= step) {
                views.pop_front();
            }
            while step.checked_sub(keep).is_some_and(|last| window.start <= last) {
                let Some(cloud) = window.clouds.pop_front() else { break };
                if window.start >= first {
                    leaving.push(cloud);
                }
                window.start += 1;
            }
        }
        leaving.into_iter().try_for_each(emit)
    }

    /// Reads what the frame at index `step` needs, if there is one.
    fn read_step(
        &self,
        step: usize,
        window: &mut Window,
        views: &mut VecDeque<(usize, Vec<ColorView>)>,
        progress: &dyn Progress,
    ) -> Result<(), BuildError> {
        if step < self.frames.len() {
            self.read_ahead(window, step + self.windows()[1], progress)?;
            let records = self.new_records(step);
            let loaded = self.load_views(step, &records, window, progress)?;
            let cloud = &mut window.clouds[step - window.start];
            cloud.images = loaded.len();
            cloud.damaged[1] = records.len() - loaded.len();
            views.push_back((step, loaded));
        }
        Ok(())
    }

    /// Reads the sweeps of frames up to index `last`, and of a few further frames.
    fn read_ahead(
        &self,
        window: &mut Window,
        last: usize,
        progress: &dyn Progress,
    ) -> Result<(), BuildError> {
        let next = window.start + window.clouds.len();
        if next > last.min(self.frames.len() - 1) {
            return Ok(());
        }
        let frames = next..(last + READ_AHEAD).min(self.frames.len());
        let records: Vec<(usize, &SweepRecord)> =
            frames.clone().flat_map(|i| self.sweeps(self.frames[i]).map(move |sweep| (i, sweep))).collect();
        let read: Vec<_> =
            records.par_iter().map(|(i, record)| (*i, self.read_sweep(self.frames[*i], record))).collect();
        window.clouds.extend(frames.map(|_| FrameCloud::default()));
        for (i, read) in read {
            let cloud = &mut window.clouds[i - window.start];
            match self.unless_damaged(read, progress)? {
                Some(sweep) => cloud.sweeps.push(sweep),
                None => cloud.damaged[0] += 1,
            }
        }
        Ok(())
    }

    /// Returns the content of a file; `None` if it is damaged, which is reported, and the log's policy is to
    /// skip it.
    fn unless_damaged<T>(
        &self,
        read: Result<T, DatasetError>,
        progress: &dyn Progress,
    ) -> Result<Option<T>, BuildError> {
        let message = read.as_ref().err().map(ToString::to_string);
        let content = self.log.unless_damaged(read)?;
        message.iter().for_each(|message| progress.skipped(message));
        Ok(content)
    }

    fn read_sweep(&self, frame: &Frame, record: &SweepRecord) -> Result<SweepCloud, DatasetError> {
        let sweep = self.reader.read_sweep(record)?;
        let boxes = self.boxes_at(frame, record.t_us);
        let splitter = Splitter::new(&boxes, &self.trajectories, record.t_us, &self.options.split);
        let mut cloud = SweepCloud::split(&sweep, record, &splitter, &self.options.split);
        match (self.has_images, self.options.coloring) {
            (false, _) => cloud.make_grey(),
            (true, Coloring::Agreed) => cloud.sort_in_space(),
            // Copies of points change the blocks.
            (true, Coloring::EveryCamera) => {}
        }
        Ok(cloud)
    }

    /// Returns the boxes of a frame, interpolated for a sweep at another time.
    fn boxes_at(&self, frame: &Frame, t_us: i64) -> Vec<TrackBox> {
        if t_us == frame.t_us {
            return frame.boxes.clone();
        }
        let tracks = 0..self.log.tracks.len();
        tracks
            .filter_map(|track| self.trajectories.at(track, t_us).map(|cuboid| TrackBox { track, cuboid }))
            .collect()
    }

    /// Returns the images of a frame, except those that the previous frame also has (images rarer than
    /// sweeps) if its views also color this frame.
    fn new_records(&self, frame: usize) -> Vec<&'a ImageRecord> {
        let before = frame.checked_sub(1).filter(|_| self.options.color_window > 0);
        let before = before.map_or_else(Vec::new, |before| self.records(before));
        let is_new = |record: &&ImageRecord| !before.iter().any(|other| other.source() == record.source());
        self.records(frame).into_iter().filter(is_new).collect()
    }

    /// Reads images of a frame and computes their occlusion maps. Skips damaged files.
    fn load_views(
        &self,
        frame: usize,
        records: &[&ImageRecord],
        window: &Window,
        progress: &dyn Progress,
    ) -> Result<Vec<ColorView>, BuildError> {
        let view = |record: &&ImageRecord| {
            let image = self.reader.read_image(record)?;
            let view = View {
                camera: Camera::clone(&record.camera),
                camera_from_world: record.camera_from_global().affine(),
            };
            let occlusion = self.options.occlusion_test.then(|| {
                let mut grid = OcclusionGrid::new(&record.camera);
                let near = window.around(frame, self.options.occlusion_window);
                near.flat_map(|f| &f.sweeps).for_each(|c| self.occlude(&mut grid, &view, record.t_us, c));
                grid.close()
            });
            Ok(ColorView { image, view, t_us: record.t_us, occlusion })
        };
        let read: Vec<Result<ColorView, DatasetError>> = records.par_iter().map(view).collect();
        let mut views = Vec::with_capacity(read.len());
        for view in read {
            views.extend(self.unless_damaged(view, progress)?);
        }
        Ok(views)
    }

    fn records(&self, frame: usize) -> Vec<&'a ImageRecord> {
        let frame = self.frames[frame];
        let between = if self.options.between_sweeps { frame.between_images.as_slice() } else { &[] };
        frame.images.iter().chain(between).collect()
    }

    fn occlude(&self, grid: &mut OcclusionGrid, view: &View, t_us: i64, cloud: &SweepCloud) {
        let (mut columns, mut pixels) = (PointColumns::default(), Pixels::default());
        for (track, points) in cloud.parts() {
            let Some(place) = self.place(track, t_us) else { continue };
            let project = Projector::new(view, &place);
            for (corners, block) in cloud.blocks(track, points) {
                if corners.is_some_and(|corners| project.misses(corners)) {
                    continue;
                }
                columns.set(block.iter().map(|point| point.position));
                project.pixels(&columns, &mut pixels);
                pixels.iter().for_each(|(_, pixel, depth_m)| grid.add(pixel, depth_m));
            }
        }
    }

    /// Returns the pose of a sweep's part at a time.
    fn place(&self, track: Option<usize>, t_us: i64) -> Option<DAffine3> {
        track.map_or(Some(DAffine3::IDENTITY), |track| {
            self.trajectories.at(track, t_us).map(|cuboid| cuboid.pose.affine())
        })
    }

    /// Colors the points of a frame from all loaded images.
    fn color_frame(&self, clouds: &mut [SweepCloud], views: &VecDeque<(usize, Vec<ColorView>)>) {
        if !self.has_images {
            return;
        }
        let views: Vec<&ColorView> = views.iter().flat_map(|(_, views)| views).collect();
        for cloud in clouds {
            let t_us = cloud.t_us;
            color::views::sweep(cloud, t_us, &views, self.options.coloring, |track, t_us| {
                self.place(track, t_us)
            });
        }
    }
}

/// Sweeps of consecutive frames.
struct Window {
    /// Index of the first frame.
    start: usize,
    clouds: VecDeque<FrameCloud>,
}

impl Window {
    /// Returns the frames up to `reach` before and after a frame, within the log.
    fn around(&self, frame: usize, reach: usize) -> impl Iterator<Item = &FrameCloud> {
        let (from, to) = (frame.saturating_sub(reach), frame + reach);
        let skip = from.saturating_sub(self.start);
        self.clouds.iter().skip(skip).take(to + 1 - from.max(self.start))
    }
}
