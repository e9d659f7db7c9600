pub(super) mod degenerate;
pub(super) mod ego_jumps;
pub(super) mod ego_track;
pub(super) mod fingerprint;
pub(super) mod gaps;
pub(super) mod notes;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

use super::{ActorEdits, Class, DatasetError, Gap, MissingData, ReadOptions, Script};
use crate::files::FileName;
use crate::files::text::printable;
use crate::geometry::{Camera, Cuboid, Pose};

/// Content of one log: frames with poses, sensor files and boxes, and the calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Scene or log name.
    pub name: String,
    /// Identifier within the data set: the token of the scene in nuScenes, else empty.
    pub token: String,
    /// Map location, for instance `singapore-onenorth`.
    pub location: String,
    /// Free-text description from the dataset.
    pub description: String,
    /// Camera channels, in the order of every camera list.
    pub cameras: Vec<FileName>,
    /// Calibrated cameras, sorted by channel. A camera whose calibration changes has its first one here.
    pub rig: Vec<RigCamera>,
    /// Tracked objects, sorted by id.
    pub tracks: Vec<Track>,
    /// Annotated frames in time order.
    pub frames: Vec<Frame>,
    /// Scenario types tagged in the dataset, with their frame indices in ascending order.
    pub scenarios: BTreeMap<String, Vec<usize>>,
    /// Traffic light states, sorted by frame, then by lane connector.
    pub lights: Vec<TrafficLight>,
    /// Routes to the destination, sorted by first frame; empty if the dataset has none.
    pub routes: Vec<NavigationRoute>,
    /// Files of the HD map, for programs that read them on their own; `None` if there are none.
    pub map_files: Option<MapFiles>,
    /// Number of items that the reader skipped or missed, by kind.
    pub notes: BTreeMap<String, usize>,
    /// Missing parts, which are also counted in the notes.
    pub gaps: Vec<Gap>,
    /// Simulation and planning steps per second that suit the log, if others than those of its format.
    pub rates_hz: Option<[f64; 2]>,
    /// Options with which the log was read.
    pub reading: ReadOptions,
    /// Edits of the actors, which tracks and boxes have.
    pub edits: ActorEdits,
    /// Timed edits of the actors. The boxes have them as the recorded ego meets them.
    pub script: Script,
}

/// Name and length of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogOutline {
    /// Name, as in [`Recording`](super::Recording).
    pub name: String,
    /// Number of frames.
    pub frames: usize,
}

impl LogOutline {
    /// Returns the outline of an open log.
    pub fn of(log: &Recording) -> Self {
        Self { name: log.name.clone(), frames: log.frames.len() }
    }
}

/// State of the traffic light of a lane connector at a frame.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TrafficLight {
    /// Index in [`Recording::frames`].
    pub frame: usize,
    /// Id of the connector, as in [`VectorMap::lane_connectors`](super::VectorMap::lane_connectors).
    pub lane_connector: String,
    /// Color as named by the dataset: `green`, `yellow`, `red` or `unknown`.
    pub color: String,
}

/// Route of the ego to its destination, from a frame on.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigationRoute {
    /// Index in [`Recording::frames`] of the first frame.
    pub frame: usize,
    /// Ids of the roadblocks and roadblock connectors of the map, in driving order.
    pub roadblocks: Vec<String>,
    /// Destination, a global pose of the ego; `None` if unknown.
    pub goal: Option<Pose>,
}

/// Location of an HD map's files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapFiles {
    /// Name of the map.
    pub name: String,
    /// Absolute folder of all maps.
    pub root: PathBuf,
}

/// Tracked object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Track {
    /// Id in the dataset.
    pub id: String,
    /// Dotted category as in nuScenes, like `vehicle.car`, to which the reader maps the names of the data
    /// set. It determines class, color of the box, and template.
    pub category: String,
    /// Coarse class.
    pub class: Class,
}

/// Annotated frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Absolute microseconds.
    pub t_us: i64,
    /// Ego pose at that time.
    pub global_from_ego: Pose,
    /// The frame's own sweeps first (one per LiDAR), then the unannotated sweeps since the last frame (latest
    /// first).
    pub sweeps: Vec<SweepRecord>,
    /// At most one image per camera, sorted by camera.
    pub images: Vec<ImageRecord>,
    /// Unannotated images since the last frame, sorted by time, then camera.
    pub between_images: Vec<ImageRecord>,
    /// Boxes at the frame's time, sorted by track.
    pub boxes: Vec<TrackBox>,
}

