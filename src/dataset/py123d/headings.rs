//! Boxes that face backward: py123d turns those of some data sets by half a turn.

use crate::dataset::Frame;
use crate::dataset::recording::notes::{Notes, note};

/// Minimum distance between frames that tells a direction, meters.
const MOVED_M: f64 = 1.0;

/// Counts the tracks that move against the heading of their boxes, if most moving tracks do: single cars may
/// reverse.
pub(super) fn note_backward(frames: &[Frame], tracks: usize, notes: &mut Notes) {
    // Distance along the heading, and distance, meters.
    let mut moved = vec![[0.0, 0.0]; tracks];
    for pair in frames.windows(2) {
        for item in &pair[0].boxes {
            let Some(next) = pair[1].cuboid_of(item.track) else { continue };
            let way = next.pose.translation - item.cuboid.pose.translation;
            if way.length() < MOVED_M {
                continue;
            }
            let yaw_rad = item.cuboid.pose.yaw_rad();
            moved[item.track][0] += way.x * yaw_rad.cos() + way.y * yaw_rad.sin();
            moved[item.track][1] += way.length();
        }
    }
    let moving = moved.iter().filter(|[_, way_m]| *way_m > 0.0).count();
    let backward = moved.iter().filter(|[along_m, way_m]| *along_m < -0.8 * way_m && *way_m > 0.0).count();
    let most = if 2 * backward > moving { backward } else { 0 };
    note(notes, "tracks that move against the heading of their boxes", most);
}
