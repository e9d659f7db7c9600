//! Tables of some samples of a version, in which everything else is left out.
//!
//! # How it works
//! The samples are those of given images. Their records, and all records that these refer to, keep their
//! order and fields; `prev`, `next`, and the counts and ends of scenes and instances are new. Of other
//! sensors, only the key frames of the main LiDAR stay: the development kit takes ego poses from them.
//! Tables are read row by row, since those of the trainval set have more than a gigabyte.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rustc_hash::FxHashMap;
use serde::Serialize;
use serde_json::{Map, Value};

use super::choose::version_folder;
use super::interpolate::write;
use super::tables::rows::for_each_row;
use super::tables::{
    Annotation, CalibratedSensor, EgoPose, Instance, LogRecord, Record, Sample, SampleData, Scene, Sensor,
};
use super::unsorted::MAIN_LIDAR;
use crate::dataset::{DatasetError, LogLocator};
use crate::error::FileError;
use crate::files::input::is_there;
use crate::files::json;

/// Tables that describe values and have no records of samples.
const WHOLE: [&str; 3] = ["category", "attribute", "visibility"];
/// Table of maps, which names logs in a list.
const MAP: &str = "map";
const LOG_TOKENS: &str = "log_tokens";

/// Record with all of its fields.
type Row = Map<String, Value>;

/// Records of a table that stay.
type Rows<R> = Vec<(R, Row)>;

/// Tables of some samples of a version.
#[derive(Clone, Debug)]
pub struct TableSubset {
    /// Name of the version and of its table folder.
    pub version: String,
    /// The samples, by scene and time.
    pub samples: Vec<SubsetSample>,
    /// Files of their LiDAR sweeps, relative to the data set.
    pub sweeps: Vec<PathBuf>,
    /// Folder of the version's tables.
    source: PathBuf,
    tables: Vec<(&'static str, Vec<Row>)>,
}

/// Sample of a [`TableSubset`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SubsetSample {
    /// Token of the sample.
    pub token: String,
    /// Name of its scene.
    pub scene: String,
    /// Time, microseconds.
    pub timestamp: i64,
    /// Files of its images by channel, relative to the data set.
    pub images: BTreeMap<String, String>,
}

/// Records of a group, linked in time: the ends of the chain and its length.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Chain {
    first: String,
    last: String,
    count: usize,
}

impl TableSubset {
    /// Reads the samples that have images with these tokens of `sample_data`.
    ///
    /// # Errors
    /// Fails if several versions exist and none is selected, if a table is missing or damaged, or if a token
    /// is unresolved.
    pub fn read(locator: &LogLocator, images: &BTreeSet<&str>) -> Result<Self, DatasetError> {
        let source = version_folder(&locator.path, locator.version.as_deref())?;
        let folder = source.as_path();
        let channels = Channels::read(folder)?;
        let is_image = |data: &SampleData| images.contains(data.token.as_str());
        let is_lidar = |data: &SampleData| data.is_key_frame.0 && channels.of(data) == Some(MAIN_LIDAR);
        let mut files = rows(folder, |data: &SampleData| is_image(data) || is_lidar(data))?;
        check_found(folder, images, &files)?;
        let shown = files.iter().filter(|(data, _)| is_image(data));
        let tokens: BTreeSet<String> = shown.map(|(data, _)| data.sample_token.clone()).collect();
        files.retain(|(data, _)| tokens.contains(&data.sample_token));

        let mut samples: Rows<Sample> = wanted(folder, tokens.iter())?;
        let mut scenes: Rows<Scene> = wanted(folder, samples.iter().map(|(sample, _)| &sample.scene_token))?;
        let in_time = InTime::of(&samples, &scenes);
        let chains = link(&mut samples, |sample| (sample.scene_token.clone(), in_time.place(&sample.token)));
        for (scene, row) in &mut scenes {
            set_ends(
                row,
                chains.get(&scene.token),
                ["nbr_samples", "first_sample_token", "last_sample_token"],
            );
        }

        let mut boxes = rows(folder, |annotation: &Annotation| tokens.contains(&annotation.sample_token))?;
        let mut instances: Rows<Instance> =
            wanted(folder, boxes.iter().map(|(annotation, _)| &annotation.instance_token))?;
        let place = |annotation: &Annotation| in_time.place(&annotation.sample_token);
        let tracks = link(&mut boxes, |annotation| (annotation.instance_token.clone(), place(annotation)));
        let ends = ["nbr_annotations", "first_annotation_token", "last_annotation_token"];
        for (instance, row) in &mut instances {
            set_ends(row, tracks.get(&instance.token), ends);
        }

        link(&mut files, |data| {
            let (scene, channel) = (in_time.scene(&data.sample_token), channels.of(data).unwrap_or_default());
            (format!("{scene} {channel}"), in_time.place(&data.sample_token))
        });
        let poses: Rows<EgoPose> = wanted(folder, files.iter().map(|(data, _)| &data.ego_pose_token))?;
        let calibrated: Rows<CalibratedSensor> =
            wanted(folder, files.iter().map(|(data, _)| &data.calibrated_sensor_token))?;
        let sensors: Rows<Sensor> =
            wanted(folder, calibrated.iter().map(|(sensor, _)| &sensor.sensor_token))?;
        let logs: Rows<LogRecord> = wanted(folder, scenes.iter().map(|(scene, _)| &scene.log_token))?;
        let maps = maps(folder, &logs)?;

        let (samples_of_files, sweeps) = in_time.list(&files, &channels, is_image);
        let mut tables = vec![
            table(scenes),
            table(samples),
            table(files),
            table(poses),
            table(calibrated),
            table(sensors),
            table(boxes),
            table(instances),
            table(logs),
        ];
        tables.extend(maps.map(|maps| (MAP, maps)));
        let version = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { version, samples: samples_of_files, sweeps, source, tables })
    }

    /// Writes the tables to a folder, which is created.
    ///
    /// # Errors
    /// Fails if a file cannot be read or written.
    pub fn write(&self, folder: &Path) -> Result<(), FileError> {
        std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
        for (name, rows) in &self.tables {
            write(folder, name, rows)?;
        }
        for name in WHOLE.map(|table| format!("{table}.json")) {
            let from = self.source.join(&name);
            if is_there(&from)? {
                std::fs::copy(&from, folder.join(&name)).map_err(FileError::io("copy", &from))?;
            }
        }
        Ok(())
    }
}

