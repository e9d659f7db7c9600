//! What surfaces look like: procedural colors by place, without image files.

use glam::DVec3;

use super::hash::{noise, rough, unit};

/// A surface's look at a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// Linear red, green, blue, 0–1.
    pub(super) color: DVec3,
    /// Share of mirrored sky.
    pub(super) mirror: f64,
}

/// A kind of surface. Colors are sRGB, 0–1.
#[derive(Clone, Copy, Debug)]
pub(super) enum Material {
    /// One color.
    Plain([f64; 3]),
    /// Slabs of concrete.
    Sidewalk,
    /// House front: bricks or plaster, floors of windows, a shop below.
    Facade { seed: u64, wall: [f64; 3], height: f64, length: f64, depth: f64 },
    /// Leaves.
    Foliage { seed: u64, color: [f64; 3] },
    /// Bark.
    Bark,
    /// Rubber with a hub.
    Tyre,
    /// Car paint with lamps, doors, sills and wheel arches.
    CarBody { paint: [f64; 3], half_length: f64, half_width: f64, belt: f64 },
    /// Car windows between pillars, and the roof above.
    CarCabin { paint: [f64; 3], roof: f64, pillar_x: f64 },
    /// Orange with a white collar.
    Cone,
}

/// Height of a shop floor and of the floors above, metres.
const SHOP_M: f64 = 3.8;
const FLOOR_M: f64 = 3.1;
/// Distance between windows, metres.
const BAY_M: f64 = 2.4;

/// sRGB to linear, with the square as gamma.
pub(super) fn linear(color: [f64; 3]) -> DVec3 {
    DVec3::from(color) * DVec3::from(color)
}

impl Material {
    /// The look at a point of a thing with its outward normal, both in the thing's frame.
    pub(super) fn look(&self, p: DVec3, normal: DVec3) -> Look {
        let matt = |color: [f64; 3], factor: f64| Look { color: linear(color) * factor, mirror: 0.0 };
        match *self {
            Self::Plain(color) => matt(color, 1.0),
            Self::Sidewalk => {
                let joint = [p.x, p.y].iter().any(|v| (v / 1.2).rem_euclid(1.0) < 0.025);
                let slab = unit(3, &[(p.x / 1.2).floor() as i64, (p.y / 1.2).floor() as i64]);
                let grain = 0.8 + 0.16 * rough(4, 5.0 * p.x, 5.0 * p.y) + 0.12 * slab;
                matt([0.72, 0.70, 0.66], if joint { 0.6 } else { grain })
            }
            Self::Facade { seed, wall, height, length, depth } => {
                let (u, face, extent) = if normal.y.abs() > 0.5 {
                    (p.x + length / 2.0, i64::from(normal.y > 0.0), length)
                } else {
                    (p.y + depth / 2.0, 2 + i64::from(normal.x > 0.0), depth)
                };
                if normal.z > 0.5 {
                    return matt([0.42, 0.40, 0.39], 0.8 + 0.3 * rough(seed, p.x, p.y));
                }
                Facade { seed, wall, height, face, extent }.look(u, p.z)
            }
            Self::Foliage { seed, color } => {
                let (a, b) = (p.x + 0.6 * p.y, p.z - 0.4 * p.y);
                matt(color, 0.45 + 0.75 * rough(seed, 4.5 * a, 4.5 * b))
            }
            Self::Bark => matt([0.40, 0.31, 0.25], 0.7 + 0.5 * noise(8, 20.0 * (p.x + p.y), 4.0 * p.z)),
            Self::Tyre => matt([0.13, 0.13, 0.14], 1.0),
            Self::CarBody { paint, half_length, half_width, belt } => {
                car_body(p, normal, paint, half_length, half_width, belt)
            }
            Self::CarCabin { paint, roof, pillar_x } => {
                let pillar = p.z > roof - 0.07 || (p.x - pillar_x).abs() < 0.05;
                let color = if pillar { paint } else { [0.17, 0.20, 0.23] };
                Look { color: linear(color), mirror: if pillar { 0.08 } else { 0.42 } }
            }
            Self::Cone => {
                let collar = (0.30..0.45).contains(&p.z);
                matt(if collar { [0.95, 0.95, 0.92] } else { [0.95, 0.40, 0.10] }, 1.0)
            }
        }
    }
}

/// One side of a house.
struct Facade {
    seed: u64,
    wall: [f64; 3],
    height: f64,
    face: i64,
    extent: f64,
}

impl Facade {
    /// At `u` metres along and `v` metres above the ground.
    fn look(&self, u: f64, v: f64) -> Look {
        let bays = (self.extent / BAY_M).floor().max(1.0);
        let bay_width = self.extent / bays;
        let (bay, across) = ((u / bay_width).floor(), (u / bay_width).rem_euclid(1.0) * bay_width);
        if v > self.height - 0.55 {
            return self.plaster(u, v, if v > self.height - 0.15 { 1.25 } else { 0.8 });
        }
        if v < SHOP_M {
            return self.shop(u, v, bay as i64, across - bay_width / 2.0);
        }
        let (floor, up) = (((v - SHOP_M) / FLOOR_M).floor(), (v - SHOP_M).rem_euclid(FLOOR_M));
        let (x, z) = ((across - bay_width / 2.0).abs(), up - 1.65);
        let room_above = SHOP_M + (floor + 1.0) * FLOOR_M < self.height - 0.2;
        let (inside, frame) = (x < 0.58 && z.abs() < 0.85, x < 0.70 && z.abs() < 0.97);
        if room_above && inside {
            let cross = x < 0.04 || (z - 0.25).abs() < 0.04;
            return if cross { self.trim(0.9) } else { self.window(floor as i64, bay as i64, z) };
        }
        if room_above && (frame || (x < 0.82 && (-1.07..-0.97).contains(&z))) {
            return self.trim(1.0);
        }
        let band = !(0.14..FLOOR_M).contains(&up);
        if band { self.plaster(u, v, 1.15) } else { self.bricks(u, v) }
    }

