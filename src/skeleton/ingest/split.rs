use glam::DVec3;
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};
use serde::{Deserialize, Serialize};

use crate::dataset::TrackBox;
use crate::geometry::Pose;
use crate::skeleton::Trajectories;

/// Part of the scene that a point of a sweep belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// Static background.
    Background,
    /// Asset of a track.
    Actor {
        /// Index of the track.
        track: usize,
        /// Position in the box frame, meters.
        local: DVec3,
    },
    /// Discarded point of a moving actor, measured at another time than its box.
    Ghost,
}

/// Options for separating background and actors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitOptions {
    /// Margin added to every side of a box, meters.
    pub margin_m: f64,
    /// Height above the floor of a box up to which points remain background, meters: the road under a car.
    pub ground_m: f64,
    /// Minimum speed of a moving actor, m/s.
    pub moving_m_s: f64,
    /// LiDAR whose timing the boxes of moving actors match, if several LiDARs are merged into one sweep.
    /// Points of the others on a moving actor are dropped, since they measured it elsewhere. `None` retains
    /// them.
    pub primary_lidar: Option<u16>,
    /// Maximum distance from the LiDAR along its x and its y of returns from the ego vehicle itself, meters.
    pub ego_clearance_m: f64,
    /// Time before and after the boxes' within which LiDARs may have measured a moving actor, seconds.
    pub ghost_window_s: [f64; 2],
}

impl Default for SplitOptions {
    fn default() -> Self {
        Self {
            margin_m: 0.1,
            ground_m: 0.2,
            moving_m_s: 0.5,
            primary_lidar: Some(0),
            ego_clearance_m: 1.8,
            ghost_window_s: [0.2, 0.15],
        }
    }
}

/// Separates the points of one sweep using the boxes at its time.
pub struct Splitter {
    boxes: Vec<SplitBox>,
    /// Indices of boxes, keyed by a cube around all points they can claim. An R-tree, as the number of boxes
    /// is unbounded.
    places: RTree<Place>,
    /// Boxes excluded from the tree because their coordinates are not finite or too large.
    unplaced: Vec<usize>,
    ground_m: f64,
}

/// Index of a box, with the cube around it.
type Place = GeomWithData<Rectangle<[f64; 3]>, usize>;

struct SplitBox {
    track: usize,
    box_from_global: Pose,
    half: DVec3,
    margin_m: f64,
    /// Displacement of the actor within the ghost window, box frame: backward and forward in time.
    sweep_m: Option<[DVec3; 2]>,
    /// Radius around everything that the box can claim, for early rejection.
    reach_m: f64,
    centre: DVec3,
}

impl Splitter {
    /// Creates a splitter for a sweep at time `t_us` (which sets the velocities) with the boxes at that time.
    pub fn new(boxes: &[TrackBox], trajectories: &Trajectories, t_us: i64, options: &SplitOptions) -> Self {
        let split_box = |item: &TrackBox| {
            let pose = item.cuboid.pose;
            let velocity = trajectories.velocity(item.track, t_us);
            let local_velocity = pose.rotation.inverse() * velocity;
            let [before, after] = options.ghost_window_s;
            let moving = velocity.length() > options.moving_m_s;
            let sweep_m = moving.then(|| [-local_velocity * before, local_velocity * after]);
            let half = item.cuboid.size / 2.0;
            let reach = sweep_m.map_or(0.0, |[a, b]| a.length().max(b.length()));
            SplitBox {
                track: item.track,
                box_from_global: pose.inverse(),
                half,
                margin_m: options.margin_m,
                sweep_m,
                reach_m: half.length() + 2.0 * options.margin_m + reach,
                centre: pose.translation,
            }
        };
        let boxes: Vec<SplitBox> = boxes.iter().map(split_box).collect();
        let (mut places, mut unplaced) = (Vec::new(), Vec::new());
        for (number, item) in boxes.iter().enumerate() {
            match item.enclosure() {
                Some(cube) => places.push(Place::new(cube, number)),
                None => unplaced.push(number),
            }
        }
        Self { boxes, places: RTree::bulk_load(places), unplaced, ground_m: options.ground_m }
    }

