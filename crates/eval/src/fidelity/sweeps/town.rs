//! Sweeps of a town at moved poses against beams that are cast through the town itself.

use point_skeleton::Renderer;
use point_skeleton::dataset::{EgoTrack, LogReader};
use point_skeleton::lidar::{LidarDevice, LidarRays, LidarSpec, Motion, RangeImage};
use point_skeleton::scene::EgoOffset;
use pskel_town::{Town, TownHit, TownRay};

use super::compare::{Ray, Sums, SweepRow};
use super::states;
use crate::fidelity::{FidelityError, FidelityFrames};

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
    let mut spec = spec.clone();
    spec.devices.iter_mut().for_each(|device| device.dropout = 0.0); // of the town's beams, none is lost
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
            let sweep = renderer.lidar(&spec, &motion)?;
            for (device, image) in spec.devices.iter().zip(&sweep.devices) {
                sums.add(&compared(town, device, image, &motion));
            }
            on_step(&format!("{name}, frame {frame:06}"));
        }
        rows.push(sums.row(name.to_owned()));
    }
    Ok(rows)
}

/// Returns the rays of a device with what they meet in skeleton and town.
fn compared(town: &Town, device: &LidarDevice, image: &RangeImage, motion: &Motion<'_>) -> Vec<Ray> {
    let [near_m, far_m] = device.range_m;
    let columns = (0..image.columns).flat_map(|column| (0..image.beams).map(move |beam| (beam, column)));
    let found = columns.map(|(beam, column)| image.range_m[beam * image.columns + column]);
    let found = found.map(|range_m| (range_m > 0.0).then_some(f64::from(range_m)));
    let t_us = motion.state().t_us;
    let rays = device.sweep_rays(motion);
    let rays: Vec<TownRay> = rays.iter().flat_map(|rays| town_rays(t_us, rays)).collect();
    let truth = town.hits(t_us, &rays);
    let compare = |((ray, found_m), truth): ((&TownRay, Option<f64>), Option<TownHit>)| {
        let truth = truth.filter(|hit| (near_m..=far_m).contains(&hit.range_m));
        Ray {
            origin: ray.origin,
            direction: ray.direction,
            found_m,
            true_m: truth.map(|hit| hit.range_m),
            facing: truth.filter(|hit| !hit.is_glass).map(|hit| hit.facing),
        }
    };
    rays.iter().zip(found).zip(truth).map(compare).collect()
}

/// Iterates over rays of an instant.
fn town_rays(t_us: i64, rays: &LidarRays) -> impl Iterator<Item = TownRay> {
    let t_us = t_us + (rays.after_s * 1e6).round() as i64;
    rays.directions.iter().map(move |direction| TownRay { t_us, origin: rays.origin, direction: *direction })
}
