//! Rigid trucks: a cab on a frame with a box, a flat bed or a tank.

use glam::DVec3;

use super::colors::{self, BLINKER, CHROME, DARK, GLASS, HEAD_LAMP, PLATE, RIM, TAIL_LAMP, TRIM};
use super::curve::{Corner, Curve};
use super::dice::Dice;
use super::shell::{Arch, End, Shell, row};
use super::wheel::{self, Wheel};
use crate::mesh::{Mesh, Ring, Skin, Surface};

/// Kind of load.
#[derive(Clone, Copy, Debug)]
enum Load {
    Box,
    /// Open bed with crates.
    Flat,
    Tank,
}

/// Truck with its dimensions, meters.
#[derive(Clone, Debug)]
pub(super) struct Truck {
    pub(super) size_m: DVec3,
    cab: Shell,
    load: Load,
    paint: Skin,
    goods: Skin,
    stripe: Option<Skin>,
    axles: Vec<f64>,
    /// Radius and width of tyres.
    wheel: [f64; 2],
    /// Height of the frame.
    frame: f64,
    /// Front end of the load.
    front: f64,
}

impl Truck {
    pub(super) fn new(dice: &mut Dice) -> Self {
        let load = dice.pick(&[Load::Box, Load::Box, Load::Box, Load::Flat, Load::Tank]);
        let length = dice.between([6.4, 9.6]);
        let width = dice.between([2.38, 2.55]);
        let cab_height = dice.between([2.45, 2.85]);
        let height = match load {
            Load::Box => dice.between([3.1, 3.75]),
            _ => cab_height + dice.between([0.1, 0.3]),
        };
        let size_m = DVec3::new(length, width + 0.30, height);
        let half = length / 2.0;
        let cab_length = dice.between([1.75, 2.3]);
        let belt = cab_height * dice.between([0.50, 0.55]);
        let bow = dice.between([0.05, 0.12]);
        let end = |x: f64, bow: f64, taper: f64| End { x, bow, taper, taper_m: 0.5, lift: 0.04, belt };
        let corner = |x: f64, z: f64, round: f64| Corner { x, z, round };
        let rear = half - cab_length;
        let rake = dice.between([0.18, 0.42]);
        let top = [
            corner(rear, cab_height, 0.0),
            corner(half - rake - 0.15, cab_height, 0.25),
            corner(half - 0.1, cab_height - rake - 0.05, 0.1),
            corner(half, cab_height - rake - 0.2, 0.0),
        ];
        let wheel = [dice.between([0.44, 0.52]), 0.30];
        let axle = half - dice.between([1.15, 1.35]);
        let cab = Shell {
            rear: end(rear, 0.0, 0.0),
            front: end(half - bow, bow, 0.05),
            half_width: width / 2.0 - 0.04,
            top: Curve::new(&top),
            under: 0.42,
            tumble: 0.07,
            flare: 0.02,
            arches: vec![Arch { x: axle, z: wheel[0], radius: wheel[0] + 0.08 }],
            bed: None,
        };
        let rear_axle = -half + length * dice.between([0.20, 0.26]);
        let mut axles = vec![rear_axle];
        if length > 8.4 {
            axles.push(rear_axle + 2.0 * wheel[0] + 0.25);
        }
        let paint = colors::fleet_paint(dice);
        let goods = match load {
            Load::Box => Skin { surface: Surface::Metal, ..colors::fleet_paint(dice) },
            Load::Flat => colors::shaded([128, 98, 66], dice, Surface::Wood),
            Load::Tank => CHROME,
        };
        let stripe = dice.chance(0.6).then(|| colors::fleet_paint(dice));
        let front = rear - dice.between([0.12, 0.25]);
        Self { size_m, cab, load, paint, goods, stripe, axles, wheel, frame: 2.0 * wheel[0] + 0.06, front }
    }

