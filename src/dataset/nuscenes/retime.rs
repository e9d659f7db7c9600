//! Times of key frames that run backward.
//!
//! ASAP's tables at 12 Hz repeat a key frame's file under interpolated times, of which the last may be later
//! than the next key frame. The ego poses are those of the recorded data, so their times are the true ones.

use std::collections::BTreeSet;

use rustc_hash::FxHashMap;
use serde::Deserialize;

use super::chain::Chain;
use super::sensors::{SensorKind, Sensors};
use super::tables::SampleData;
use super::tables::numbers::TimeUs;
use crate::dataset::clock::Offset;
use crate::dataset::recording::notes::{Notes, note};

/// Key frame of a sensor.
#[derive(Clone, Copy)]
struct Shot<'a> {
    file: &'a str,
    t_us: i64,
}

impl Shot<'_> {
    /// Returns whether a later sample may have `next`: another file of a later time, or the same file.
    fn is_before(&self, next: &Self) -> bool {
        self.t_us < next.t_us || self.file == next.file
    }
}

/// Gives all sweeps and images the times of their ego poses, if key frames of a sensor run backward and these
/// times grow. Otherwise nothing changes, and `frames` refuses times that run backward.
pub(super) fn retime(sensors: &mut Sensors, chain: &Chain, notes: &mut Notes) {
    let records = &sensors.data.records;
    let stated: Vec<i64> = records.iter().map(|data| data.timestamp.0).collect();
    let backward = backward(sensors, chain, &stated);
    if backward.is_empty() {
        return;
    }
    let Some(measured) = records.iter().map(|data| pose_us(sensors, data)).collect::<Option<Vec<i64>>>()
    else {
        return;
    };
    // A repeated file has one time.
    let mut times = FxHashMap::default();
    let is_one =
        |(data, t_us): (&SampleData, &i64)| *times.entry(data.filename.clone()).or_insert(*t_us) == *t_us;
    let is_near = |(data, t_us): (&SampleData, &i64)| {
        let place = chain.place.get(&data.sample_token).filter(|_| data.is_key_frame.0);
        place.is_none_or(|place| Offset::of(*t_us, chain.times_us[*place]).is_none())
    };
    let is_true = records.iter().zip(&measured).all(is_near) && records.iter().zip(&measured).all(is_one);
    if !is_true || !self::backward(sensors, chain, &measured).is_empty() {
        return;
    }
    let channels: BTreeSet<&str> = backward.iter().map(String::as_str).collect();
    let channels = channels.into_iter().collect::<Vec<_>>().join(", ");
    note(
        notes,
        &format!("key frames of {channels} at or before the one of the sample before"),
        backward.len(),
    );
    let moved = stated.iter().zip(&measured).filter(|(stated, measured)| stated != measured).count();
    note(notes, "sweeps and images at the times of their ego poses, since key frames run backward", moved);
    for (data, t_us) in sensors.data.records.iter_mut().zip(measured) {
        data.timestamp = TimeUs(t_us);
    }
}

