//! Bodies of the town's actors: vehicles, pedestrians, cyclists and cones.
//!
//! # How it works
//! A body's properties are drawn from its seed (`dice`): first its size, then its proportions and colors.
//! Cars, vans, buses and the cabs of trucks have a hull of cross sections (`shell`) with wheels and trim;
//! people are built from rings (`figure`). The triangles are then fitted to the exact size. [`surface`]
//! samples triangles as points.

mod bus;
mod car;
mod colors;
mod cone;
mod curve;
mod cyclist;
mod dice;
mod figure;
mod kind;
mod shell;
mod surface;
mod truck;
mod walker;
mod wheel;

use std::sync::{LazyLock, PoisonError, RwLock};

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::mesh::Mesh;
use dice::Dice;
use figure::Figure;
pub use kind::BodyKind;
pub use surface::{SurfacePoint, surface};

/// Body: a kind, and a seed that determines its proportions, colors and clothes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Body {
    /// Its kind.
    pub kind: BodyKind,
    /// Seed of all other properties.
    pub seed: u64,
}

impl Body {
    /// Returns the nuScenes category name.
    pub fn category(self) -> &'static str {
        match self.kind {
            BodyKind::Sedan | BodyKind::Hatchback | BodyKind::Suv | BodyKind::Pickup | BodyKind::Van => {
                "vehicle.car"
            }
            BodyKind::Truck => "vehicle.truck",
            BodyKind::Bus => "vehicle.bus.rigid",
            BodyKind::Walker => match self.drawn() {
                BodyModel::Walker(walker) if walker.child => "human.pedestrian.child",
                _ => "human.pedestrian.adult",
            },
            BodyKind::Cyclist => "vehicle.bicycle",
            BodyKind::Cone => "movable_object.trafficcone",
        }
    }

    /// Returns length, width and height of its box, meters: the bounds of its mesh over all poses, mirrors
    /// included.
    pub fn size_m(self) -> DVec3 {
        if self.poses() == 1 {
            return self.drawn().size_m();
        }
        // Cached: it is requested often, and computing it takes all poses.
        static KNOWN: LazyLock<RwLock<FxHashMap<Body, DVec3>>> = LazyLock::new(RwLock::default);
        let known = KNOWN.read().unwrap_or_else(PoisonError::into_inner).get(&self).copied();
        known.unwrap_or_else(|| {
            let size_m = self.drawn().size_m();
            KNOWN.write().unwrap_or_else(PoisonError::into_inner).insert(self, size_m);
            size_m
        })
    }

    /// Returns the number of poses that [`Body::mesh`] has; 1 for rigid bodies.
    pub fn poses(self) -> usize {
        match self.kind {
            BodyKind::Walker => walker::POSES,
            BodyKind::Cyclist => cyclist::POSES,
            _ => 1,
        }
    }

    /// Returns the pose after a distance from standstill, meters. In pose 0 a walker's legs are side by side.
    pub fn pose_at(self, travelled_m: f64) -> usize {
        let cycle_m = match self.drawn() {
            BodyModel::Walker(walker) => walker.cycle_m(),
            BodyModel::Cyclist(_) => cyclist::CYCLE_M,
            _ => return 0,
        };
        let share = (travelled_m / cycle_m).rem_euclid(1.0);
        (share * self.poses() as f64).round() as usize % self.poses()
    }

    /// Returns its triangles in one of its poses (modulo their number). The origin is on the ground below the
    /// middle of its box; x forward, y left, z up.
    pub fn mesh(self, pose: usize) -> Mesh {
        self.drawn().mesh(pose)
    }

    fn drawn(self) -> BodyModel {
        BodyModel::new(self.kind, &mut Dice::new(self.kind, self.seed))
    }
}

