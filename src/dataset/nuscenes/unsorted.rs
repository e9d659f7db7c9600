//! Data of a frame before sorting, and the sorted frames.

use std::cmp::Ordering;
use std::path::Path;

use rustc_hash::FxHashMap;

use crate::dataset::clock::Unit;
use crate::dataset::recording::notes::{NO_IMAGE, NO_SWEEP, Notes, note};
use crate::dataset::{EgoTrack, Gap, ImageRecord, SweepRecord};
use crate::error::FileError;
use crate::files::FileName;
use crate::geometry::Pose;

/// LiDAR that defines the ego pose of a frame.
pub(super) const MAIN_LIDAR: &str = "LIDAR_TOP";

/// Kind of a gap: a sample that neither a sweep nor an image gives an ego pose.
const NO_DATA: &str = "samples without data";

/// Note on data between key frames to which no frame belongs: all later samples are without key frames.
const NO_LATER_FRAME: &str = "sweeps and images after the last sample with key frames";

/// Sensor data and ego pose of a frame.
#[derive(Debug)]
pub(super) struct FrameRecord {
    pub(super) global_from_ego: Pose,
    pub(super) sweeps: Vec<SweepRecord>,
    pub(super) images: Vec<ImageRecord>,
    pub(super) between_images: Vec<ImageRecord>,
}

/// Sweep before sorting into a frame.
pub(super) struct RawSweep {
    pub(super) channel: String,
    pub(super) is_key: bool,
    pub(super) token: String,
    pub(super) record: SweepRecord,
}

/// Unsorted sweeps and images of one frame.
#[derive(Default)]
pub(super) struct UnsortedFrame {
    pub(super) sweeps: Vec<RawSweep>,
    pub(super) images: Vec<ImageRecord>,
    pub(super) between_images: Vec<ImageRecord>,
}

/// Sorts the frames. A sample without an ego pose is no frame, and its data belongs to the next one.
pub(super) fn finish(
    piles: Vec<UnsortedFrame>,
    cameras: &[FileName],
    times_us: &[i64],
    path: &Path,
    notes: &mut Notes,
) -> Vec<Option<FrameRecord>> {
    let ego = ego_track(&piles);
    let (mut frames, mut carried) = (Vec::with_capacity(piles.len()), UnsortedFrame::default());
    for (mut pile, t_us) in piles.into_iter().zip(times_us) {
        pile.sweeps.append(&mut carried.sweeps);
        pile.between_images.append(&mut carried.between_images);
        match pile.finish(cameras, *t_us, ego.as_ref(), path, notes) {
            Ok(frame) => frames.push(Some(frame)),
            Err(pile) => {
                carried = pile;
                frames.push(None);
            }
        }
    }
    note(notes, NO_LATER_FRAME, carried.sweeps.len() + carried.between_images.len());
    frames
}

/// Returns the ego poses of all data of a scene without [`MAIN_LIDAR`]; `None` with it.
fn ego_track(piles: &[UnsortedFrame]) -> Option<EgoTrack> {
    if piles.iter().flat_map(|pile| &pile.sweeps).any(|sweep| sweep.channel == MAIN_LIDAR) {
        return None;
    }
    let poses = piles.iter().flat_map(|pile| {
        let sweeps = pile.sweeps.iter().map(|sweep| (sweep.record.t_us, sweep.record.global_from_ego));
        let images = pile.images.iter().chain(&pile.between_images);
        sweeps.chain(images.map(|image| (image.t_us, image.global_from_ego)))
    });
    Some(EgoTrack::of_poses(poses.collect()))
}

impl UnsortedFrame {
    /// Sorts a frame. Of its own sweeps, the one of [`MAIN_LIDAR`] is the first, or else the nearest in time.
    /// Without that LiDAR, as in TruckScenes, none may be at the time of the sample and its boxes, so the ego
    /// pose is interpolated in `ego`.
    ///
    /// # Errors
    /// Returns the data if there is neither a key sweep nor a key image to provide the ego pose.
    fn finish(
        mut self,
        cameras: &[FileName],
        t_us: i64,
        ego: Option<&EgoTrack>,
        path: &Path,
        notes: &mut Notes,
    ) -> Result<FrameRecord, Self> {
        for (channel, name) in cameras.iter().enumerate() {
            if !self.images.iter().any(|i| i.channel == channel) {
                notes.gap(Gap::record(NO_IMAGE, format!("{name} of the sample at {t_us}"), path));
            }
        }
        self.images.sort_by_key(|i| i.channel);
        self.between_images.sort_by_key(|i| (i.t_us, i.channel));
        self.sweeps.sort_by(|a, b| {
            let rank = |s: &RawSweep| (!s.is_key, s.is_key && s.channel != MAIN_LIDAR);
            let distance = |s: &RawSweep| if s.is_key { s.record.t_us.abs_diff(t_us) } else { 0 };
            let by_time = || if a.is_key { Ordering::Equal } else { b.record.t_us.cmp(&a.record.t_us) };
            let by_rank = rank(a).cmp(&rank(b)).then_with(|| distance(a).cmp(&distance(b)));
            by_rank.then_with(by_time).then_with(|| a.channel.cmp(&b.channel))
        });
        if !self.sweeps.first().is_some_and(|s| s.is_key) {
            notes.gap(Gap::record(NO_SWEEP, format!("sample at {t_us}"), path));
        }
        let of_sweep = self.sweeps.first().filter(|s| s.is_key).map(|sweep| {
            let at_sample = ego.filter(|_| sweep.record.t_us != t_us).and_then(|ego| ego.at(t_us));
            at_sample.unwrap_or(sweep.record.global_from_ego)
        });
        let of_image = || self.images.iter().min_by_key(|i| i.t_us).map(|i| i.global_from_ego);
        let Some(global_from_ego) = of_sweep.or_else(of_image) else {
            notes.gap(Gap::record(NO_DATA, format!("sample at {t_us}"), path));
            return Err(self);
        };
        let sweeps = self.sweeps.into_iter().map(|s| s.record).collect();
        Ok(FrameRecord { global_from_ego, sweeps, images: self.images, between_images: self.between_images })
    }
}