/// File, time and sensor pose of a sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepRecord {
    /// File.
    pub path: PathBuf,
    /// Row of the file that holds the sweep, if the file is a table.
    pub row: Option<u32>,
    /// Absolute microseconds.
    pub t_us: i64,
    /// Ego pose at that time.
    pub global_from_ego: Pose,
    /// Extrinsics.
    pub ego_from_lidar: Pose,
    /// Whether it belongs to the annotated frame itself.
    pub is_key: bool,
}

/// File, time and camera of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageRecord {
    /// Identifier within the data set: the token in nuScenes and nuPlan, `LOG_CAMERA_NANOSECONDS` in
    /// Argoverse 2.
    pub token: String,
    /// Index in [`Recording::cameras`].
    pub channel: usize,
    /// File.
    pub path: PathBuf,
    /// Row of the file that holds the image, if the file is a table.
    pub row: Option<u32>,
    /// Absolute microseconds.
    pub t_us: i64,
    /// Ego pose at that time.
    pub global_from_ego: Pose,
    /// Extrinsics.
    pub ego_from_camera: Pose,
    /// Size and intrinsics, shared by images of one calibration.
    pub camera: Arc<Camera>,
}

/// Camera mounted on the ego, independent of its images.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// Index in [`Recording::cameras`].
    pub channel: usize,
    /// Extrinsics.
    pub ego_from_camera: Pose,
    /// Size and intrinsics.
    pub camera: Camera,
}

/// Box of a track in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackBox {
    /// Index in [`Recording::tracks`].
    pub track: usize,
    /// Box in the global frame.
    pub cuboid: Cuboid,
}

