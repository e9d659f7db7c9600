//! Arc-line paths: the centerline format of the map expansion.
//!
//! A path consists of an arc, a line or another arc, and a final arc, as in Dubins paths. `L` turns left on a
//! circle of the path's radius, `R` turns right, `S` goes straight. A lane is a sequence of connected paths.

use glam::DVec2;
use serde::de::{Deserialize, Deserializer};

use crate::dataset::lenient::{Coordinate, or_default};

/// Maximum spacing of centerline points, meters.
const STEP_M: f64 = 0.5;

/// Maximum segment length, meters, which limits the cost of a damaged length.
const MAX_PATH_M: f64 = 1000.0;

/// Points closer than this are merged, meters: consecutive paths of a lane share a point.
const SAME_M: f64 = 1e-3;

/// Tolerance of a written path around the points of its line, meters.
const FIT_M: f64 = 2e-3;

/// Path as stored in the file.
#[derive(Clone, Debug, serde::Deserialize, serde::Serialize)]
pub(in super::super) struct ArclinePath {
    /// x and y (global meters) and yaw (radians).
    #[serde(deserialize_with = "three", default = "unknown")]
    start_pose: [f64; 3],
    /// Letters `L`, `S`, `R`.
    #[serde(deserialize_with = "or_default", default)]
    shape: String,
    /// Meters.
    #[serde(deserialize_with = "one", default)]
    radius: f64,
    /// Meters.
    #[serde(deserialize_with = "three", default = "unknown")]
    segment_length: [f64; 3],
}

/// Numbers of a missing field.
fn unknown() -> [f64; 3] {
    [f64::NAN; 3]
}

fn one<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Coordinate::deserialize(from).map(|number| number.0)
}

/// Reads three numbers; they are NaN in a damaged record.
fn three<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 3], D::Error> {
    let numbers: Vec<f64> = or_default(from).map(|all: Vec<Coordinate>| all.iter().map(|n| n.0).collect())?;
    Ok(numbers.try_into().unwrap_or_else(|_| unknown()))
}

/// Segment of constant curvature.
#[derive(Clone, Copy)]
struct Segment {
    length_m: f64,
    /// 1/m, positive to the left.
    curvature: f64,
}

impl ArclinePath {
    /// Returns the three segments.
    ///
    /// # Errors
    /// Returns a description of the problem if the shape has other letters, or a radius or length is invalid.
    fn segments(&self) -> Result<[Segment; 3], String> {
        if let Some(length) = self.segment_length.iter().find(|l| !(0.0..=MAX_PATH_M).contains(*l)) {
            return Err(format!("a segment length of {length} m"));
        }
        if !(self.radius > 0.0 && self.radius.is_finite()) {
            return Err(format!("a radius of {} m", self.radius));
        }
        let sign = |letter: u8| match letter {
            b'L' => Some(1.0),
            b'S' => Some(0.0),
            b'R' => Some(-1.0),
            _ => None,
        };
        let signs: Option<Vec<f64>> = self.shape.bytes().map(sign).collect();
        let signs = signs.and_then(|signs| <[f64; 3]>::try_from(signs).ok());
        let signs = signs.ok_or_else(|| format!("a shape of {:?}", self.shape))?;
        Ok(std::array::from_fn(|i| Segment {
            length_m: self.segment_length[i],
            curvature: signs[i] / self.radius,
        }))
    }
}

/// Approximates a line by straight paths, each as long as possible within [`FIT_M`] of the line's points.
/// Empty for fewer than two points.
pub(in super::super) fn straight_paths(line: &[DVec2]) -> Vec<ArclinePath> {
    let mut paths = Vec::new();
    let mut first = 0;
    while first + 1 < line.len() {
        let longer = (first + 2..line.len()).take_while(|last| is_straight(&line[first..=*last]));
        let last = longer.last().unwrap_or(first + 1);
        let along = line[last] - line[first];
        let length_m = along.length();
        if length_m > 0.0 {
            let start_pose = [line[first].x, line[first].y, along.to_angle()];
            // Values of straight lanes in nuScenes' own maps.
            let (shape, radius) = ("LSR".to_owned(), 999.999);
            paths.push(ArclinePath { start_pose, shape, radius, segment_length: [0.0, length_m, 0.0] });
        }
        first = last;
    }
    paths
}

/// Returns whether points lie in order along the line from the first to the last, and the path length is
/// valid.
fn is_straight(points: &[DVec2]) -> bool {
    let [first, .., last] = points else { return true };
    let along = (*last - *first).normalize_or_zero();
    let near = |p: &DVec2| along.perp_dot(*p - *first).abs() < FIT_M;
    let onward = |w: &[DVec2]| (w[1] - w[0]).dot(along) >= 0.0;
    first.distance(*last) < MAX_PATH_M && points.iter().all(near) && points.windows(2).all(onward)
}

/// Samples the paths of a lane, evenly on each path and at most [`STEP_M`] apart. Subtracts the path lengths
/// from `left_m`, the remaining budget of the whole map.
///
/// # Errors
/// Returns a description of the problem if a path is invalid or the budget is exceeded.
pub(in super::super) fn centerline(paths: &[ArclinePath], left_m: &mut f64) -> Result<Vec<DVec2>, String> {
    let mut line: Vec<DVec2> = Vec::new();
    for path in paths {
        let segments = path.segments()?;
        let length_m: f64 = segments.iter().map(|s| s.length_m).sum();
        *left_m -= length_m;
        if *left_m < 0.0 {
            return Err("more meters of lanes than a file of this size has".to_owned());
        }
        let steps = (length_m / STEP_M).ceil().max(1.0) as u32;
        for step in 0..=steps {
            let at = point_at(path.start_pose, &segments, length_m * f64::from(step) / f64::from(steps));
            if !at.is_finite() {
                return Err("a point that is not finite".to_owned());
            }
            if line.last().is_none_or(|last| last.distance(at) > SAME_M) {
                line.push(at);
            }
        }
    }
    Ok(line)
}