    pub(super) fn mesh(&self) -> Mesh {
        let mut mesh = self.cab();
        let axles = self.axles.iter();
        for x in axles {
            let hub = DVec3::new(*x, self.cab.half_width - 0.03, self.wheel[0]);
            let [radius, width] = [self.wheel[0], 2.0 * self.wheel[1]];
            Wheel { hub, radius, width, side: 1.0, rim: RIM, spokes: 5 }.add(&mut mesh);
        }
        let half = self.size_m.x / 2.0;
        let beam = [DVec3::new(-half + 0.06, 0.32, 0.6), DVec3::new(self.cab.front.x - 0.4, 0.44, 0.84)];
        mesh.block(beam[0], beam[1], DARK);
        let lamp = DVec3::new(-half + 0.05, 0.85 * self.cab.half_width, 0.72);
        mesh.block(lamp - DVec3::new(0.04, 0.2, 0.06), lamp + DVec3::new(0.04, 0.2, 0.06), TAIL_LAMP);
        // Side guards between the axles.
        let first = self.axles.iter().copied().fold(-half, f64::max) + self.wheel[0] + 0.15;
        let last = self.cab.rear.x - 0.1;
        if last > first + 0.3 {
            let y = self.cab.half_width;
            mesh.chamfered(DVec3::new(first, y - 0.3, 0.42), DVec3::new(last, y - 0.03, 0.86), 0.02, TRIM);
        }
        mesh.mirror_y();
        let axle = |x: &f64| [DVec3::new(x - 0.08, -0.8, 0.35), DVec3::new(x + 0.08, 0.8, 0.55)];
        self.axles.iter().map(axle).for_each(|[min, max]| mesh.block(min, max, DARK));
        let bumper = [DVec3::new(-half + 0.01, -0.85, 0.45), DVec3::new(-half + 0.1, 0.85, 0.60)];
        mesh.block(bumper[0], bumper[1], TRIM);
        let plate = DVec3::new(-half + 0.01, 0.0, 0.72);
        mesh.block(plate - DVec3::new(0.01, 0.26, 0.055), plate + DVec3::new(0.06, 0.26, 0.055), PLATE);
        match self.load {
            Load::Box => self.cargo_box(&mut mesh),
            Load::Flat => self.flat_bed(&mut mesh),
            Load::Tank => self.tank(&mut mesh),
        }
        mesh.smooth(0.7);
        mesh
    }

    /// Returns the left half of the cab.
    fn cab(&self) -> Mesh {
        let cab = &self.cab;
        let (pane_rear, pane_front) = (cab.rear.x + 0.45, cab.front.x - 0.16);
        let door = cab.rear.x + 0.38;
        let mut mesh = cab.hull(&cab.stations(&[pane_rear, pane_front]), |x, row| match row {
            0 | 1 => DARK,
            2 => TRIM,
            row::GLASS_LOW if (pane_rear..pane_front).contains(&x) => GLASS,
            _ => self.paint,
        });
        mesh.append(&cab.cap(true, |row, c| match row {
            1 => DARK,
            2 if c > 0.62 => HEAD_LAMP,
            2 => TRIM,
            row::MIDDLE if c > 0.92 => BLINKER,
            row::MIDDLE if c < 0.7 => DARK,
            row::SHOULDER | row::GLASS_LOW if c < 0.96 => GLASS,
            _ => self.paint,
        }));
        mesh.append(&cab.cap(false, |_, _| self.paint));
        mesh.append(&cab.patch(&[door - 0.01, door + 0.01], [row::SILL, row::RAIL], 0.004, DARK));
        wheel::under(cab, self.wheel, (RIM, 5), &mut mesh);
        let (out, x) = (self.size_m.y / 2.0, pane_front - 0.05);
        let section = cab.section(x);
        let middle = section[row::GLASS_LOW].lerp(section[row::GLASS_HIGH], 0.55);
        mesh.cylinder(middle, DVec3::new(x + 0.05, out - 0.07, middle.z), [0.025, 0.025], 6, DARK);
        let center = DVec3::new(x + 0.05, out - 0.08, middle.z);
        let half = DVec3::new(0.05, 0.08, 0.26);
        mesh.chamfered(center - half, center + half, 0.02, DARK);
        mesh
    }