    /// Classifies a global point. Among several boxes, the one that it lies deepest in wins. `synchronized`
    /// is `true` if the point comes from the LiDAR whose timing matches the boxes of moving actors.
    pub fn part(&self, global: DVec3, synchronized: bool) -> Part {
        if !global.is_finite() {
            return self.part_among(0..self.boxes.len(), global, synchronized);
        }
        let placed = self.places.locate_all_at_point(global.to_array()).map(|place| place.data);
        self.part_among(placed.chain(self.unplaced.iter().copied()), global, synchronized)
    }

    /// Classifies a point using the boxes with some indices, in any order. Of equally deep boxes the one with
    /// the lowest index wins.
    fn part_among(&self, numbers: impl Iterator<Item = usize>, global: DVec3, synchronized: bool) -> Part {
        let mut best: Option<((f64, usize), DVec3)> = None;
        let mut ghost = false;
        for number in numbers {
            let item = &self.boxes[number];
            if global.distance_squared(item.centre) > item.reach_m * item.reach_m {
                continue;
            }
            let local = item.box_from_global.transform_point(global);
            if local.z <= self.ground_m - item.half.z {
                continue;
            }
            if item.contains(local) {
                let rank = ((local.abs() / item.half).max_element(), number);
                if best.is_none_or(|(best, _)| rank < best) {
                    best = Some((rank, local));
                }
            } else {
                ghost |= item.sweeps_over(local);
            }
        }
        match best.map(|((_, number), local)| (&self.boxes[number], local)) {
            Some((item, _)) if !synchronized && item.sweep_m.is_some() => Part::Ghost,
            Some((item, local)) => Part::Actor { track: item.track, local },
            None if ghost => Part::Ghost,
            None => Part::Background,
        }
    }
}

/// Maximum coordinates and reaches in the tree, meters: rounding there is far below [`SLACK_M`].
const MAX_PLACED_M: f64 = 1e9;
/// Margin of enclosures beyond the reach of a box, meters.
const SLACK_M: f64 = 1e-3;

impl SplitBox {
    /// Returns a cube around every point within reach; `None` if the box cannot be placed in the tree.
    fn enclosure(&self) -> Option<Rectangle<[f64; 3]>> {
        // The comparisons are written so that NaN is not placed.
        let placed = self.centre.abs().max_element() <= MAX_PLACED_M
            && self.centre.is_finite()
            && self.reach_m <= MAX_PLACED_M;
        placed.then(|| {
            let reach = DVec3::splat(self.reach_m + SLACK_M);
            let corners = [self.centre - reach, self.centre + reach].map(|corner| corner.to_array());
            Rectangle::from_aabb(AABB::from_corners(corners[0], corners[1]))
        })
    }

    fn contains(&self, local: DVec3) -> bool {
        local.abs().cmple(self.half + self.margin_m).all()
    }