/// Channel of each calibrated sensor.
struct Channels(FxHashMap<String, String>);

impl Channels {
    fn read(folder: &Path) -> Result<Self, FileError> {
        let sensors = rows(folder, |_: &Sensor| true)?;
        let channels: FxHashMap<&str, &str> =
            sensors.iter().map(|(sensor, _)| (sensor.token.as_str(), sensor.channel.as_str())).collect();
        let calibrated = rows(folder, |_: &CalibratedSensor| true)?.into_iter();
        let named = calibrated.filter_map(|(sensor, _)| {
            let channel = channels.get(sensor.sensor_token.as_str())?;
            Some((sensor.token, (*channel).to_owned()))
        });
        Ok(Self(named.collect()))
    }

    fn of(&self, data: &SampleData) -> Option<&str> {
        self.0.get(&data.calibrated_sensor_token).map(String::as_str)
    }
}

/// Samples by scene and time.
struct InTime {
    samples: Vec<SubsetSample>,
    /// Place of a sample by token.
    places: FxHashMap<String, usize>,
}

impl InTime {
    fn of(samples: &Rows<Sample>, scenes: &Rows<Scene>) -> Self {
        let names: FxHashMap<&str, &str> =
            scenes.iter().map(|(scene, _)| (scene.token.as_str(), scene.name.as_str())).collect();
        let sample = |sample: &Sample| SubsetSample {
            token: sample.token.clone(),
            scene: names.get(sample.scene_token.as_str()).copied().unwrap_or_default().to_owned(),
            timestamp: sample.timestamp.0,
            images: BTreeMap::new(),
        };
        let mut samples: Vec<SubsetSample> = samples.iter().map(|(row, _)| sample(row)).collect();
        samples.sort_by(|a, b| (&a.scene, a.timestamp, &a.token).cmp(&(&b.scene, b.timestamp, &b.token)));
        let places = samples.iter().enumerate().map(|(place, sample)| (sample.token.clone(), place));
        Self { places: places.collect(), samples }
    }

    /// Returns the place of a sample in the subset.
    fn place(&self, token: &str) -> usize {
        self.places.get(token).copied().unwrap_or_default()
    }

    fn scene(&self, token: &str) -> &str {
        &self.samples[self.place(token)].scene
    }

