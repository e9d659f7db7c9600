//! Tables with frames between the annotated ones, as perception and generation models use them at 12 Hz: the
//! layout `interp_12Hz_trainval` of ASAP (<https://github.com/JeffWang987/ASAP>).
//!
//! # How it works
//! Each interval between two samples gets N - 1 new samples, evenly spaced. A new record has the token of the
//! record that it continues, with its number behind it. Boxes of objects in both samples are interpolated.
//! Images and sweeps are the recorded ones that are closest in time, with their own ego poses; those that are
//! not at a frame are dropped. Unlike ASAP's, links between records of sensor data lead to existing ones, and
//! the counts of scenes and instances are right.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use rustc_hash::FxHashMap;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::choose::table_folder;
use super::tables::numbers::{TimeUs, Truth};
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::{Inputs, WholeFolder, json, write_whole};

/// Rate of annotated samples, per second.
pub const ANNOTATED_HZ: u8 = 2;
/// Maximum number of frames in an interval: new tokens have one more digit.
const MAX_FRAMES: u8 = 10;
const KIND: &str = "tables";

/// Numbers of records in the new tables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InterpolatedCounts {
    /// Samples.
    pub samples: usize,
    /// Annotations.
    pub annotations: usize,
    /// Images and sweeps.
    pub files: usize,
    /// Images and sweeps of new samples that are those of an annotated sample, since none was recorded
    /// closer.
    pub repeated: usize,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Links {
    token: String,
    #[serde(default)]
    prev: String,
    #[serde(default)]
    next: String,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Sample {
    #[serde(flatten)]
    links: Links,
    timestamp: Time,
    scene_token: String,
    #[serde(flatten)]
    others: Map<String, Value>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Annotation {
    #[serde(flatten)]
    links: Links,
    sample_token: String,
    instance_token: String,
    translation: [f64; 3],
    rotation: [f64; 4],
    #[serde(flatten)]
    others: Map<String, Value>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct SampleData {
    #[serde(flatten)]
    links: Links,
    sample_token: String,
    ego_pose_token: String,
    calibrated_sensor_token: String,
    timestamp: Time,
    is_key_frame: Flag,
    filename: String,
    #[serde(flatten)]
    others: Map<String, Value>,
}

/// Whole microseconds.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(from = "TimeUs")]
struct Time(i64);

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(from = "Truth")]
struct Flag(bool);

impl From<TimeUs> for Time {
    fn from(TimeUs(t_us): TimeUs) -> Self {
        Self(t_us)
    }
}

impl From<Truth> for Flag {
    fn from(Truth(is): Truth) -> Self {
        Self(is)
    }
}

/// Writes tables with `hz` samples per second to the folder `out`, from a version with [`ANNOTATED_HZ`]:
/// `hz / 2` frames in each interval between two samples, whatever its length. Tables without changes are
/// copied. Below the same data set, `out` is another version of it.
///
/// # Errors
/// Fails if `hz` is no multiple of the annotated rate from 4 to 20, if several versions exist and none is
/// selected, if a table is missing or damaged, if a token is unresolved, or if the folder cannot be written.
pub fn interpolate_tables(
    locator: &LogLocator,
    hz: u8,
    out: &Path,
) -> Result<InterpolatedCounts, DatasetError> {
    let tables = &table_folder(locator)?;
    let frames = hz / ANNOTATED_HZ;
    if !hz.is_multiple_of(ANNOTATED_HZ) || !(2..=MAX_FRAMES).contains(&frames) {
        let expected = format!("a multiple of {ANNOTATED_HZ} Hz from 4 to {}", ANNOTATED_HZ * MAX_FRAMES);
        return Err(FileError::content(expected, format!("{hz} Hz"), tables).into());
    }
    let whole = WholeFolder::open(out, KIND, &Inputs::new([tables]))?;
    let source = Source::read(tables)?;
    let mut counts = InterpolatedCounts::default();
    whole.write(|folder| -> Result<(), FileError> {
        let samples = source.samples(frames);
        counts.samples = samples.len();
        let scenes = count_by(samples.iter().map(|sample| sample.scene_token.as_str()));
        write(folder, "sample", &samples)?;
        let annotations = source.annotations(frames, tables)?;
        counts.annotations = annotations.len();
        let instances = count_by(annotations.iter().map(|annotation| annotation.instance_token.as_str()));
        write(folder, "sample_annotation", &annotations)?;
        let (files, repeated) = source.sample_data(frames);
        (counts.files, counts.repeated) = (files.len(), repeated);
        write(folder, "sample_data", &files)?;
        recount(tables, folder, "scene", "nbr_samples", &scenes)?;
        recount(tables, folder, "instance", "nbr_annotations", &instances)?;
        copy_others(tables, folder)
    })?;
    Ok(counts)
}

/// The tables to interpolate.
struct Source {
    samples: Vec<Sample>,
    annotations: Vec<Annotation>,
    files: Vec<SampleData>,
    /// Place of a sample by token.
    sample_places: FxHashMap<String, usize>,
}

impl Source {
    fn read(tables: &Path) -> Result<Self, FileError> {
        let samples: Vec<Sample> = read(tables, "sample")?;
        let sample_places =
            samples.iter().enumerate().map(|(place, sample)| (sample.links.token.clone(), place)).collect();
        let (annotations, files) = (read(tables, "sample_annotation")?, read(tables, "sample_data")?);
        Ok(Self { samples, annotations, files, sample_places })
    }

    /// Returns the next sample of a scene.
    fn next(&self, sample: &Sample) -> Option<&Sample> {
        self.sample_places.get(&sample.links.next).map(|place| &self.samples[*place])
    }

    fn samples(&self, frames: u8) -> Vec<Sample> {
        let mut new = Vec::new();
        for sample in &self.samples {
            let next = self.next(sample);
            let links = sample.links.of_key(frames, !sample.links.prev.is_empty(), next.is_some());
            new.push(Sample { links, ..sample.clone() });
            let Some(next) = next else { continue };
            for number in 1..frames {
                let t_us = lerp(sample.timestamp.0 as f64, next.timestamp.0 as f64, share(number, frames));
                let links = sample.links.of_new(number, frames, &next.links.token);
                let (timestamp, others) = (Time(t_us.round() as i64), Map::new());
                new.push(Sample { links, timestamp, scene_token: sample.scene_token.clone(), others });
            }
        }
        new
    }

    fn annotations(&self, frames: u8, tables: &Path) -> Result<Vec<Annotation>, FileError> {
        let mut of_samples: Vec<Vec<&Annotation>> = vec![Vec::new(); self.samples.len()];
        for annotation in &self.annotations {
            let place = self.sample_places.get(&annotation.sample_token).ok_or_else(|| {
                let found = format!("sample {:?} of {}", annotation.sample_token, annotation.links.token);
                FileError::content("samples that exist", found, &path(tables, "sample_annotation"))
            })?;
            of_samples[*place].push(annotation);
        }
        let by_instance = |token: &str| -> FxHashMap<&str, &Annotation> {
            let of_sample = self.sample_places.get(token).map_or(&[][..], |place| &of_samples[*place]);
            of_sample.iter().map(|annotation| (annotation.instance_token.as_str(), *annotation)).collect()
        };
        let mut new = Vec::new();
        for (sample, annotations) in self.samples.iter().zip(&of_samples) {
            let (before, after) = (by_instance(&sample.links.prev), by_instance(&sample.links.next));
            for annotation in annotations {
                let instance = annotation.instance_token.as_str();
                let (is_before, is_after) = (before.contains_key(instance), after.contains_key(instance));
                let links = annotation.links.of_key(frames, is_before, is_after);
                new.push(Annotation { links, ..(*annotation).clone() });
            }
            for number in 1..frames {
                let Some(next) = self.next(sample) else { break };
                let at = sample.share_of_new(next, number, frames);
                let pairs = annotations.iter().filter_map(|annotation| {
                    Some((*annotation, *after.get(annotation.instance_token.as_str())?))
                });
                new.extend(pairs.map(|(one, other)| one.towards(other, at, (number, frames))));
            }
        }
        Ok(new)
    }

    /// Returns images and sweeps, and the number of repeated ones.
    fn sample_data(&self, frames: u8) -> (Vec<SampleData>, usize) {
        let by_token: FxHashMap<&str, &SampleData> =
            self.files.iter().map(|file| (file.links.token.as_str(), file)).collect();
        let (mut new, mut repeated) = (Vec::new(), 0);
        for key in self.files.iter().filter(|file| file.is_key_frame.0) {
            let sample = self.sample_places.get(&key.sample_token).map(|place| &self.samples[*place]);
            let between = between(key, &by_token);
            let next = between.next.zip(sample.and_then(|sample| self.next(sample)));
            let mut links = key.links.of_key(frames, false, next.is_some());
            links.prev = previous_key(key, &by_token)
                .map_or_else(String::new, |before| numbered(&before.links.token, frames - 1));
            if next.is_none() {
                links.next = String::new();
            }
            new.push(SampleData { links, ..key.clone() });
            let Some((next, _)) = next else { continue };
            for number in 1..frames {
                let t_us = lerp(key.timestamp.0 as f64, next.timestamp.0 as f64, share(number, frames));
                let off = |file: &&SampleData| (file.timestamp.0 as f64 - t_us).abs();
                let shown = between.files.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)));
                let shown = shown.unwrap_or(key);
                repeated += usize::from(shown.is_key_frame.0);
                new.push(SampleData {
                    links: key.links.of_new(number, frames, &next.links.token),
                    sample_token: numbered(&key.sample_token, number),
                    is_key_frame: Flag(true),
                    ..shown.clone()
                });
            }
        }
        (new, repeated)
    }
}

