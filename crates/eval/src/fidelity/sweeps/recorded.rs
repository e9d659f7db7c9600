//! Recorded sweeps against rays that are cast toward their points.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use glam::DVec3;
use point_skeleton::dataset::EgoTrack;
use point_skeleton::geometry::Pose;
use point_skeleton::lidar::{LidarDevice, LidarRays, LidarSpec, Motion};
use point_skeleton::scene::EgoOffset;
use point_skeleton::{Log, Renderer};

use super::compare::{Ray, Sums, SweepRow};
use super::states;
use crate::fidelity::{FidelityError, FidelityFrames};

/// Rounds to find the time of a point: the device moves less than a column in the last one.
const ROUNDS: usize = 3;

/// Each point of a recorded sweep in the range of its device is a ray, at the time at which the device was
/// turned toward it. A merged sweep says the device of each point: the spec's device with the same number, or
/// its last one, gives the timing.
pub(super) fn measure(
    log: &Log,
    renderer: &mut Renderer<'_>,
    frames: &FidelityFrames,
    spec: &LidarSpec,
    on_step: &mut dyn FnMut(&str),
) -> Result<Vec<SweepRow>, FidelityError> {
    let (recording, track) = (log.recording(), EgoTrack::new(log.recording()));
    let mut devices: BTreeMap<usize, Sums> = BTreeMap::new();
    for frame in frames.iter() {
        let none = || FidelityError::NoFrame { frame, log: recording.shown_name().into_owned() };
        let sweeps = &recording.frames.get(frame).ok_or_else(none)?.sweeps;
        for record in sweeps.iter().filter(|record| record.is_key) {
            let found = states(recording, &track, record.t_us, EgoOffset::default(), spec.duration_s());
            let (state, other) = found.ok_or_else(none)?;
            let motion = Motion::new(&state, other.as_ref());
            let sweep = log.reader().read_sweep(record)?;
            let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
            let mut points: BTreeMap<usize, Vec<DVec3>> = BTreeMap::new();
            for point in &sweep.points {
                let device = if sweep.devices { usize::from(point.ring) } else { 0 };
                let at = DVec3::from(point.position.map(f64::from));
                points.entry(device).or_default().push(global_from_lidar.transform_point(at));
            }
            for (number, points) in points {
                let device = &spec.devices[number.min(spec.devices.len() - 1)];
                devices.entry(number).or_default().add(&compared(renderer, device, &motion, &points)?);
            }
        }
        on_step(&format!("frame {frame:06}"));
    }
    let all = Sums::of_all(devices.values());
    let rows = devices.into_iter().map(|(number, sums)| sums.row(format!("device {number}")));
    Ok(rows.chain([all.row("all".to_owned())]).collect())
}

/// Returns the rays of a device toward recorded points, in the global frame, with what they meet.
fn compared(
    renderer: &mut Renderer<'_>,
    device: &LidarDevice,
    motion: &Motion<'_>,
    points: &[DVec3],
) -> Result<Vec<Ray>, FidelityError> {
    let [near_m, far_m] = device.range_m;
    let poses: Vec<Pose> = (0..device.columns).map(|column| device.pose(motion, column)).collect();
    let mut columns: Vec<Vec<Ray>> = vec![Vec::new(); device.columns];
    for point in points {
        let column = column(device, &poses, *point);
        let offset = *point - poses[column].translation;
        let true_m = offset.length();
        if (near_m..=far_m).contains(&true_m) {
            let (origin, direction) = (poses[column].translation, offset / true_m);
            columns[column].push(Ray { origin, direction, true_m: Some(true_m), ..Ray::default() });
        }
    }
    let rays = |(column, rays): (usize, &Vec<Ray>)| LidarRays {
        after_s: device.offset_s(column),
        origin: poses[column].translation,
        directions: rays.iter().map(|ray| ray.direction).collect(),
    };
    let cast: Vec<LidarRays> = columns.iter().enumerate().map(rays).collect();
    let hits = renderer.cast(&cast, motion, far_m)?;
    let with = |(ray, hit): (Ray, &Option<point_skeleton::lidar::LidarHit>)| Ray {
        found_m: hit.map(|hit| hit.range_m).filter(|range_m| *range_m >= near_m),
        ..ray
    };
    Ok(columns.into_iter().flatten().zip(hits.iter().flatten()).map(with).collect())
}

/// Returns the column at whose time a turning device is directed to a point.
fn column(device: &LidarDevice, poses: &[Pose], point: DVec3) -> usize {
    let [first, end] = device.azimuth_deg.map(f64::to_radians);
    let mut column = device.columns - 1;
    for _ in 0..ROUNDS {
        let at = poses[column].inverse().transform_point(point);
        let turned = (at.y.atan2(at.x) - first) * (end - first).signum();
        let share = turned.rem_euclid(TAU) / (end - first).abs();
        column = ((share * device.columns as f64) as usize).min(device.columns - 1);
    }
    column
}