/// Checks that the times of a sensor's key frames grow from frame to frame. An image may be repeated.
pub(super) fn check_growth(frames: &[UnsortedFrame], path: &Path) -> Result<(), FileError> {
    let mut last: FxHashMap<String, (i64, &Path)> = FxHashMap::default();
    for frame in frames {
        let sweeps = frame.sweeps.iter().filter(|sweep| sweep.is_key);
        let sweeps = sweeps.map(|s| (s.channel.clone(), &s.token, s.record.t_us, s.record.path.as_path()));
        let images =
            frame.images.iter().map(|i| (i.camera.name.to_string(), &i.token, i.t_us, i.path.as_path()));
        for (channel, token, t_us, file) in sweeps.chain(images) {
            let before = last.insert(channel.clone(), (t_us, file));
            if let Some((before_us, _)) = before.filter(|(t, known)| *t >= t_us && *known != file) {
                let expected = "times of key frames that grow from sample to sample";
                let hint = Unit::MICROS.hint(t_us as f64);
                let found = format!("{t_us} in sample_data {token} of {channel} after {before_us}{hint}");
                return Err(FileError::content(expected, found, path));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use glam::DVec3;

    fn sweep(t_us: i64, is_key: bool) -> RawSweep {
        let (global_from_ego, ego_from_lidar) = (Pose::IDENTITY, Pose::IDENTITY);
        let record = SweepRecord {
            path: format!("{t_us}.pcd.bin").into(),
            row: None,
            t_us,
            global_from_ego,
            ego_from_lidar,
            is_key,
        };
        RawSweep { channel: MAIN_LIDAR.to_owned(), is_key, token: t_us.to_string(), record }
    }

    fn image(t_us: i64) -> ImageRecord {
        let rows = [[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]];
        ImageRecord {
            token: t_us.to_string(),
            channel: 0,
            path: format!("{t_us}.jpg").into(),
            row: None,
            t_us,
            global_from_ego: Pose::IDENTITY,
            ego_from_camera: Pose::IDENTITY,
            camera: Camera::new("c", 10, 10, rows).unwrap().into(),
        }
    }

    #[test]
    fn data_of_a_sample_without_key_frames_belongs_to_the_next_frame() {
        let pile = |t_us: i64, has_key: bool| {
            let mut pile = UnsortedFrame::default();
            pile.sweeps.push(sweep(t_us - 50, false));
            pile.sweeps.extend(has_key.then(|| sweep(t_us, true)));
            pile.between_images.push(image(t_us - 40));
            pile
        };
        let piles =
            vec![pile(100, true), pile(200, false), pile(300, false), pile(400, true), pile(500, false)];
        let mut notes = Notes::new();
        let frames = finish(piles, &[], &[100, 200, 300, 400, 500], Path::new("a.json"), &mut notes);
        let times = |frame: &Option<FrameRecord>| {
            let frame = frame.as_ref()?;
            let sweeps: Vec<i64> = frame.sweeps.iter().map(|sweep| sweep.t_us).collect();
            Some((sweeps, frame.between_images.iter().map(|image| image.t_us).collect::<Vec<i64>>()))
        };
        let found: Vec<_> = frames.iter().map(times).collect();
        let last = Some((vec![400_i64, 350, 250, 150], vec![160_i64, 260, 360]));
        assert_eq!(found, [Some((vec![100, 50], vec![60])), None, None, last, None]);
        assert_eq!((notes.counts[NO_DATA], notes.counts[NO_LATER_FRAME]), (3, 2));
    }
    /// Sweeps of several LiDARs around a sample: the nearest one is the first, and the ego is where it was at
    /// the time of the sample. A main LiDAR decides both.
    #[test]
    fn frames_are_at_the_time_of_the_sample() {
        let sweep = |channel: &str, t_us: i64| {
            let mut sweep = sweep(t_us, true);
            channel.clone_into(&mut sweep.channel);
            sweep.record.global_from_ego = Pose::from_yaw(0.0, DVec3::X * t_us as f64);
            sweep
        };
        let frame = |sweeps: &[(&str, i64)]| {
            let pile = UnsortedFrame {
                sweeps: sweeps.iter().map(|(channel, t_us)| sweep(channel, *t_us)).collect(),
                ..UnsortedFrame::default()
            };
            let frames = finish(vec![pile], &[], &[100], Path::new("a.json"), &mut Notes::new());
            let frame = frames.into_iter().next().flatten().unwrap();
            let times: Vec<i64> = frame.sweeps.iter().map(|sweep| sweep.t_us).collect();
            (frame.global_from_ego.translation.x, times)
        };
        assert_eq!(
            frame(&[("LIDAR_LEFT", 60), ("LIDAR_REAR", 130), ("LIDAR_RIGHT", 90)]),
            (100.0, vec![90, 130, 60])
        );
        assert_eq!(frame(&[("LIDAR_LEFT", 60), ("LIDAR_REAR", 100)]), (100.0, vec![100, 60]));
        assert_eq!(frame(&[("LIDAR_LEFT", 60), ("LIDAR_TOP", 130)]), (130.0, vec![130, 60]));
        // Nothing is known after the last pose.
        assert_eq!(frame(&[("LIDAR_LEFT", 60), ("LIDAR_REAR", 90)]), (90.0, vec![90, 60]));
    }
}