    /// Returns whether the box, moved along its path within the ghost window, covers the point.
    fn sweeps_over(&self, local: DVec3) -> bool {
        let Some([before, after]) = self.sweep_m else { return false };
        // Slab test of a segment against the grown box: in the box frame the point moves in the opposite
        // direction.
        let (from, to) = (local - before, local - after);
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for axis in 0..3 {
            let half = self.half[axis] + self.margin_m;
            let (a, d) = (from[axis], to[axis] - from[axis]);
            if d.abs() < 1e-12 {
                if a.abs() > half {
                    return false;
                }
                continue;
            }
            let (t0, t1) = ((-half - a) / d, (half - a) / d);
            enter = enter.max(t0.min(t1));
            leave = leave.min(t0.max(t1));
        }
        enter <= leave
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Class;
    use crate::dataset::{Frame, Recording, Track};
    use crate::geometry::Cuboid;
    use proptest::prelude::*;

    /// Returns a splitter for boxes with the given velocities, meters per second.
    fn splitter_of(boxes: &[(Cuboid, DVec3)]) -> Splitter {
        let track =
            |i: usize| Track { id: i.to_string(), category: "car".into(), class: Class::MotorVehicle };
        let frame = |t_us: i64| {
            let moved = |(track, (cuboid, velocity)): (usize, &(Cuboid, DVec3))| {
                let mut cuboid = *cuboid;
                cuboid.pose.translation += *velocity * (t_us as f64 * 1e-6);
                TrackBox { track, cuboid }
            };
            let (sweeps, images, between_images) = Default::default();
            let boxes = boxes.iter().enumerate().map(moved).collect();
            Frame { t_us, global_from_ego: Pose::IDENTITY, sweeps, images, between_images, boxes }
        };
        let frames = vec![frame(0), frame(1_000_000)];
        let tracks = (0..boxes.len()).map(track).collect();
        let log = Recording { tracks, frames: frames.clone(), ..Recording::default() };
        let trajectories = Trajectories::new(&log, &frames.iter().collect::<Vec<_>>());
        Splitter::new(&frames[0].boxes, &trajectories, 0, &SplitOptions::default())
    }

    /// Generates boxes that often touch, enclose or equal each other, far from the origin; some are huge or
    /// excluded from the tree.
    fn any_box() -> impl Strategy<Value = (Cuboid, DVec3)> {
        let place = (0..8_i32, 0..8_i32, 0..3_i32).prop_map(|(x, y, z)| {
            DVec3::new(664_000.0 + f64::from(x) * 1.5, 3_997_000.0 + f64::from(y), f64::from(z) * 0.5)
        });
        let size = prop_oneof![
            6 => (1..5_i32, 1..3_i32, 1..3_i32).prop_map(|(x, y, z)| DVec3::new(f64::from(x), f64::from(y),
            f64::from(z))),
            1 => Just(DVec3::new(300.0, 200.0, 4.0)),
            1 => Just(DVec3::splat(4e9)),
        ];
        let speed =
            prop_oneof![2 => Just(0.0), 2 => -20.0..20.0_f64, 1 => Just(3e9), 1 => Just(f64::INFINITY)];
        let yaw = prop_oneof![Just(0.0), -3.0..3.0_f64];
        (place, size, speed, yaw).prop_map(|(place, size, speed, yaw)| {
            let velocity = if speed == 0.0 { DVec3::ZERO } else { DVec3::new(speed, speed * 0.5, 0.0) };
            (Cuboid { pose: Pose::from_yaw(yaw, place), size }, velocity)
        })
    }

    proptest! {
        /// The tree gives the same result as a scan of all boxes, in any order.
        #[test]
        fn tree_search_matches_a_scan_of_all_boxes(
            boxes in prop::collection::vec(any_box(), 0..40),
            offsets in prop::collection::vec(prop::array::uniform3(-3.0..14.0_f64), 1..60),
            snapped: bool,
            synchronized: bool,
        ) {
            let splitter = splitter_of(&boxes);
            for offset in offsets {
                let offset = DVec3::from(offset);
                // Snapped points lie equally deep in several boxes, or on their sides.
                let offset = if snapped { (offset * 2.0).round() / 2.0 } else { offset };
                let global = DVec3::new(664_000.0, 3_997_000.0, -1.0) + offset;
                let all = 0..boxes.len();
                let expected = splitter.part_among(all.clone(), global, synchronized);
                prop_assert_eq!(splitter.part_among(all.rev(), global, synchronized), expected);
                prop_assert_eq!(splitter.part(global, synchronized), expected, "{}", global);
            }
        }
    }

    #[test]
    fn first_of_equal_boxes_wins() {
        let cuboid = Cuboid::new(Pose::from_yaw(0.0, DVec3::ZERO), DVec3::splat(2.0)).unwrap();
        let splitter = splitter_of(&[(cuboid, DVec3::ZERO); 20]);
        let part = splitter.part(DVec3::splat(0.25), true);
        assert_eq!(part, Part::Actor { track: 0, local: DVec3::splat(0.25) });
    }

    #[test]
    fn non_finite_points_and_boxes_match_a_scan_of_all_boxes() {
        let cuboid = Cuboid::new(Pose::from_yaw(0.0, DVec3::ZERO), DVec3::splat(2.0)).unwrap();
        let nowhere = Cuboid { pose: Pose::from_yaw(0.0, DVec3::NAN), size: DVec3::splat(2.0) };
        let splitter = splitter_of(&[(nowhere, DVec3::ZERO), (cuboid, DVec3::X)]);
        for global in [DVec3::ZERO, DVec3::NAN, DVec3::INFINITY, DVec3::new(0.0, f64::NAN, 0.5)] {
            let expected = splitter.part_among(0..2, global, true);
            assert_eq!(format!("{:?}", splitter.part(global, true)), format!("{expected:?}"));
        }
    }

    /// Returns the splitter at t = 0 for a car of 4 x 2 x 1.5 m at the origin that drives along x at `speed`.
    fn splitter(speed: f64) -> Splitter {
        let track = Track { id: "a".into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        let frame = |t_us: i64| {
            let pose = Pose::from_yaw(0.0, DVec3::new(speed * t_us as f64 * 1e-6, 0.0, 0.75));
            let cuboid = Cuboid::new(pose, DVec3::new(4.0, 2.0, 1.5)).unwrap();
            let (sweeps, images, between_images) = Default::default();
            let boxes = vec![TrackBox { track: 0, cuboid }];
            Frame { t_us, global_from_ego: Pose::IDENTITY, sweeps, images, between_images, boxes }
        };
        let frames = vec![frame(0), frame(1_000_000)];
        let log = Recording { tracks: vec![track], frames: frames.clone(), ..Recording::default() };
        let trajectories = Trajectories::new(&log, &frames.iter().collect::<Vec<_>>());
        Splitter::new(&frames[0].boxes, &trajectories, 0, &SplitOptions::default())
    }

    #[test]
    fn the_road_under_a_car_stays() {
        let splitter = splitter(0.0);
        let part = |x, y, z| splitter.part(DVec3::new(x, y, z), true);
        assert_eq!(part(0.0, 0.0, 0.19), Part::Background);
        assert_eq!(part(0.0, 0.0, 0.21), Part::Actor { track: 0, local: DVec3::new(0.0, 0.0, 0.21 - 0.75) });
        assert!(matches!(part(2.09, -1.09, 1.59), Part::Actor { .. }));
        assert_eq!(part(2.11, 0.0, 1.0), Part::Background);
        assert_eq!(part(0.0, 0.0, 1.61), Part::Background);
    }

    #[test]
    fn points_swept_by_a_moving_car_are_not_background() {
        let (parked, moving) = (splitter(0.0), splitter(10.0));
        let ahead = DVec3::new(2.1 + 10.0 * 0.15 - 0.01, 0.0, 1.0);
        let behind = DVec3::new(-2.1 - 10.0 * 0.2 + 0.01, 1.0, 0.3);
        for point in [ahead, behind] {
            assert_eq!(parked.part(point, true), Part::Background);
            assert_eq!(moving.part(point, true), Part::Ghost);
        }
        assert_eq!(moving.part(ahead + DVec3::X * 0.02, true), Part::Background);
        assert_eq!(moving.part(behind - DVec3::X * 0.02, true), Part::Background);
        assert_eq!(moving.part(behind.with_z(0.1), true), Part::Background);
    }

    #[test]
    fn a_second_lidar_counts_only_for_parked_cars() {
        let inside = DVec3::new(0.0, 0.0, 1.0);
        assert!(matches!(splitter(0.0).part(inside, false), Part::Actor { .. }));
        assert_eq!(splitter(10.0).part(inside, false), Part::Ghost);
    }
}