/// Returns the point at an arc length along a path, meters.
fn point_at([x, y, yaw]: [f64; 3], segments: &[Segment; 3], along_m: f64) -> DVec2 {
    let (mut at, mut yaw, mut left_m) = (DVec2::new(x, y), yaw, along_m);
    for segment in segments {
        let s = left_m.min(segment.length_m);
        let turned = yaw + segment.curvature * s;
        at += if segment.curvature == 0.0 {
            DVec2::from_angle(yaw) * s
        } else {
            // Along the circle centered to the left (positive curvature) or right.
            DVec2::new(turned.sin() - yaw.sin(), yaw.cos() - turned.cos()) / segment.curvature
        };
        (yaw, left_m) = (turned, left_m - s);
    }
    at
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn path(start_pose: [f64; 3], shape: &str, radius: f64, segment_length: [f64; 3]) -> ArclinePath {
        ArclinePath { start_pose, shape: shape.to_owned(), radius, segment_length }
    }

    fn whole(paths: &[ArclinePath]) -> Result<Vec<DVec2>, String> {
        let mut left_m = 1e4;
        centerline(paths, &mut left_m)
    }

    /// A quarter turn left about (0, 10), 5 m straight in +y, a quarter turn right about (20, 15).
    #[test]
    fn arcs_and_lines_end_at_the_expected_points() {
        let quarter = 10.0 * PI / 2.0;
        let line = whole(&[path([0.0, 0.0, 0.0], "LSR", 10.0, [quarter, 5.0, quarter])]).unwrap();
        assert!(line[0] == DVec2::ZERO && line.last().unwrap().distance(DVec2::new(20.0, 25.0)) < 1e-12);
        for point in &line {
            let on_first = (point.distance(DVec2::new(0.0, 10.0)) - 10.0).abs() < 1e-12 && point.y <= 10.0;
            let on_line = (point.x - 10.0).abs() < 1e-12;
            let on_last = (point.distance(DVec2::new(20.0, 15.0)) - 10.0).abs() < 1e-12;
            assert!(on_first || on_line || on_last, "{point}");
        }
        assert!(line.windows(2).all(|w| w[0].distance(w[1]) <= STEP_M));
        assert_eq!(line.len(), 2 + (2.0 * quarter + 5.0) as usize * 2);
    }

    #[test]
    fn lines_become_the_fewest_straight_paths() {
        let line: Vec<DVec2> = (0..50).map(|i| DVec2::new(f64::from(i), 0.5)).collect();
        let bent: Vec<DVec2> =
            line.iter().copied().chain((1..5).map(|i| DVec2::new(49.0, 0.5 + f64::from(i)))).collect();
        let paths = straight_paths(&bent);
        assert_eq!(paths.len(), 2);
        assert_eq!((paths[0].start_pose, paths[0].segment_length), ([0.0, 0.5, 0.0], [0.0, 49.0, 0.0]));
        assert_eq!((paths[1].start_pose, paths[1].segment_length), ([49.0, 0.5, PI / 2.0], [0.0, 4.0, 0.0]));
        assert!(straight_paths(&bent[..1]).is_empty() && straight_paths(&[DVec2::X; 3]).is_empty());
        // A line that reverses is not one straight path.
        assert_eq!(straight_paths(&[DVec2::ZERO, DVec2::X * 4.0, DVec2::X]).len(), 2);
        assert_eq!(whole(&straight_paths(&line)).unwrap().len(), 99);
    }

    /// Consecutive paths share a point, which appears once.
    #[test]
    fn paths_of_a_lane_are_joined() {
        let straight = |x: f64| path([x, 1.0, 0.0], "LSL", 999.999, [0.0, 2.0, 0.0]);
        let line = whole(&[straight(0.0), straight(2.0)]).unwrap();
        assert_eq!(line.len(), 9);
        assert!(line.windows(2).all(|w| (w[1] - w[0]).distance(DVec2::new(0.5, 0.0)) < 1e-12));
    }

    #[test]
    fn invalid_paths_are_errors() {
        let wrong = |shape, radius, length| whole(&[path([0.0; 3], shape, radius, length)]).unwrap_err();
        assert_eq!(wrong("LXR", 1.0, [1.0; 3]), "a shape of \"LXR\"");
        assert_eq!(wrong("LSRL", 1.0, [1.0; 3]), "a shape of \"LSRL\"");
        assert_eq!(wrong("LSR", 0.0, [1.0; 3]), "a radius of 0 m");
        assert_eq!(wrong("LSR", 1.0, [1.0, -1.0, 0.0]), "a segment length of -1 m");
        assert_eq!(wrong("LSR", 1.0, [1.0, 1e9, 0.0]), "a segment length of 1000000000 m");
        assert_eq!(wrong("LSR", 1e-320, [1.0; 3]), "a point that is not finite");
        let many = vec![path([0.0; 3], "SSS", 1.0, [1000.0; 3]); 4];
        assert!(whole(&many).unwrap_err().starts_with("more meters of lanes"));
    }
}