/// Returns the typical body of a kind: mid-range dimensions and the first color of each palette. A walker is
/// in its widest pose, other bodies are in pose 0. Bounds (a cyclist's over all poses) are centred over the
/// origin.
pub fn typical(kind: BodyKind) -> Mesh {
    match BodyModel::new(kind, &mut Dice::Typical) {
        BodyModel::Walker(walker) => centred(&walker.figure(walker.widest()).mesh()),
        drawn => drawn.mesh(0),
    }
}

/// Returns a mesh moved so that its bounds are centred over the origin and start at the ground.
fn centred(mesh: &Mesh) -> Mesh {
    let mut mesh = mesh.clone();
    if let Some(from) = mesh.bounds() {
        mesh.fit(from, box_of(from[1] - from[0]));
    }
    mesh
}

/// Returns the box of a size, on the ground.
fn box_of(size_m: DVec3) -> [DVec3; 2] {
    let half = DVec3::new(size_m.x / 2.0, size_m.y / 2.0, 0.0);
    [-half, half + DVec3::Z * size_m.z]
}

/// Body with all its drawn properties.
enum BodyModel {
    Car(car::Car),
    Truck(truck::Truck),
    Bus(bus::Bus),
    Walker(walker::Walker),
    Cyclist(cyclist::Cyclist),
    Cone(cone::Cone),
}

impl BodyModel {
    fn new(kind: BodyKind, dice: &mut Dice) -> Self {
        match kind {
            BodyKind::Truck => Self::Truck(truck::Truck::new(dice)),
            BodyKind::Bus => Self::Bus(bus::Bus::new(dice)),
            BodyKind::Walker => Self::Walker(walker::Walker::new(dice)),
            BodyKind::Cyclist => Self::Cyclist(cyclist::Cyclist::new(dice)),
            BodyKind::Cone => Self::Cone(cone::Cone::new(dice)),
            BodyKind::Sedan | BodyKind::Hatchback | BodyKind::Suv | BodyKind::Pickup | BodyKind::Van => {
                Self::Car(car::Car::new(kind, dice))
            }
        }
    }

    fn size_m(&self) -> DVec3 {
        match self {
            Self::Car(car) => car.size_m,
            Self::Truck(truck) => truck.size_m,
            Self::Bus(bus) => bus.size_m,
            Self::Cone(cone) => cone.size_m,
            Self::Walker(walker) => extent(walker::POSES, |pose| walker.figure(pose).bounds()),
            Self::Cyclist(cyclist) => extent(cyclist::POSES, |pose| cyclist.figure(pose).bounds()),
        }
    }

    fn mesh(&self, pose: usize) -> Mesh {
        let stiff = |mut mesh: Mesh| {
            if let Some(from) = mesh.bounds() {
                mesh.fit(from, box_of(self.size_m()));
            }
            mesh
        };
        let limbed = |poses: usize, figure: &dyn Fn(usize) -> Figure| {
            let bounds = (0..poses).map(|pose| figure(pose).corner_bounds());
            let mut mesh = figure(pose).mesh();
            if let Some(from) = bounds.reduce(union) {
                mesh.fit(from, box_of(self.size_m()));
            }
            mesh
        };
        match self {
            Self::Car(car) => stiff(car.mesh()),
            Self::Truck(truck) => stiff(truck.mesh()),
            Self::Bus(bus) => stiff(bus.mesh()),
            Self::Cone(cone) => stiff(cone.mesh()),
            Self::Walker(walker) => limbed(walker::POSES, &|pose| walker.figure(pose)),
            Self::Cyclist(cyclist) => limbed(cyclist::POSES, &|pose| cyclist.figure(pose)),
        }
    }
}

fn union(a: [DVec3; 2], b: [DVec3; 2]) -> [DVec3; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Returns the size of the bounds over all poses.
fn extent(poses: usize, bounds: impl Fn(usize) -> [DVec3; 2]) -> DVec3 {
    (0..poses).map(bounds).reduce(union).map_or(DVec3::ONE, |[low, high]| high - low)
}

#[cfg(test)]
mod tests;
