use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};

use glam::DAffine3;
use rayon::prelude::*;

use super::chunks::{chunks_from_points, point_from_colored};
use super::colorize::agreed_color;
use super::manifest::{Asset, BuildReport, Source};
use super::sweep::SweepCloud;
use super::{
    BuildOptions, BuiltSkeleton, Candidate, ColorView, ColoredPoint, Coloring, OcclusionGrid, Projector,
    Splitter, Trajectories, merge_voxels,
};
use crate::cloud::{Bounds, Point};
use crate::dataset::{Dataset, DatasetError, Frame, ImageRecord, Log, SweepRecord, TrackBox};
use crate::geometry::View;

/// Why no skeleton could be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The log.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A frame that the log does not have.
    #[error("expected frames below {frames}, found {found}")]
    Frame {
        /// How many the log has.
        frames: usize,
        /// The one asked for.
        found: usize,
    },
    /// Nothing to build from.
    #[error(
        "expected at least one point that an image colors, found none in {sweeps} sweeps ({points} points read)"
    )]
    Empty {
        /// Sweeps read.
        sweeps: usize,
        /// Points read.
        points: usize,
    },
}

/// Hears how far a long work is.
pub trait Progress: Sync {
    /// A stage of so many steps begins.
    fn start(&self, stage: &str, steps: usize);
    /// One of its steps is done.
    fn step(&self);
}

/// Silence.
impl Progress for () {
    fn start(&self, _: &str, _: usize) {}
    fn step(&self) {}
}

/// Builds a skeleton from some frames of a log, in time order: sweeps, images and boxes of other frames are not
/// looked at. The result depends on the input and the options alone, not on the number of threads.
///
/// # Errors
/// What the log's reader finds wrong, an unknown frame, a cloud without a point that an image colors.
pub fn build(
    dataset: &dyn Dataset,
    frames: &[usize],
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<BuiltSkeleton, BuildError> {
    let log = dataset.log();
    let frame =
        |&i: &usize| log.frames.get(i).ok_or(BuildError::Frame { frames: log.frames.len(), found: i });
    let frames: Vec<&Frame> = frames.iter().map(frame).collect::<Result<_, _>>()?;
    let builder =
        Builder { dataset, log, trajectories: Trajectories::new(log, &frames), frames, options, progress };
    let (mut clouds, mut report) = builder.read_sweeps()?;
    let has_images = builder.frames.iter().any(|f| !f.images.is_empty());
    if has_images {
        report.images = builder.colorize(&mut clouds)?;
    } else {
        clouds.iter_mut().flatten().for_each(SweepCloud::make_grey);
    }
    builder.finish(clouds, report)
}

struct Builder<'a> {
    dataset: &'a dyn Dataset,
    log: &'a Log,
    frames: Vec<&'a Frame>,
    trajectories: Trajectories,
    options: &'a BuildOptions,
    progress: &'a dyn Progress,
}

/// The sweeps of each frame.
type FrameClouds = Vec<Vec<SweepCloud>>;