/// Returns the channel of each key frame that is not after the one of the sample before, for a time per
/// record.
fn backward(sensors: &Sensors, chain: &Chain, times_us: &[i64]) -> Vec<String> {
    let mut shots: Vec<(&str, usize, Shot<'_>)> = Vec::new();
    for (data, t_us) in sensors.data.records.iter().zip(times_us).filter(|(data, _)| data.is_key_frame.0) {
        let (Ok((sensor, _)), Some(place)) = (sensors.sensor_of(data), chain.place.get(&data.sample_token))
        else {
            continue;
        };
        if sensor.kind() != SensorKind::Other {
            shots.push((&sensor.channel, *place, Shot { file: &data.filename, t_us: *t_us }));
        }
    }
    shots.sort_by_key(|(channel, place, _)| (*channel, *place));
    let pairs = shots.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    pairs.filter(|pair| !pair[0].2.is_before(&pair[1].2)).map(|pair| pair[1].0.to_owned()).collect()
}

/// Returns the time of the ego pose of sensor data, microseconds, or the stated one of data that are not
/// read; `None` if the pose has no time.
fn pose_us(sensors: &Sensors, data: &SampleData) -> Option<i64> {
    let origin = sensors.origin(data).ok().filter(|origin| origin.sensor.kind() != SensorKind::Other);
    let Some(origin) = origin else { return Some(data.timestamp.0) };
    TimeUs::deserialize(origin.ego.timestamp.as_ref()?).ok().map(|t_us| t_us.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::ImageDistortion;
    use crate::dataset::nuscenes::tables::{Record, Table};
    use serde_json::{Value, json};

    /// Samples every 200 ms, each with the record of a camera and of a LiDAR: stated time, time of the pose,
    /// number of the file.
    struct Tables {
        camera: Vec<[i64; 3]>,
        lidar: Vec<[i64; 3]>,
    }

    fn table<R: Record>(rows: Vec<Value>) -> Table<R> {
        let rows = rows.into_iter().map(|row| serde_json::from_value(row).unwrap()).collect();
        Table::new("a.json".into(), rows).unwrap()
    }

    fn retimed(tables: &Tables) -> (Vec<i64>, Vec<(String, usize)>) {
        let all = || [("cam", &tables.camera), ("lidar", &tables.lidar)].into_iter();
        let rows = |row: fn(&str, usize, [i64; 3]) -> Value| -> Vec<Value> {
            all().flat_map(|(name, of)| of.iter().enumerate().map(move |(i, v)| row(name, i, *v))).collect()
        };
        let data = rows(|name, i, [t_us, _, file]| {
            json!({"token": format!("{name}{i}"), "sample_token": i.to_string(), "timestamp": t_us,
                "ego_pose_token": format!("{name}{i}"), "calibrated_sensor_token": name, "is_key_frame": true,
                "filename": format!("{name}{file}")})
        });
        let poses = rows(|name, i, [_, t_us, _]| {
            let t_us = (t_us >= 0).then_some(t_us);
            json!({"token": format!("{name}{i}"), "rotation": [1.0, 0.0, 0.0, 0.0],
                "translation": [0.0, 0.0, 0.0], "timestamp": t_us})
        });
        let calibrated = |name| {
            let none = [0.0; 3];
            let rotation = [1.0, 0.0, 0.0, 0.0];
            json!({"token": name, "sensor_token": name, "translation": none, "rotation": rotation})
        };
        let sensor = |(name, modality)| json!({"token": name, "channel": name, "modality": modality});
        let mut sensors = Sensors {
            data: table(data),
            poses: table(poses),
            calibrated: table(vec![calibrated("cam"), calibrated("lidar")]),
            sensors: table([("cam", "camera"), ("lidar", "lidar")].map(sensor).to_vec()),
            distortion: ImageDistortion::default(),
        };
        let count = tables.camera.len();
        let chain = Chain {
            times_us: (0..count as i64).map(|i| 1_000_000 + 200_000 * i).collect(),
            place: (0..count).map(|i| (i.to_string(), i)).collect(),
        };
        let mut notes = Notes::new();
        retime(&mut sensors, &chain, &mut notes);
        let times = sensors.data.records.iter().map(|data| data.timestamp.0).collect();
        (times, notes.counts.into_iter().collect())
    }

    /// The quirk of ASAP: a file is repeated with later times, the last one after the next file's.
    fn quirk() -> Tables {
        Tables {
            camera: vec![[900, 900, 0], [1000, 900, 0], [1110, 900, 0], [1100, 1100, 1], [1150, 1100, 1]]
                .into_iter()
                .map(|[t, pose, file]| [1000 * t, 1000 * pose, file])
                .collect(),
            lidar: vec![[1000, 1000, 0], [1100, 1000, 0], [1180, 1000, 0], [1200, 1200, 1], [1300, 1200, 1]]
                .into_iter()
                .map(|[t, pose, file]| [1000 * t, 1000 * pose, file])
                .collect(),
        }
    }

    #[test]
    fn backward_times_become_those_of_the_poses() {
        let (times, notes) = retimed(&quirk());
        let expected = [900, 900, 900, 1100, 1100, 1000, 1000, 1000, 1200, 1200].map(|t| 1000 * t);
        assert_eq!(times, expected);
        let expected = [
            ("key frames of cam at or before the one of the sample before", 1),
            ("sweeps and images at the times of their ego poses, since key frames run backward", 6),
        ];
        assert_eq!(notes, expected.map(|(kind, count)| (kind.to_owned(), count)));
    }

    /// Growing times stay as they are, and so do those that poses do not explain.
    #[test]
    fn other_times_stay() {
        let edited = |edit: &dyn Fn(&mut Tables)| {
            let mut tables = quirk();
            edit(&mut tables);
            let stated =
                tables.camera.iter().chain(&tables.lidar).map(|[t_us, ..]| *t_us).collect::<Vec<_>>();
            (retimed(&tables), (stated, Vec::new()))
        };
        let edits: [&dyn Fn(&mut Tables); 6] = [
            &|tables| tables.camera[2][0] = 1_090_000, // no time runs backward
            &|tables| tables.camera[3][1] = 900_000,   // neither do the poses grow
            &|tables| tables.camera[1][1] = 950_000,   // one file at two times
            &|tables| tables.camera[2][1] = -1,        // a pose without a time
            &|tables| tables.camera[4] = [1_150_000, 9_000_000, 2], // a pose far from its sample
            // poses of the other sensor run backward
            &|tables| tables.lidar[3..].iter_mut().for_each(|row| row[1] = 999_000),
        ];
        for (number, edit) in edits.into_iter().enumerate() {
            let (found, unchanged) = edited(edit);
            assert_eq!(found, unchanged, "edit {number}");
        }
    }
}
