//! `box_detections_se3.arrow`: boxes of actors by frame.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::labels::{self, Labels};
use super::metadata::{self, BoxMetadata};
use super::sync::Sync;
use crate::dataset::recording::notes::{
    FLAT_BOX, NO_ANNOTATIONS, Notes, UNKNOWN_POINTS, note, note_unknown_category,
};
use crate::dataset::tables::{ArrowFile, Table};
use crate::dataset::{BoxPoints, Class, DatasetError, Gap, Track, TrackBox};
use crate::error::FileError;
use crate::files::input::is_there;
use crate::geometry::{Cuboid, Pose};

pub(super) const KEY: &str = "box_detections_se3";
const TIME: &str = "box_detections_se3.timestamp_us";
const SE3: &str = "box_detections_se3.bounding_box_se3";
const TOKEN: &str = "box_detections_se3.track_token";
const LABEL: &str = "box_detections_se3.label";
const POINTS: &str = "box_detections_se3.num_lidar_points";

/// Maximum time between a frame and its boxes that is not worth a note, microseconds.
const SAME_TIME_US: u64 = 1000;

/// Rows that are converted at a time, which bounds the memory of their lists.
const PART_ROWS: usize = 64;

/// Kind of a gap: a second box of a track in one frame.
const TWICE: &str = "boxes of a track that has another one in the frame";

/// Tracks, and per frame the boxes with their stated number of LiDAR points.
#[derive(Default)]
pub(super) struct Boxes {
    /// Sorted by id.
    pub(super) tracks: Vec<Track>,
    /// Sorted by track.
    pub(super) frames: Vec<Vec<TrackBox>>,
    /// In the order of `frames`; `None` if the table has no such numbers.
    pub(super) points: Option<BoxPoints>,
}

/// Reads the boxes of frames, given by their rows in `sync`.
///
/// # Errors
/// Fails if the table is damaged, or a box is invalid.
pub(super) fn read(
    log: &Path,
    sync: &Sync,
    frames: &[usize],
    notes: &mut Notes,
) -> Result<Boxes, DatasetError> {
    let path = log.join(format!("{KEY}.arrow"));
    if !is_there(&path)? {
        notes.gap(Gap::record(NO_ANNOTATIONS, "frames are without actors", log));
        return Ok(Boxes { frames: vec![Vec::new(); frames.len()], ..Boxes::default() });
    }
    let file = ArrowFile::open(&path)?;
    let about: BoxMetadata = metadata::read(&file)?;
    let rows = sync.rows_of_lists(KEY, file.rows())?;
    let mut frame_of: FxHashMap<usize, Vec<usize>> = FxHashMap::default();
    for (frame, row) in frames.iter().enumerate().filter_map(|(frame, i)| Some((frame, rows[*i]?))) {
        frame_of.entry(row).or_default().push(frame);
    }
    // Not counted one by one: a damaged file may declare any number of rows.
    note(notes, "rows of boxes that belong to no frame", file.rows() as usize - frame_of.len());
    let mut reader = Reader {
        labels: Labels::of_class(&about.box_detection_label_class),
        class: about.box_detection_label_class,
        path,
        tracks: FxHashMap::default(),
        first_labels: Vec::new(),
        frames: vec![Vec::new(); frames.len()],
        points: vec![Vec::new(); frames.len()],
        unknown: BTreeMap::new(),
        notes,
    };
    let mut first = 0;
    for batch in 0..file.batches() {
        for part in file.batch(batch, &[SE3, TOKEN, LABEL], &[POINTS, TIME])?.parts(PART_ROWS) {
            reader.part(&part, first, &frame_of)?;
            reader.note_times(&part, first, &frame_of, |frame| sync.times_us[frames[frame]])?;
            first += part.rows();
        }
    }
    Ok(reader.finish())
}

struct Reader<'a> {
    labels: Labels,
    class: String,
    path: PathBuf,
    /// Number of a track in the order of appearance.
    tracks: FxHashMap<String, usize>,
    /// Label of the first box of each track.
    first_labels: Vec<u16>,
    /// Boxes by the numbers of tracks in the order of appearance, until they are sorted.
    frames: Vec<Vec<TrackBox>>,
    points: BoxPoints,
    /// Number of boxes by unknown label.
    unknown: BTreeMap<u16, usize>,
    notes: &'a mut Notes,
}