/// Files of a sensor from a key frame to the next one.
struct Between<'a> {
    /// The key frame, and those behind it.
    files: Vec<&'a SampleData>,
    next: Option<&'a SampleData>,
}

fn between<'a>(key: &'a SampleData, by_token: &FxHashMap<&str, &'a SampleData>) -> Between<'a> {
    let mut files = vec![key];
    let mut last = key;
    // At most as many steps as there are files: links of damaged tables may form a ring.
    for _ in 0..by_token.len() {
        match by_token.get(last.links.next.as_str()) {
            Some(next) if next.is_key_frame.0 => return Between { files, next: Some(next) },
            Some(next) => last = next,
            None => break,
        }
        files.push(last);
    }
    Between { files, next: None }
}

fn previous_key<'a>(key: &SampleData, by_token: &FxHashMap<&str, &'a SampleData>) -> Option<&'a SampleData> {
    let mut before = by_token.get(key.links.prev.as_str())?;
    for _ in 0..by_token.len() {
        if before.is_key_frame.0 {
            return Some(before);
        }
        before = by_token.get(before.links.prev.as_str())?;
    }
    None
}

impl Sample {
    /// Returns the place in time of a new sample between this one and the next, 0 to 1. As for ASAP's, its
    /// time is an `f64` of absolute microseconds: a multiple of 1/4 us.
    fn share_of_new(&self, next: &Self, number: u8, frames: u8) -> f64 {
        let [from, to] = [self, next].map(|sample| sample.timestamp.0 as f64);
        let length = to - from;
        if length == 0.0 { 0.0 } else { (lerp(from, to, share(number, frames)) - from) / length }
    }
}

