//! Parked vehicles beside the lanes.

use glam::DVec2;
use point_skeleton::geometry::{Polyline, Pose};

use super::bodies::{Bodies, PARKED};
use crate::model::{Body, BodyKind};
use crate::plan::line::polyline;
use crate::plan::random::Random;
use crate::plan::streets::CROSSING_M;
use crate::plan::{JunctionKind, Network, Side};

/// Minimum distance of parked vehicles from a junction or a crossing, meters.
const CLEAR_M: f64 = 8.5;
/// Gap between the kerb and a parked car, meters.
const KERB_GAP_M: f64 = 0.12;
/// Share of the places that are occupied.
const TAKEN: f64 = 0.72;
/// Share of parked vans that unload behind cones.
const UNLOADING: f64 = 0.3;
/// Distance from the ego's route within which vehicles are parked, meters.
const NEAR_M: f64 = 150.0;

/// Returns the bodies parked near a route and their poses, on the ground below the middle of their boxes.
pub(super) fn parked(
    network: &Network,
    bodies: &Bodies,
    drive: &[DVec2],
    random: &mut Random,
) -> Vec<(Body, Pose)> {
    let mut parked = Vec::new();
    for road in &network.roads {
        for side in Side::BOTH {
            let strip_m = road.parking_m[side as usize];
            if strip_m <= 0.0 {
                continue;
            }
            let mut kerb = road.kerb(side);
            let mut ends = road.junctions;
            // In the direction of the adjacent traffic, so the kerb is on the right.
            if side == Side::Left {
                kerb.reverse();
                ends.reverse();
            }
            let kinds = ends.map(|junction| network.junctions[junction].kind);
            fill(&polyline(&kerb), strip_m, kinds, bodies, random, &mut parked);
        }
    }
    parked.retain(|(_, pose): &(Body, Pose)| {
        drive.iter().any(|p| p.distance(pose.translation.truncate()) < NEAR_M)
    });
    parked
}

fn fill(
    kerb: &Polyline,
    strip_m: f64,
    ends: [JunctionKind; 2],
    bodies: &Bodies,
    random: &mut Random,
    parked: &mut Vec<(Body, Pose)>,
) {
    let clear_m = ends.map(|kind| CLEAR_M + if kind == JunctionKind::Free { 0.0 } else { CROSSING_M[1] });
    let end_m = kerb.length_m() - clear_m[1];
    let mut along_m = clear_m[0] + random.between(0.0, 3.0);
    loop {
        let body = bodies.any(&PARKED, random);
        let size_m = body.size_m();
        let unloads = body.kind == BodyKind::Van && random.chance(UNLOADING);
        let room_m = if unloads { 2.6 } else { 0.0 };
        if along_m + size_m.x + 2.0 * room_m > end_m {
            return;
        }
        if size_m.y + KERB_GAP_M < strip_m && random.chance(TAKEN) {
            let middle_m = along_m + room_m + size_m.x / 2.0;
            let aside_m = KERB_GAP_M + size_m.y / 2.0 + random.between(0.0, 0.08);
            let yaw_rad = random.between(-0.015, 0.015);
            parked.push((body, beside(kerb, middle_m, aside_m, size_m.x, yaw_rad)));
            if unloads {
                for (along, aside) in [(-1.0, 0.5), (-1.6, 1.2), (-1.0, 1.85), (1.1, 1.7)] {
                    let cone = bodies.of(BodyKind::Cone, random);
                    let at_m = middle_m + along + (size_m.x / 2.0_f64).copysign(along);
                    parked.push((cone, beside(kerb, at_m, aside, 0.4, random.between(-1.0, 1.0))));
                }
            }
        }
        along_m += size_m.x + 2.0 * room_m + random.between(0.7, 1.6);
    }
}

/// Returns a pose to the left of a kerb and parallel to it.
fn beside(kerb: &Polyline, along_m: f64, aside_m: f64, length_m: f64, yaw_rad: f64) -> Pose {
    let [rear, front] = [-0.4, 0.4].map(|share| kerb.at(along_m + share * length_m).0);
    let ahead = (front - rear).normalize_or(DVec2::X);
    // Leaves bulges of the kerb between its ends free.
    let inward = (kerb.at(along_m).0 - rear).dot(ahead.perp()).max(0.0);
    let centre = (rear + front) / 2.0 + ahead.perp() * (aside_m + inward);
    Pose::from_yaw(ahead.to_angle() + yaw_rad, centre.extend(0.0))
}