impl Reader<'_> {
    /// Reads rows of the table, the first of which has a number.
    fn part(
        &mut self,
        table: &Table,
        first: usize,
        frame_of: &FxHashMap<usize, Vec<usize>>,
    ) -> Result<(), DatasetError> {
        let boxes = table.column(SE3)?.vector_lists::<10>()?;
        let (tokens, labels) = (table.column(TOKEN)?.text_lists()?, table.column(LABEL)?.integer_lists()?);
        let points = if table.has(POINTS) { Some(table.column(POINTS)?.integer_lists()?) } else { None };
        for (i, boxes) in boxes.iter().enumerate() {
            let Some(frames) = frame_of.get(&(first + i)) else { continue };
            let points = points.as_ref().map_or(&[][..], |all| &all[i]);
            if tokens[i].len() != boxes.len() || labels[i].len() != boxes.len() {
                let found = format!("lists of {}, {} and {}", boxes.len(), tokens[i].len(), labels[i].len());
                let expected = format!("a box, a token and a label of each actor in row {}", first + i);
                return Err(FileError::content(expected, found, &self.path).into());
            }
            let (mut read, mut read_points) =
                (Vec::with_capacity(boxes.len()), Vec::with_capacity(boxes.len()));
            for (place, values) in boxes.iter().enumerate() {
                let record = || format!("box {place} of row {}", first + i);
                let (token, label) = (tokens[i][place].as_deref(), labels[i][place]);
                if let Some(item) = self.item(*values, token, label, &record)? {
                    read.push(item);
                    let points = points.get(place).copied().flatten();
                    read_points.push(points.and_then(|points| u32::try_from(points).ok()));
                }
            }
            for frame in frames {
                (self.frames[*frame], self.points[*frame]) = (read.clone(), read_points.clone());
            }
        }
        Ok(())
    }

    /// Counts frames whose boxes have another time, which are taken as they are: `sync` names the next row of
    /// a table that has none at the time of the frame.
    fn note_times(
        &mut self,
        table: &Table,
        first: usize,
        frame_of: &FxHashMap<usize, Vec<usize>>,
        time_us: impl Fn(usize) -> i64,
    ) -> Result<(), FileError> {
        if !table.has(TIME) {
            return Ok(());
        }
        for (i, t_us) in table.column(TIME)?.integers_or_none()?.into_iter().enumerate() {
            let frames = frame_of.get(&(first + i)).into_iter().flatten();
            let is_late = |frame: &&usize| t_us.is_some_and(|t| t.abs_diff(time_us(**frame)) > SAME_TIME_US);
            note(self.notes, "frames whose boxes have another time", frames.filter(is_late).count());
        }
        Ok(())
    }

    /// Converts a box; `None` if it is not one of an actor.
    fn item(
        &mut self,
        values: Option<[f64; 10]>,
        token: Option<&str>,
        label: Option<i64>,
        record: &dyn Fn() -> String,
    ) -> Result<Option<TrackBox>, DatasetError> {
        let missing = |what: &str| FileError::content(format!("{what} in {}", record()), "none", &self.path);
        let [x, y, z, qw, qx, qy, qz, length, width, height] = values.ok_or_else(|| missing("a box"))?;
        let token = token.ok_or_else(|| missing("a track token"))?;
        let label = label.and_then(|label| u16::try_from(label).ok()).ok_or_else(|| missing("a label"))?;
        if self.labels.is_ego(label) {
            note(self.notes, "boxes of the ego (left out)", 1);
            return Ok(None);
        }
        let path = || self.path.clone();
        let pose = Pose::from_wxyz([qw, qx, qy, qz], [x, y, z]).map_err(|source| DatasetError::Pose {
            source,
            record: record(),
            path: path(),
        })?;
        let cuboid = Cuboid::unless_flat(pose, DVec3::new(length, width, height))
            .map_err(|source| DatasetError::Cuboid { source, record: record(), path: path() })?;
        let Some(cuboid) = cuboid else {
            self.notes.gap(Gap::record(FLAT_BOX, record(), &self.path));
            return Ok(None);
        };
        if self.labels.category(label).is_none() {
            *self.unknown.entry(label).or_default() += 1;
        }
        let next = self.tracks.len();
        let track = self.tracks.get(token).copied().unwrap_or(next);
        if track == next {
            self.tracks.insert(token.to_owned(), track);
            self.first_labels.push(label);
        }
        Ok(Some(TrackBox { track, cuboid }))
    }

    /// Sorts tracks and boxes.
    fn finish(self) -> Boxes {
        let Self { labels, class, path, tracks, first_labels, mut frames, mut points, unknown, notes } = self;
        for (label, boxes) in unknown {
            note_unknown_category(notes, &format!("{label} of {class}"), boxes);
        }
        let mut tokens: Vec<(String, usize)> = tracks.into_iter().collect();
        tokens.sort();
        let mut place = vec![0; tokens.len()];
        tokens.iter().enumerate().for_each(|(sorted, (_, track))| place[*track] = sorted);
        let track = |(id, track): (String, usize)| {
            let category = labels.category(first_labels[track]).unwrap_or_else(labels::unknown);
            Track { id, class: Class::from_category(&category), category: Cow::into_owned(category) }
        };
        let tracks: Vec<Track> = tokens.into_iter().map(track).collect();
        for (boxes, points) in frames.iter_mut().zip(&mut points) {
            boxes.iter_mut().for_each(|item| item.track = place[item.track]);
            let mut order: Vec<usize> = (0..boxes.len()).collect();
            order.sort_by_key(|i| boxes[*i].track);
            order.dedup_by(|later, first| {
                let is_second = boxes[*later].track == boxes[*first].track;
                if is_second {
                    let record = format!("track {}", tracks[boxes[*first].track].id);
                    notes.gap(Gap::record(TWICE, record, &path));
                }
                is_second
            });
            *points = order.iter().map(|i| points[*i]).collect();
            *boxes = order.iter().map(|i| boxes[*i]).collect();
        }
        let missing = points.iter().flatten().filter(|points| points.is_none()).count();
        let is_known = points.iter().flatten().any(Option::is_some);
        note(notes, UNKNOWN_POINTS, if is_known { missing } else { 0 });
        Boxes { tracks, frames, points: is_known.then_some(points) }
    }
}