impl Builder<'_> {
    fn read_sweeps(&self) -> Result<(FrameClouds, BuildReport), BuildError> {
        let wanted = |sweep: &&SweepRecord| sweep.is_key || self.options.between_sweeps;
        let records: Vec<(usize, &SweepRecord)> = (self.frames.iter().enumerate())
            .flat_map(|(i, frame)| frame.sweeps.iter().filter(wanted).map(move |s| (i, s)))
            .collect();
        self.progress.start("read sweeps", records.len());
        let read = records.par_iter().map(|(i, record)| {
            let cloud = self.read_sweep(self.frames[*i], record);
            self.progress.step();
            cloud.map(|c| (*i, c))
        });
        let mut clouds: FrameClouds = self.frames.iter().map(|_| Vec::new()).collect();
        let mut report = BuildReport { notes: self.log.notes.clone(), ..BuildReport::default() };
        for (i, cloud) in read.collect::<Result<Vec<_>, _>>()? {
            report.sweeps += 1;
            report.points_read += cloud.read;
            report.dropped_not_finite += cloud.not_finite;
            report.dropped_ghost += cloud.ghosts;
            report.dropped_ego += cloud.ego;
            clouds[i].push(cloud);
        }
        Ok((clouds, report))
    }

    fn read_sweep(&self, frame: &Frame, record: &SweepRecord) -> Result<SweepCloud, BuildError> {
        let sweep = self.dataset.read_sweep(record)?;
        let boxes = self.boxes_at(frame, record.t_us);
        let splitter = Splitter::new(&boxes, &self.trajectories, record.t_us, &self.options.split);
        Ok(SweepCloud::split(&sweep, record, &splitter, &self.options.split))
    }

    /// The boxes of a frame, or those in between for a sweep at another time.
    fn boxes_at(&self, frame: &Frame, t_us: i64) -> Vec<TrackBox> {
        if t_us == frame.t_us {
            return frame.boxes.clone();
        }
        let tracks = 0..self.log.tracks.len();
        tracks
            .filter_map(|track| self.trajectories.at(track, t_us).map(|cuboid| TrackBox { track, cuboid }))
            .collect()
    }

    /// Colors all points; returns the number of images read.
    fn colorize(&self, clouds: &mut FrameClouds) -> Result<usize, BuildError> {
        self.progress.start("color points", self.frames.len());
        let window = self.options.color_window;
        let mut views: VecDeque<Vec<ColorView>> = VecDeque::new();
        let mut images = 0;
        for ahead in 0..self.frames.len() + window {
            if ahead < self.frames.len() {
                let loaded = self.load_views(ahead, clouds)?;
                images += loaded.len();
                views.push_back(loaded);
            }
            if let Some(frame) = ahead.checked_sub(window) {
                self.color_frame(&mut clouds[frame], views.iter().flatten());
                self.progress.step();
                if frame >= window {
                    views.pop_front();
                }
            }
        }
        Ok(images)
    }

    /// Reads the images of a frame, with what hides what in each.
    fn load_views(&self, frame: usize, clouds: &FrameClouds) -> Result<Vec<ColorView>, BuildError> {
        let source = self.frames[frame];
        let between = if self.options.between_sweeps { source.between_images.as_slice() } else { &[] };
        let records: Vec<&ImageRecord> = source.images.iter().chain(between).collect();
        let near = nearby(frame, self.options.occlusion_window, clouds.len());
        let view = |record: &&ImageRecord| {
            let image = self.dataset.read_image(record)?;
            let view = View {
                camera: record.camera.clone(),
                camera_from_world: record.camera_from_global().affine(),
            };
            let occlusion = self.options.occlusion_test.then(|| {
                let mut grid = OcclusionGrid::new(&record.camera);
                clouds[near.clone()]
                    .iter()
                    .flatten()
                    .for_each(|c| self.occlude(&mut grid, &view, record.t_us, c));
                grid.close()
            });
            Ok(ColorView { image, view, t_us: record.t_us, occlusion })
        };
        records.par_iter().map(view).collect()
    }

    fn occlude(&self, grid: &mut OcclusionGrid, view: &View, t_us: i64, cloud: &SweepCloud) {
        for (track, points) in cloud.parts() {
            let Some(place) = self.place(track, t_us) else { continue };
            let project = Projector::new(view, &place);
            for (pixel, depth_m) in points.iter().filter_map(|p| project.pixel(p.position)) {
                grid.add(pixel, depth_m);
            }
        }
    }

    /// Where a part of a sweep stands at a time.
    fn place(&self, track: Option<usize>, t_us: i64) -> Option<DAffine3> {
        track.map_or(Some(DAffine3::IDENTITY), |track| {
            self.trajectories.at(track, t_us).map(|cuboid| cuboid.pose.affine())
        })
    }

    fn color_frame<'v>(&self, clouds: &mut [SweepCloud], views: impl Iterator<Item = &'v ColorView>) {
        const POINTS_PER_JOB: usize = 16_384;
        let views: Vec<&ColorView> = views.collect();
        for cloud in clouds {
            let t_us = cloud.t_us;
            for (track, points) in cloud.parts_mut() {
                if self.options.coloring == Coloring::EveryCamera {
                    self.copy_for_every_view(&views, track, t_us, points);
                    continue;
                }
                let placed: Vec<(&ColorView, Projector, f64)> = (views.iter())
                    .filter_map(|view| {
                        let project = Projector::new(&view.view, &self.place(track, view.t_us)?);
                        Some((*view, project, (view.t_us - t_us) as f64 * 1e-6))
                    })
                    .collect();
                points.par_chunks_mut(POINTS_PER_JOB).for_each(|job| color_job(job, &placed));
            }
        }
    }

    /// [`Coloring::EveryCamera`]: everything stands where it stood at the sweep's time.
    fn copy_for_every_view(
        &self,
        views: &[&ColorView],
        track: Option<usize>,
        t_us: i64,
        points: &mut Vec<Candidate>,
    ) {
        let Some(place) = self.place(track, t_us) else { return };
        let project: Vec<Projector> = views.iter().map(|v| Projector::new(&v.view, &place)).collect();
        let mut copies = Vec::with_capacity(points.len());
        for point in points.iter() {
            let seen = views.iter().zip(&project).filter_map(|(view, project)| {
                let (pixel, _) = project.pixel(point.position)?;
                Some(view.image.get_pixel(pixel.x as u32, pixel.y as u32).0)
            });
            let before = copies.len();
            copies.extend(seen.map(|rgb| Candidate { rgb: Some(rgb), ..*point }));
            if copies.len() == before {
                copies.push(*point); // without a color: counted in the end
            }
        }
        *points = copies;
    }

    fn finish(&self, clouds: FrameClouds, mut report: BuildReport) -> Result<BuiltSkeleton, BuildError> {
        self.progress.start("merge points", 2);
        let uncolored = Cell::new(0_usize);
        let colored = |point: &Candidate| {
            let colored = point.rgb.map(|rgb| ColoredPoint { position: point.position, rgb });
            uncolored.set(uncolored.get() + usize::from(colored.is_none()));
            colored
        };
        let mut tracks: BTreeMap<usize, (usize, Vec<ColoredPoint>)> = BTreeMap::new();
        let mut background = Vec::new();
        for cloud in clouds.into_iter().flatten() {
            background.extend(cloud.background.iter().filter_map(colored));
            for (track, points) in &cloud.actors {
                let entry = tracks.entry(*track).or_default();
                let before = entry.1.len();
                entry.1.extend(points.iter().filter_map(colored));
                entry.0 += usize::from(entry.1.len() > before);
            }
        }
        report.dropped_uncolored = uncolored.get();
        report.background_points = background.len();
        report.actor_points = tracks.values().map(|(_, points)| points.len()).sum();
        if background.is_empty() && report.actor_points == 0 {
            return Err(BuildError::Empty { sweeps: report.sweeps, points: report.points_read });
        }
        let background = chunks_from_points(background.into_iter(), self.options.voxel_m);
        self.progress.step();
        let actors =
            tracks.into_iter().filter_map(|(track, (sweeps, points))| self.asset(track, sweeps, points));
        let actors = actors.collect();
        self.progress.step();
        Ok(BuiltSkeleton {
            source: self.source(),
            options: self.options.clone(),
            report,
            background,
            actors,
            templates: Vec::new(),
        })
    }

    fn asset(&self, track: usize, sweeps: usize, points: Vec<ColoredPoint>) -> Option<(Asset, Vec<Point>)> {
        let info = &self.log.tracks[track];
        let points: Vec<Point> = merge_voxels(points, self.options.voxel_m)
            .iter()
            .map(|p| point_from_colored(p, info.class as u8))
            .collect();
        let asset = Asset {
            track: info.id.clone(),
            category: info.category.clone(),
            class: info.class,
            size: self.trajectories.median_size(track)?.to_array(),
            sweeps,
            points: points.len(),
            bounds: Bounds::of(&points)?,
        };
        Some((asset, points))
    }

    fn source(&self) -> Source {
        let time = |frame: Option<&&Frame>| frame.map_or(0, |f| f.t_us);
        Source {
            log: self.log.name.clone(),
            location: self.log.location.clone(),
            frames: self.frames.len(),
            t_us: [time(self.frames.first()), time(self.frames.last())],
        }
    }
}

/// Colors points from views, each with its projection and its time from the points' sweep in seconds.
fn color_job(points: &mut [Candidate], views: &[(&ColorView, Projector, f64)]) {
    let mut looks = Vec::with_capacity(views.len());
    for point in points {
        looks.clear();
        looks.extend(
            views.iter().filter_map(|(view, project, dt_s)| view.look(project, point.position, *dt_s)),
        );
        point.rgb = agreed_color(&looks);
    }
}

/// Frames within a window around one.
fn nearby(frame: usize, window: usize, frames: usize) -> std::ops::Range<usize> {
    frame.saturating_sub(window)..(frame + window + 1).min(frames)
}
