use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::Trajectories;
use crate::dataset::TrackBox;
use crate::geometry::Pose;

/// Where a point of a sweep belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// The static background.
    Background,
    /// A track's asset, at box coordinates in metres.
    Actor {
        /// Index of the track.
        track: usize,
        /// Metres, box frame.
        local: DVec3,
    },
    /// Nowhere: in the way of a moving actor, where another LiDAR or beam saw it at another time.
    Ghost,
}

/// How sweeps are split.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitOptions {
    /// Boxes are grown by this much on every side, metres.
    pub margin_m: f64,
    /// Points up to this much above the floor of a box stay background, metres: the road under a car.
    pub ground_m: f64,
    /// An actor faster than this counts as moving, m/s.
    pub moving_m_s: f64,
    /// Time by which LiDARs may have seen a moving actor before and after the boxes' time, seconds.
    pub ghost_window_s: [f64; 2],
}

impl Default for SplitOptions {
    fn default() -> Self {
        Self { margin_m: 0.1, ground_m: 0.2, moving_m_s: 0.5, ghost_window_s: [0.2, 0.15] }
    }
}

/// Splits the points of one sweep by the boxes at its time.
pub struct Splitter {
    boxes: Vec<SplitBox>,
    ground_m: f64,
}

struct SplitBox {
    track: usize,
    box_from_global: Pose,
    half: DVec3,
    margin_m: f64,
    /// How far the actor moves within the ghost window, box frame: backward and forward in time.
    sweep_m: Option<[DVec3; 2]>,
    /// Around everything the box can claim, for a quick no.
    reach_m: f64,
    centre: DVec3,
}

impl Splitter {
    /// For a sweep taken when `boxes` were as given (`t_us` for their velocities).
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
        Self { boxes: boxes.iter().map(split_box).collect(), ground_m: options.ground_m }
    }

    /// Where a global point belongs. Of several boxes the one that it lies deepest in wins.
    pub fn part(&self, global: DVec3) -> Part {
        let mut best: Option<(f64, usize, DVec3)> = None;
        let mut ghost = false;
        for item in &self.boxes {
            if global.distance_squared(item.centre) > item.reach_m * item.reach_m {
                continue;
            }
            let local = item.box_from_global.transform_point(global);
            if local.z <= self.ground_m - item.half.z {
                continue;
            }
            if item.contains(local) {
                let depth = (local.abs() / item.half).max_element();
                if best.is_none_or(|(d, ..)| depth < d) {
                    best = Some((depth, item.track, local));
                }
            } else {
                ghost |= item.sweeps_over(local);
            }
        }
        match best {
            Some((_, track, local)) => Part::Actor { track, local },
            None if ghost => Part::Ghost,
            None => Part::Background,
        }
    }
}

impl SplitBox {
    fn contains(&self, local: DVec3) -> bool {
        local.abs().cmple(self.half + self.margin_m).all()
    }

    /// Whether the box, moved along its path within the ghost window, covers the point.
    fn sweeps_over(&self, local: DVec3) -> bool {
        let Some([before, after]) = self.sweep_m else { return false };
        // The slab test of a segment against the grown box: the point moves the other way.
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