    fn cargo_box(&self, mesh: &mut Mesh) {
        let (half, y) = (self.size_m.x / 2.0, self.cab.half_width + 0.03);
        let [min, max] =
            [DVec3::new(-half + 0.01, -y, self.frame + 0.06), DVec3::new(self.front, y, self.size_m.z)];
        mesh.chamfered(min, max, 0.035, self.goods);
        if let Some(skin) = self.stripe {
            let (low, high) = (0.55 * min.z + 0.45 * max.z, 0.3 * min.z + 0.7 * max.z);
            let inset = DVec3::new(0.25 * (max.x - min.x), 0.0, 0.0);
            let from = DVec3::new(min.x, -y - 0.004, low) + inset;
            mesh.block(from, DVec3::new(max.x, y + 0.004, high) - inset, skin);
        }
        // Gap between the rear doors, and their locking bars.
        let bar = |y: f64, r: f64, skin| {
            let at = DVec3::new(min.x, y, 0.0);
            let (low, high) = (DVec3::Z * (min.z + 0.1), DVec3::Z * (max.z - 0.1));
            (at + low - DVec3::new(0.01, r, 0.0), at + high + DVec3::new(0.01, r, 0.0), skin)
        };
        let bars = [bar(0.0, 0.012, DARK), bar(-0.35, 0.02, CHROME), bar(0.35, 0.02, CHROME)];
        bars.into_iter().for_each(|(min, max, skin)| mesh.block(min, max, skin));
        self.floor(mesh);
    }

    /// Adds the floor below the load.
    fn floor(&self, mesh: &mut Mesh) {
        let (half, y) = (self.size_m.x / 2.0, self.cab.half_width);
        mesh.block(DVec3::new(-half + 0.02, -y, 0.8), DVec3::new(self.front, y, self.frame + 0.07), TRIM);
    }

    fn flat_bed(&self, mesh: &mut Mesh) {
        self.floor(mesh);
        let (half, y, low) = (self.size_m.x / 2.0, self.cab.half_width + 0.02, self.frame + 0.05);
        let (rear, front) = (-half, self.front);
        let board = |mesh: &mut Mesh, min: [f64; 2], max: [f64; 2], up: f64, skin| {
            mesh.block(DVec3::new(min[0], min[1], low), DVec3::new(max[0], max[1], low + up), skin);
        };
        board(mesh, [rear + 0.05, -y], [front - 0.06, -y + 0.05], 0.5, self.paint);
        board(mesh, [rear + 0.05, y - 0.05], [front - 0.06, y], 0.5, self.paint);
        board(mesh, [rear, -y], [rear + 0.05, y], 0.5, self.paint);
        board(mesh, [front - 0.06, -y], [front, y], self.size_m.z - low, TRIM);
        let length = front - rear;
        board(mesh, [rear + 0.1, -y + 0.15], [rear + 0.35 * length, y - 0.2], 0.75, self.goods);
        let wrap = Skin::new([168, 172, 176], Surface::Cloth);
        board(mesh, [rear + 0.42 * length, -y + 0.2], [rear + 0.85 * length, y - 0.15], 1.1, wrap);
    }

    fn tank(&self, mesh: &mut Mesh) {
        self.floor(mesh);
        let (rear, front) = (-self.size_m.x / 2.0, self.front);
        let (low, high) = (self.frame + 0.05, self.size_m.z);
        let (z, half_height, half_width) = ((low + high) / 2.0, (high - low) / 2.0, self.cab.half_width);
        let ring = |x: f64, share: f64| Ring {
            center: DVec3::new(x, 0.0, z),
            u: DVec3::Y * half_width * share,
            v: DVec3::Z * half_height * share,
        };
        let rings = [
            ring(rear, 0.35),
            ring(rear + 0.07, 0.8),
            ring(rear + 0.2, 1.0),
            ring((rear + front) / 2.0 - 0.03, 1.0),
            ring((rear + front) / 2.0 + 0.03, 1.0),
            ring(front - 0.2, 1.0),
            ring(front - 0.07, 0.8),
            ring(front, 0.35),
        ];
        let skin = |i: usize, _| if i == 3 { self.stripe.unwrap_or(self.goods) } else { self.goods };
        mesh.tube(&rings, 24, skin);
    }
}