impl Links {
    /// Links of an annotated record. The neighbors are new ones if the object is in the sample before or
    /// after.
    fn of_key(&self, frames: u8, is_before: bool, is_after: bool) -> Self {
        Self {
            token: self.token.clone(),
            prev: if is_before { numbered(&self.prev, frames - 1) } else { self.prev.clone() },
            next: if is_after { numbered(&self.token, 1) } else { self.next.clone() },
        }
    }

    /// Links of a new record behind an annotated one.
    fn of_new(&self, number: u8, frames: u8, next: &str) -> Self {
        let last = number + 1 == frames;
        Self {
            token: numbered(&self.token, number),
            prev: numbered(&self.token, number - 1),
            next: if last { next.to_owned() } else { numbered(&self.token, number + 1) },
        }
    }
}

impl Annotation {
    /// Returns the annotation of a new sample between two samples, at a share of the time between them.
    fn towards(&self, other: &Self, at: f64, (number, frames): (u8, u8)) -> Self {
        let (from, to) = (DVec3::from(self.translation), DVec3::from(other.translation));
        Self {
            links: self.links.of_new(number, frames, &other.links.token),
            sample_token: numbered(&self.sample_token, number),
            translation: (from + at * (to - from)).into(),
            rotation: slerp(self.rotation, other.rotation, at),
            ..self.clone()
        }
    }
}

