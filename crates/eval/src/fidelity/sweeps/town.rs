//! Sweeps of a town at moved poses against beams that are cast through the town itself.

use glam::DVec3;
use point_skeleton::Renderer;
use point_skeleton::dataset::{EgoTrack, LogReader};
use point_skeleton::lidar::{LidarDevice, LidarRays, LidarSpec, Motion};
use point_skeleton::scene::EgoOffset;
use pskel_town::{Town, TownRay};

use super::compare::{Ray, Sums, SweepRow};
use super::states;
use crate::fidelity::{FidelityError, FidelityFrames};

/// Angle between the rays that find the plane of the true surface, radians.
const TILT_RAD: f64 = 2e-4;

/// Poses relative to the recorded ones: meters to the left, and degrees to the left.
pub(super) const POSES: [(&str, f64, f64); 2] =
    [("logged", 0.0, 0.0), ("2 m to the left, 5 degrees", 2.0, 5.0)];

pub(super) fn measure(
    town: &Town,
    renderer: &mut Renderer<'_>,
    frames: &FidelityFrames,
    spec: &LidarSpec,
    on_step: &mut dyn FnMut(&str),
) -> Result<Vec<SweepRow>, FidelityError> {
    let (log, track) = (town.recording(), EgoTrack::new(town.recording()));
    let mut rows = Vec::new();
    for (name, left_m, yaw_deg) in POSES {
        let offset = EgoOffset { left_m, yaw_deg, ..EgoOffset::default() };
        let mut sums = Sums::default();
        for frame in frames.iter() {
            let none = || FidelityError::NoFrame { frame, log: log.shown_name().into_owned() };
            let t_us = log.frames.get(frame).ok_or_else(none)?.t_us;
            let (state, other) = states(log, &track, t_us, offset, spec.duration_s()).ok_or_else(none)?;
            let motion = Motion::new(&state, other.as_ref());
            for device in &spec.devices {
                sums.add(&compared(town, renderer, device, &motion)?);
            }
            on_step(&format!("{name}, frame {frame:06}"));
        }
        rows.push(sums.row(name.to_owned()));
    }
    Ok(rows)
}

/// Returns the rays of a device with what they meet in skeleton and town.
fn compared(
    town: &Town,
    renderer: &mut Renderer<'_>,
    device: &LidarDevice,
    motion: &Motion<'_>,
) -> Result<Vec<Ray>, FidelityError> {
    let rays = device.sweep_rays(motion);
    let [near_m, far_m] = device.range_m;
    let hits = renderer.cast(&rays, motion, far_m)?;
    let found =
        hits.iter().flatten().map(|hit| hit.map(|hit| hit.range_m).filter(|range_m| *range_m >= near_m));
    let truth = truth(town, &rays, motion.state().t_us);
    let within = |range_m: Option<f64>| range_m.filter(|range_m| (near_m..=far_m).contains(range_m));
    let compare = |((origin, direction), (found_m, (true_m, facing)))| Ray {
        origin,
        direction,
        found_m,
        true_m: within(true_m),
        facing,
    };
    Ok(each(&rays).zip(found.zip(truth)).map(compare).collect())
}

/// Iterates over origin and direction of each ray.
fn each(rays: &[LidarRays]) -> impl Iterator<Item = (DVec3, DVec3)> {
    rays.iter().flat_map(|rays| rays.directions.iter().map(|direction| (rays.origin, *direction)))
}

/// Returns the range at which each ray meets the town, and the cosine of the angle to the surface's normal:
/// two further rays close by find its plane.
fn truth(town: &Town, rays: &[LidarRays], t_us: i64) -> Vec<(Option<f64>, Option<f64>)> {
    let three = |direction: DVec3| {
        let across = direction.any_orthonormal_vector();
        let [a, b] = [across, direction.cross(across)].map(|to| (direction + to * TILT_RAD).normalize());
        [direction, a, b]
    };
    let all: Vec<TownRay> = rays
        .iter()
        .flat_map(|rays| {
            let t_us = t_us + (rays.after_s * 1e6).round() as i64;
            let ray = move |direction| TownRay { t_us, origin: rays.origin, direction };
            rays.directions.iter().flat_map(move |direction| three(*direction).map(ray))
        })
        .collect();
    let ranges = town.ranges_m(t_us, &all);
    let meet = |(ranges, rays): (&[Option<f64>], &[TownRay])| {
        let facing = ranges[0].map(|range_m| {
            let at = [0, 1, 2].map(|i| rays[i].direction * ranges[i].unwrap_or(range_m));
            let normal = (at[1] - at[0]).cross(at[2] - at[0]).normalize_or(rays[0].direction);
            normal.dot(rays[0].direction).abs()
        });
        (ranges[0], facing)
    };
    ranges.chunks(3).zip(all.chunks(3)).map(meet).collect()
}
