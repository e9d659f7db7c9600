//! Course along a path given in the options.

use glam::DVec2;
use point_skeleton::geometry::Polyline;

use super::course::Course;
use super::preset;
use crate::{EgoState, LocalPath};

/// Returns the course along a path for an ego at its anchor, with the speeds of presets; `None` if the ego's
/// pose is not finite.
pub(super) fn course(path: &LocalPath, start_us: i64, ego: &EgoState) -> Option<Course> {
    let forward = DVec2::from_angle(ego.heading_rad());
    let global = |[x, y]: [f64; 2]| ego.position_m() + forward * x + forward.perp() * y;
    let begin = std::iter::once([0.0; 2]).chain(path.points().iter().copied());
    let path = Polyline::new(begin.map(global))?;
    let headings_rad = Course::headings_of(&path);
    Some(Course { start_us, path, headings_rad, profile: preset::profile(ego.speed_mps) })
}