/// Interpolates rotations `w x y z` on the shorter arc.
fn slerp(from: [f64; 4], to: [f64; 4], at: f64) -> [f64; 4] {
    // Nearly equal rotations: the chord instead of the arc, as in pyquaternion, which ASAP uses.
    const CHORD: f64 = 0.9995;
    let [from, to] = [from, to].map(|[w, x, y, z]| DQuat::from_xyzw(x, y, z, w).normalize());
    let from = if from.dot(to) < 0.0 { -from } else { from };
    let cos = from.dot(to);
    let mixed = if cos > CHORD {
        from * (1.0 - at) + to * at
    } else {
        let angle = cos.acos();
        from * ((angle * (1.0 - at)).sin() / angle.sin()) + to * ((angle * at).sin() / angle.sin())
    };
    let DQuat { x, y, z, w } = mixed.normalize();
    [w, x, y, z]
}

fn share(number: u8, frames: u8) -> f64 {
    f64::from(number) / f64::from(frames)
}

fn lerp(from: f64, to: f64, at: f64) -> f64 {
    from + at * (to - from)
}

/// Returns the token of the record behind one with this token; number 0 is that one.
fn numbered(token: &str, number: u8) -> String {
    if number == 0 { token.to_owned() } else { format!("{token}{number}") }
}

fn path(tables: &Path, table: &str) -> PathBuf {
    tables.join(format!("{table}.json"))
}

fn read<T: DeserializeOwned>(tables: &Path, table: &str) -> Result<Vec<T>, FileError> {
    json::read(&path(tables, table), &format!("a table of {table} records"))
}

/// Writes a table.
pub(super) fn write<T: Serialize>(folder: &Path, table: &str, records: &[T]) -> Result<(), FileError> {
    let path = path(folder, table);
    write_whole(&path, |out| {
        serde_json::to_writer(out, records).map_err(|error| FileError::io("write", &path)(error.into()))
    })
}

fn count_by<'a>(keys: impl Iterator<Item = &'a str>) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    keys.for_each(|key| *counts.entry(key.to_owned()).or_default() += 1);
    counts
}

/// Writes a table with other counts.
fn recount(
    tables: &Path,
    folder: &Path,
    table: &str,
    field: &str,
    counts: &BTreeMap<String, usize>,
) -> Result<(), FileError> {
    let mut records: Vec<Map<String, Value>> = read(tables, table)?;
    for record in &mut records {
        let token = record.get("token").and_then(Value::as_str).unwrap_or_default();
        let count = counts.get(token).copied().unwrap_or_default();
        record.insert(field.to_owned(), count.into());
    }
    write(folder, table, &records)
}

/// Copies the tables that are not written.
fn copy_others(tables: &Path, folder: &Path) -> Result<(), FileError> {
    for entry in std::fs::read_dir(tables).map_err(FileError::io("read", tables))? {
        let from = entry.map_err(FileError::io("read", tables))?.path();
        let Some(name) = from.file_name().filter(|_| from.extension().is_some_and(|end| end == "json"))
        else {
            continue;
        };
        let to = folder.join(name);
        if !to.exists() && from.is_file() {
            std::fs::copy(&from, &to).map_err(FileError::io("copy", &from))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