    /// A window's pane: sky, curtains, or a dark room.
    fn window(&self, floor: i64, bay: i64, z: f64) -> Look {
        let kind = unit(self.seed, &[self.face, floor, bay]);
        let curtain = kind < 0.35 && z > -0.85 + 3.0 * kind;
        let color = if curtain { [0.78, 0.74, 0.66] } else { [0.14, 0.18, 0.23] };
        Look { color: linear(color), mirror: 0.30 + 0.25 * kind }
    }

    /// The ground floor: windows between pillars, a door, and an awning or a sign above.
    fn shop(&self, u: f64, v: f64, bay: i64, x: f64) -> Look {
        let tone = |k: i64| 0.25 + 0.6 * unit(self.seed, &[77, k, self.face]);
        let sign = [tone(0), tone(1), tone(2)];
        if (2.9..3.55).contains(&v) {
            let letter = (3.1..3.36).contains(&v) && unit(self.seed, &[5, (u / 0.22).floor() as i64]) < 0.5;
            let lettered = letter && x.abs() < 0.9 && bay % 2 == 1;
            return Look { color: linear(if lettered { [0.95, 0.93, 0.85] } else { sign }), mirror: 0.0 };
        }
        let door = unit(self.seed, &[6, self.face, bay]) < 0.25;
        let pane = if door { x.abs() < 0.5 && v < 2.4 } else { x.abs() < 0.95 && (0.6..2.75).contains(&v) };
        if !pane {
            return if v < 0.5 { self.plaster(u, v, 0.55) } else { self.plaster(u, v, 0.9) };
        }
        if door {
            let board = x.abs() < 0.34 && ((0.3..1.1).contains(&v) || (1.3..2.2).contains(&v));
            return Look { color: linear(sign) * if board { 0.35 } else { 0.5 }, mirror: 0.04 };
        }
        let goods = noise(self.seed ^ 9, 2.2 * u, 2.2 * v);
        let warm = linear([0.55, 0.42, 0.28]) * (0.25 + 0.9 * goods);
        Look { color: warm, mirror: 0.22 }
    }

    fn trim(&self, factor: f64) -> Look {
        Look { color: linear([0.88, 0.86, 0.80]) * factor, mirror: 0.0 }
    }

    fn plaster(&self, u: f64, v: f64, factor: f64) -> Look {
        let stain =
            0.85 + 0.2 * rough(self.seed, 0.7 * u, 0.35 * v) + 0.08 * noise(self.seed, 9.0 * u, 9.0 * v);
        Look { color: linear(self.wall) * (stain * factor), mirror: 0.0 }
    }

    fn bricks(&self, u: f64, v: f64) -> Look {
        if self.seed.is_multiple_of(3) {
            return self.plaster(u, v, 1.0);
        }
        let row = (v / 0.16).floor();
        let shifted = u / 0.48 + 0.5 * row.rem_euclid(2.0);
        let joint = (v / 0.16).rem_euclid(1.0) < 0.14 || shifted.rem_euclid(1.0) < 0.06;
        let tone = 0.82 + 0.3 * unit(self.seed, &[1, shifted.floor() as i64, row as i64]);
        self.plaster(u, v, if joint { 0.78 } else { tone })
    }
}

/// Car paint and what is on it.
fn car_body(p: DVec3, normal: DVec3, paint: [f64; 3], half_length: f64, half_width: f64, belt: f64) -> Look {
    let plain = |color: [f64; 3], mirror: f64| Look { color: linear(color), mirror };
    let (end, side) = (half_length - p.x.abs(), p.y.abs());
    let wheel_x = half_length * 0.62;
    let arch = (p.x.abs() - wheel_x).hypot(p.z - 0.33) < 0.40 && normal.y.abs() > 0.5;
    if arch || p.z < 0.30 {
        return plain([0.10, 0.10, 0.11], 0.0);
    }
    let lamps = belt * 0.60..belt * 0.82;
    if end < 0.22 && side > half_width * 0.62 && lamps.contains(&p.z) {
        return if p.x > 0.0 { plain([0.96, 0.96, 0.90], 0.2) } else { plain([0.72, 0.06, 0.06], 0.1) };
    }
    if normal.x.abs() > 0.7 {
        if side < 0.26 && (0.45..0.57).contains(&p.z) {
            return plain([0.93, 0.93, 0.88], 0.0);
        }
        if p.x > 0.0 && side < half_width * 0.5 && (0.60..belt * 0.8).contains(&p.z) {
            return plain([0.12, 0.12, 0.13], 0.1);
        }
    }
    let door = [-0.95, 0.05, 0.95].iter().any(|x| (p.x - x).abs() < 0.012) && p.z > 0.34;
    let handle = (p.z - belt + 0.14).abs() < 0.02 && [-0.75, 0.25].iter().any(|x| (p.x - x).abs() < 0.09);
    let dark = normal.y.abs() > 0.5 && (door || handle);
    Look { color: linear(paint) * if dark { 0.3 } else { 1.0 }, mirror: 0.12 }
}