    /// Returns the samples with their images, and the files of the sweeps.
    fn list(
        self,
        files: &Rows<SampleData>,
        channels: &Channels,
        is_image: impl Fn(&SampleData) -> bool,
    ) -> (Vec<SubsetSample>, Vec<PathBuf>) {
        let Self { mut samples, places } = self;
        let mut sweeps = BTreeSet::new();
        for (data, _) in files {
            match (is_image(data), places.get(&data.sample_token), channels.of(data)) {
                (true, Some(place), Some(channel)) => {
                    samples[*place].images.insert(channel.to_owned(), data.filename.clone());
                }
                _ => _ = sweeps.insert(PathBuf::from(&data.filename)),
            }
        }
        (samples, sweeps.into_iter().collect())
    }
}

/// Reads the records of a table that are accepted by `keep`, in file order.
fn rows<R: Record>(folder: &Path, mut keep: impl FnMut(&R) -> bool) -> Result<Rows<R>, FileError> {
    let mut kept = Vec::new();
    for_each_row(&R::path(folder), R::TABLE, |_, bytes| {
        let record: R = json::parsed(bytes)?;
        if keep(&record) {
            kept.push((record, json::parsed(bytes)?));
        }
        Ok::<(), String>(())
    })?;
    Ok(kept)
}

/// Reads the records with these tokens, in file order.
fn wanted<'a, R: Record>(
    folder: &Path,
    tokens: impl Iterator<Item = &'a String>,
) -> Result<Rows<R>, DatasetError> {
    let tokens: BTreeSet<&str> = tokens.map(String::as_str).collect();
    let found = rows(folder, |record: &R| tokens.contains(record.token()))?;
    check_found(folder, &tokens, &found)?;
    Ok(found)
}

/// Checks that each token has a record.
fn check_found<R: Record>(
    folder: &Path,
    tokens: &BTreeSet<&str>,
    found: &Rows<R>,
) -> Result<(), DatasetError> {
    let found: BTreeSet<&str> = found.iter().map(|(record, _)| record.token()).collect();
    tokens.difference(&found).next().map_or(Ok(()), |token| {
        let (table, token, by) = (R::TABLE, (*token).to_owned(), "a generated sample".to_owned());
        Err(DatasetError::DanglingToken { table, token, by, path: R::path(folder) })
    })
}

/// Links the records of each group by their places in time. Returns the chains by group.
fn link<R: Record>(rows: &mut Rows<R>, place: impl Fn(&R) -> (String, usize)) -> BTreeMap<String, Chain> {
    let mut order: Vec<((String, usize), usize)> =
        rows.iter().enumerate().map(|(index, (record, _))| (place(record), index)).collect();
    order.sort();
    let mut chains = BTreeMap::new();
    for chain in order.chunk_by(|((one, _), _), ((other, _), _)| one == other) {
        let tokens: Vec<String> = chain.iter().map(|(_, index)| rows[*index].0.token().to_owned()).collect();
        for (number, (_, index)) in chain.iter().enumerate() {
            let token = |at: Option<usize>| at.and_then(|at| tokens.get(at)).cloned().unwrap_or_default();
            let row = &mut rows[*index].1;
            row.insert("prev".to_owned(), token(number.checked_sub(1)).into());
            row.insert("next".to_owned(), token(Some(number + 1)).into());
        }
        if let ([first, ..], [.., last]) = (tokens.as_slice(), tokens.as_slice()) {
            let (first, last, count) = (first.clone(), last.clone(), tokens.len());
            chains.insert(chain[0].0.0.clone(), Chain { first, last, count });
        }
    }
    chains
}

/// Sets the length of a chain and its ends.
fn set_ends(row: &mut Row, chain: Option<&Chain>, [count, first, last]: [&str; 3]) {
    if let Some(chain) = chain {
        row.insert(count.to_owned(), chain.count.into());
        row.insert(first.to_owned(), chain.first.clone().into());
        row.insert(last.to_owned(), chain.last.clone().into());
    }
}

/// Reads the maps of these logs; `None` if there is no such table.
fn maps(folder: &Path, logs: &Rows<LogRecord>) -> Result<Option<Vec<Row>>, FileError> {
    let path = folder.join(format!("{MAP}.json"));
    if !is_there(&path)? {
        return Ok(None);
    }
    let is_kept = |token: &Value| logs.iter().any(|(log, _)| token.as_str() == Some(log.token.as_str()));
    let mut maps: Vec<Row> = json::read(&path, "a table of map records")?;
    maps.retain_mut(|map| {
        let Some(Value::Array(tokens)) = map.get_mut(LOG_TOKENS) else { return true };
        tokens.retain(is_kept);
        !tokens.is_empty()
    });
    Ok(Some(maps))
}

fn table<R: Record>(rows: Rows<R>) -> (&'static str, Vec<Row>) {
    (R::TABLE, rows.into_iter().map(|(_, row)| row).collect())
}
