//! Cars, people, trees: parts around an origin on the ground, x forward, y left, z up, metres.

use glam::DVec3;

use super::material::Material;
use super::shape::Shape;
use super::world::Part;

/// Shape of a car by its roof.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum CarKind {
    Sedan,
    Suv,
    Van,
}

impl CarKind {
    /// Length, width, height.
    pub(super) fn size(self) -> DVec3 {
        match self {
            Self::Sedan => DVec3::new(4.6, 1.84, 1.46),
            Self::Suv => DVec3::new(4.7, 1.92, 1.88),
            Self::Van => DVec3::new(5.3, 2.02, 2.25),
        }
    }

    /// Height of the belt line, and the cabin's profile at belt and roof as shares of the half length: rear
    /// belt, rear roof, front roof, front belt.
    fn cabin(self) -> (f64, [f64; 4]) {
        match self {
            Self::Sedan => (0.92, [-0.86, -0.50, 0.12, 0.50]),
            Self::Suv => (1.08, [-0.97, -0.86, 0.16, 0.52]),
            Self::Van => (1.22, [-0.99, -0.96, 0.46, 0.80]),
        }
    }
}

/// A car.
pub(super) fn car(kind: CarKind, paint: [f64; 3]) -> Vec<Part> {
    let size = kind.size();
    let (half_length, half_width) = (size.x / 2.0, size.y / 2.0);
    let (belt, cabin) = kind.cabin();
    let [rear, rear_roof, front_roof, front] = cabin.map(|share| share * half_length);
    let hull = [
        [-half_length, belt - 0.10],
        [-half_length, 0.42],
        [-half_length + 0.14, 0.22],
        [half_length - 0.14, 0.22],
        [half_length, 0.42],
        [half_length, belt - 0.26],
        [half_length - 0.16, belt - 0.14],
        [front, belt],
        [-half_length + 0.10, belt],
    ];
    let greenhouse = [[rear_roof, size.z], [rear, belt], [front, belt], [front_roof, size.z]];
    let body = Material::CarBody { paint, half_length, half_width, belt };
    let glass = Material::CarCabin { paint, roof: size.z, pillar_x: (rear_roof + front_roof) / 2.0 };
    let mut parts = vec![
        Part { shape: Shape::profile(&hull, half_width, 0.22, 0.02), material: body },
        Part { shape: Shape::profile(&greenhouse, half_width - 0.06, belt, 0.22), material: glass },
    ];
    for (x, side) in [(-0.62, 1.0), (-0.62, -1.0), (0.62, 1.0), (0.62, -1.0)] {
        let hub = DVec3::new(x * half_length, side * (half_width - 0.20), 0.33);
        let disc = |radius: f64, out: f64, material: Material| {
            let to = hub + DVec3::Y * side * out;
            Part { shape: Shape::Cylinder { from: hub, to, radius }, material }
        };
        parts.push(disc(0.33, 0.185, Material::Tyre));
        parts.push(disc(0.21, 0.195, Material::Plain([0.62, 0.63, 0.65])));
    }
    parts
}

/// A limb from joint to joint.
fn limb(from: [f64; 3], to: [f64; 3], radius: f64, color: [f64; 3]) -> Part {
    let shape = Shape::Cylinder { from: from.into(), to: to.into(), radius };
    Part { shape, material: Material::Plain(color) }
}

fn ball(center: [f64; 3], radii: [f64; 3], color: [f64; 3]) -> Part {
    let shape = Shape::Ellipsoid { center: center.into(), radii: radii.into() };
    Part { shape, material: Material::Plain(color) }
}

const SKIN: [f64; 3] = [0.82, 0.62, 0.50];
const HAIR: [f64; 3] = [0.22, 0.16, 0.12];

/// Size of a walker's box, whatever the step.
pub(super) const WALKER_SIZE: DVec3 = DVec3::new(0.80, 0.66, 1.76);

/// A person walking; `phase` in radians is the place in the step.
pub(super) fn walker(phase: f64, coat: [f64; 3], trousers: [f64; 3]) -> Vec<Part> {
    let swing = 0.26 * phase.sin();
    let mut parts = vec![
        ball([0.0, 0.0, 1.16], [0.15, 0.22, 0.34], coat),
        ball([0.0, 0.0, 0.90], [0.14, 0.18, 0.16], trousers),
        ball([0.01, 0.0, 1.61], [0.11, 0.095, 0.135], SKIN),
        ball([-0.025, 0.0, 1.65], [0.105, 0.10, 0.11], HAIR),
    ];
    for side in [1.0, -1.0] {
        let (foot, hand) = (side * swing, -side * swing * 0.9);
        let lift = 0.05 * (side * phase.cos()).max(0.0);
        parts.push(limb([0.0, 0.09 * side, 0.88], [foot, 0.09 * side, 0.07 + lift], 0.075, trousers));
        parts.push(ball([foot + 0.05, 0.09 * side, 0.05 + lift], [0.13, 0.05, 0.05], [0.15, 0.12, 0.10]));
        parts.push(limb([0.0, 0.21 * side, 1.40], [hand, 0.25 * side, 0.86], 0.05, coat));
        parts.push(ball([hand, 0.25 * side, 0.83], [0.05, 0.04, 0.07], SKIN));
    }
    parts
}