impl Recording {
    /// Returns the content of a file in this log; `None` if it is damaged and [`ReadOptions::missing`] is
    /// [`MissingData::Skip`]. The caller counts it.
    ///
    /// # Errors
    /// Returns the error of a damaged file otherwise, and all errors of the operating system except that the
    /// file does not exist.
    pub fn unless_damaged<T>(&self, read: Result<T, DatasetError>) -> Result<Option<T>, DatasetError> {
        match read {
            Ok(content) => Ok(Some(content)),
            Err(error) if self.reading.missing == MissingData::Skip && error.is_damage() => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns the name for messages: one line of bounded length.
    pub fn shown_name(&self) -> Cow<'_, str> {
        printable(&self.name)
    }

    /// Returns where the LiDAR of the first sweep is on the ego, meters; `None` without sweeps.
    pub fn lidar_position_m(&self) -> Option<DVec3> {
        let first = self.frames.iter().flat_map(|frame| &frame.sweeps).next();
        first.map(|sweep| sweep.ego_from_lidar.translation)
    }

    /// Returns a track's boxes in time order, with their frame indices.
    pub fn track_boxes(&self, track: usize) -> Vec<(usize, Cuboid)> {
        let in_frame = |(i, frame): (usize, &Frame)| frame.cuboid_of(track).map(|cuboid| (i, cuboid));
        self.frames.iter().enumerate().filter_map(in_frame).collect()
    }

    /// Returns the median length, width and height of a track's boxes, meters; 1 m without boxes.
    pub fn median_size(&self, track: usize) -> DVec3 {
        median_size(self.track_boxes(track).iter().map(|(_, cuboid)| cuboid.size))
    }

    /// Returns all boxes at any time within the log, sorted by track, interpolated between the frames before
    /// and after. A track missing from either frame is omitted.
    pub fn boxes_at(&self, t_us: i64) -> Vec<TrackBox> {
        let next = self.frames.partition_point(|f| f.t_us < t_us);
        match (next.checked_sub(1).map(|i| &self.frames[i]), self.frames.get(next)) {
            (_, Some(frame)) if frame.t_us == t_us => frame.boxes.clone(),
            (Some(before), Some(after)) => {
                let s = (t_us - before.t_us) as f64 / (after.t_us - before.t_us) as f64;
                let between = |b: &TrackBox| {
                    let other = after.cuboid_of(b.track)?;
                    Some(TrackBox { track: b.track, cuboid: b.cuboid.interpolate(&other, s) })
                };
                before.boxes.iter().filter_map(between).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Returns the image of a camera that is nearest in time; the earlier one of two.
    pub fn nearest_image(&self, camera: &str, t_us: i64) -> Option<&ImageRecord> {
        let of_camera =
            |record: &&ImageRecord| self.cameras.get(record.channel).is_some_and(|name| name == camera);
        let all = self.frames.iter().flat_map(|frame| frame.images.iter().chain(&frame.between_images));
        all.filter(of_camera).min_by_key(|record| (record.t_us.abs_diff(t_us), record.t_us))
    }

    /// Returns the route at a time: the last frame's up to it, or else the first frame's.
    pub fn route_at(&self, t_us: i64) -> Option<&NavigationRoute> {
        let frame = self.frames.partition_point(|f| f.t_us <= t_us).saturating_sub(1);
        self.routes.iter().rev().find(|route| route.frame <= frame)
    }

    /// Returns the times of the first and last frame, absolute microseconds; `None` without frames.
    pub fn ends_us(&self) -> Option<[i64; 2]> {
        let ends = self.frames.first().zip(self.frames.last());
        ends.map(|(first, last)| [first.t_us, last.t_us])
    }

    /// Returns whether a time lies within the log.
    pub fn covers(&self, t_us: i64) -> bool {
        self.ends_us().is_some_and(|[first_us, last_us]| (first_us..=last_us).contains(&t_us))
    }
}

impl Frame {
    /// Returns a track's box; `None` if the frame has none.
    pub fn cuboid_of(&self, track: usize) -> Option<Cuboid> {
        self.boxes.binary_search_by_key(&track, |b| b.track).ok().map(|i| self.boxes[i].cuboid)
    }
}

impl RigCamera {
    /// Returns the cameras as calibrated at their first image, sorted by channel.
    pub fn first_used(frames: &[Frame]) -> Vec<Self> {
        let mut first: BTreeMap<usize, &ImageRecord> = BTreeMap::new();
        let images = |frame| {
            let Frame { images, between_images, .. }: &Frame = frame;
            images.iter().chain(between_images)
        };
        for image in frames.iter().flat_map(images) {
            first.entry(image.channel).or_insert(image);
        }
        first.into_values().map(Self::from).collect()
    }
}

impl From<&ImageRecord> for RigCamera {
    fn from(image: &ImageRecord) -> Self {
        let ImageRecord { channel, ego_from_camera, ref camera, .. } = *image;
        Self { channel, ego_from_camera, camera: Camera::clone(camera) }
    }
}

impl ImageRecord {
    /// Returns what tells the image apart from others: its file and the row in it.
    pub fn source(&self) -> (&Path, Option<u32>) {
        (&self.path, self.row)
    }

    /// Returns `camera_from_global` at the image's own time.
    pub fn camera_from_global(&self) -> Pose {
        (self.global_from_ego * self.ego_from_camera).inverse()
    }
}

/// Returns the median of each side, meters; 1 m without sizes.
pub(super) fn median_size(sizes: impl Iterator<Item = DVec3> + Clone) -> DVec3 {
    let median = |axis: usize| {
        let mut sides: Vec<f64> = sizes.clone().map(|size| size[axis]).collect();
        sides.sort_by(f64::total_cmp);
        sides.get(sides.len() / 2).copied().unwrap_or(1.0)
    };
    DVec3::new(median(0), median(1), median(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn frame(t_us: i64, x: f64, tracks: &[usize]) -> Frame {
        let pose = Pose::from_yaw(0.0, DVec3::new(x, 0.0, 0.0));
        let cuboid = Cuboid::new(pose, DVec3::ONE).unwrap();
        let boxes = tracks.iter().map(|&track| TrackBox { track, cuboid }).collect();
        let (sweeps, images, between_images) = Default::default();
        Frame { t_us, global_from_ego: pose, sweeps, images, between_images, boxes }
    }

    #[test]
    fn boxes_between_frames() {
        let log = Recording {
            frames: vec![frame(0, 0.0, &[0, 1]), frame(100, 10.0, &[1])],
            ..Recording::default()
        };
        let boxes = log.boxes_at(50);
        assert_eq!((boxes.len(), boxes[0].track, boxes[0].cuboid.pose.translation.x), (1, 1, 5.0));
        assert_eq!(log.boxes_at(0).len(), 2);
        assert!(log.boxes_at(200).is_empty() && log.covers(100) && !log.covers(200));
        assert_eq!(log.track_boxes(1).len(), 2);
    }

    #[test]
    fn routes_last_until_the_next() {
        let route = |frame: usize| NavigationRoute { frame, roadblocks: vec![frame.to_string()], goal: None };
        let frames = [0, 100, 200].map(|t_us| frame(t_us, 0.0, &[])).to_vec();
        let log = Recording { frames, routes: vec![route(0), route(2)], ..Recording::default() };
        let at = |t_us: i64| log.route_at(t_us).map(|route| route.frame);
        assert_eq!([-5, 0, 199, 200, 900].map(at), [Some(0), Some(0), Some(0), Some(2), Some(2)]);
        assert_eq!(Recording::default().route_at(0), None);
    }
}