/// Size of a cyclist's box.
pub(super) const CYCLIST_SIZE: DVec3 = DVec3::new(1.80, 0.62, 1.74);

/// A bicycle with its rider; `phase` in radians turns the pedals.
pub(super) fn cyclist(phase: f64, jersey: [f64; 3]) -> Vec<Part> {
    let (frame, black) = ([0.15, 0.35, 0.60], [0.12, 0.12, 0.13]);
    let mut parts = vec![
        limb([-0.50, 0.0, 0.34], [-0.18, 0.0, 0.88], 0.025, frame),
        limb([-0.18, 0.0, 0.84], [0.38, 0.0, 0.86], 0.025, frame),
        limb([-0.02, 0.0, 0.34], [0.38, 0.0, 0.84], 0.025, frame),
        limb([0.38, 0.0, 0.95], [0.53, 0.0, 0.34], 0.025, frame),
        limb([0.40, -0.24, 0.98], [0.40, 0.24, 0.98], 0.02, black),
        ball([-0.22, 0.0, 0.93], [0.14, 0.09, 0.05], black),
        limb([-0.18, 0.0, 1.00], [0.14, 0.0, 1.42], 0.155, jersey),
        ball([0.22, 0.0, 1.58], [0.12, 0.09, 0.13], SKIN),
        ball([0.20, 0.0, 1.63], [0.15, 0.10, 0.10], [0.92, 0.92, 0.90]),
    ];
    for x in [-0.53, 0.53] {
        let wheel = |y: f64, radius: f64, color| limb([x, -y, 0.35], [x, y, 0.35], radius, color);
        parts.push(wheel(0.018, 0.345, black));
        parts.push(wheel(0.022, 0.29, [0.70, 0.71, 0.72]));
    }
    for side in [1.0, -1.0] {
        let (s, c) = phase.sin_cos();
        let foot = [0.04 + 0.17 * side * c, 0.11 * side, 0.36 + 0.17 * side * s];
        let knee = [0.22 + 0.06 * side * c, 0.11 * side, 0.78 + 0.09 * side * s];
        parts.push(limb([-0.16, 0.10 * side, 0.98], knee, 0.08, [0.14, 0.15, 0.20]));
        parts.push(limb(knee, foot, 0.06, SKIN));
        parts.push(limb([0.16, 0.18 * side, 1.40], [0.40, 0.22 * side, 1.01], 0.05, jersey));
    }
    parts
}

/// A tree; `seed` varies the crown.
pub(super) fn tree(seed: u64, height: f64) -> Vec<Part> {
    use super::hash::between;
    let trunk = Shape::Cylinder { from: DVec3::ZERO, to: DVec3::Z * height * 0.55, radius: 0.14 };
    let mut parts = vec![Part { shape: trunk, material: Material::Bark }];
    for i in 0..6 {
        let at = |k: i64, low: f64, high: f64| between(seed, &[i, k], low, high);
        let center = DVec3::new(at(0, -0.9, 0.9), at(1, -0.9, 0.9), height * at(2, 0.55, 0.85));
        let radii = DVec3::new(at(3, 0.8, 1.3), at(4, 0.8, 1.3), at(5, 0.7, 1.1));
        let color = [at(6, 0.30, 0.42), at(7, 0.50, 0.60), at(8, 0.20, 0.28)];
        let material = Material::Foliage { seed: seed.wrapping_add(i as u64), color };
        parts.push(Part { shape: Shape::Ellipsoid { center, radii }, material });
    }
    parts
}

/// A street lamp whose arm reaches to +y.
pub(super) fn lamp() -> Vec<Part> {
    let grey = [0.36, 0.38, 0.40];
    vec![
        limb([0.0, 0.0, 0.0], [0.0, 0.0, 6.4], 0.08, grey),
        limb([0.0, 0.0, 0.0], [0.0, 0.0, 0.9], 0.14, grey),
        limb([0.0, 0.0, 6.3], [0.0, 1.7, 6.6], 0.05, grey),
        ball([0.0, 1.8, 6.58], [0.18, 0.38, 0.10], [0.88, 0.88, 0.82]),
    ]
}

/// A traffic cone.
pub(super) fn cone() -> Vec<Part> {
    let outline = [[-0.04, 0.72], [-0.17, 0.04], [0.17, 0.04], [0.04, 0.72]];
    let shape = Shape::profile(&outline, 0.17, 0.04, 0.19);
    let base = Shape::block(DVec3::new(-0.21, -0.21, 0.0), DVec3::new(0.21, 0.21, 0.05));
    vec![
        Part { shape, material: Material::Cone },
        Part { shape: base, material: Material::Plain([0.9, 0.36, 0.1]) },
    ]
}
