//! City buses.

use glam::DVec3;

use super::colors::{self, DARK, GLASS, HEAD_LAMP, PLATE, RIM, TAIL_LAMP, TRIM};
use super::curve::{Corner, Curve};
use super::dice::Dice;
use super::shell::{Arch, End, Shell, row};
use super::wheel;
use crate::mesh::{Mesh, Skin, Surface};

/// Lit letters of the destination sign.
const LETTERS: Skin = Skin::new([240, 170, 60], Surface::Lamp);

/// Bus with its dimensions, meters.
#[derive(Clone, Debug)]
pub(super) struct Bus {
    pub(super) size_m: DVec3,
    shell: Shell,
    paint: Skin,
    /// Skin below the windows.
    band: Skin,
    panes: Vec<[f64; 2]>,
    doors: Vec<f64>,
}

impl Bus {
    pub(super) fn new(dice: &mut Dice) -> Self {
        let size_m =
            DVec3::new(dice.between([10.4, 12.3]), dice.between([2.72, 2.86]), dice.between([2.95, 3.2]));
        let half = size_m.x / 2.0;
        let belt = size_m.z * dice.between([0.38, 0.43]);
        let end = |x: f64, bow: f64| End { x, bow, taper: 0.04, taper_m: 0.5, lift: 0.05, belt };
        let corner = |x: f64, z: f64, round: f64| Corner { x, z, round };
        let (bow, z) = (dice.between([0.06, 0.14]), size_m.z);
        let top = [
            corner(-half, z - 0.16, 0.0),
            corner(-half + 0.12, z - 0.01, 0.12),
            corner(0.0, z, 0.3),
            corner(half - 0.32, z - 0.01, 0.2),
            corner(half, z - 0.22, 0.0),
        ];
        let arch = |x: f64| Arch { x, z: 0.49, radius: 0.57 };
        let shell = Shell {
            rear: end(-half + 0.03, 0.03),
            front: end(half - bow, bow),
            half_width: size_m.y / 2.0 - 0.13,
            top: Curve::new(&top),
            under: 0.30,
            tumble: 0.05,
            flare: 0.0,
            arches: vec![arch(half - dice.between([2.5, 2.75])), arch(-half + dice.between([3.0, 3.35]))],
            bed: None,
        };
        let (from, to, count) = (half - 0.75, -half + 0.5, dice.pick(&[6, 5]));
        let width = (from - to) / f64::from(count);
        let pane = |i: i32| [from - width * f64::from(i + 1) + 0.04, from - width * f64::from(i) - 0.04];
        let paint = colors::fleet_paint(dice);
        let band = if dice.chance(0.5) { colors::fleet_paint(dice) } else { paint };
        let middle = dice.between([-0.9, 0.4]);
        let doors = vec![half - 1.45, middle];
        Self { size_m, shell, paint, band, panes: (0..count).map(pane).collect(), doors }
    }

    pub(super) fn mesh(&self) -> Mesh {
        let edges: Vec<f64> = self.panes.iter().flatten().copied().collect();
        let mut mesh = self.shell.hull(&self.shell.stations(&edges), |x, row| match row {
            0 | 1 => DARK,
            2 => TRIM,
            row::GLASS_LOW if self.panes.iter().any(|p| (p[0]..p[1]).contains(&x)) => GLASS,
            row::SHOULDER | row::GLASS_LOW if x > self.panes.last().map_or(0.0, |p| p[0]) => DARK,
            row::MIDDLE | row::HIGH => self.band,
            _ => self.paint,
        });
        mesh.append(&self.shell.cap(true, |row, c| match row {
            1 | 2 => TRIM,
            row::MIDDLE if c > 0.68 => HEAD_LAMP,
            row::MIDDLE => self.band,
            row::HIGH if c < 0.9 => GLASS,
            row::SHOULDER | row::GLASS_LOW if c < 0.95 => GLASS,
            row::GLASS_HIGH | row::RAIL => DARK,
            _ => self.paint,
        }));
        mesh.append(&self.shell.cap(false, |row, c| match row {
            1 | 2 => TRIM,
            row::MIDDLE | row::HIGH if c > 0.86 => TAIL_LAMP,
            row::MIDDLE | row::HIGH => self.band,
            row::GLASS_LOW if c < 0.86 => GLASS,
            _ => self.paint,
        }));
        wheel::under(&self.shell, [0.49, 0.30], (RIM, 7), &mut mesh);
        let (out, x) = (self.size_m.y / 2.0, self.shell.front.x - 0.25);
        let high = self.shell.section(x)[row::GLASS_HIGH];
        let arm = DVec3::new(x, high.y - 0.05, high.z);
        mesh.cylinder(arm, DVec3::new(x + 0.1, out - 0.07, high.z), [0.025, 0.025], 6, DARK);
        let mirror = DVec3::new(x + 0.1, out - 0.09, high.z - 0.17);
        let size = DVec3::new(0.05, 0.09, 0.2);
        mesh.chamfered(mirror - size, mirror + size, 0.02, DARK);
        mesh.mirror_y();
        self.doors(&mut mesh);
        self.signs(&mut mesh);
        mesh.smooth(0.7);
        mesh
    }

    /// Adds two-leaf doors on the right side.
    fn doors(&self, mesh: &mut Mesh) {
        let mut right = Mesh::default();
        for x in &self.doors {
            let leaf = |from: f64, to: f64| [from, (from + to) / 2.0, to];
            let frame = leaf(x - 0.66, x + 0.66);
            right.append(&self.shell.patch(&frame, [row::SILL, row::RAIL], 0.006, DARK));
            for [from, to] in [[x - 0.60, x - 0.04], [x + 0.04, x + 0.60]] {
                right.append(&self.shell.patch(
                    &leaf(from, to),
                    [row::MIDDLE, row::GLASS_HIGH],
                    0.012,
                    GLASS,
                ));
            }
        }
        for vertex in &mut right.vertices {
            vertex.position[1] = -vertex.position[1];
            vertex.normal[1] = -vertex.normal[1];
        }
        right.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        mesh.append(&right);
    }

    /// Adds the destination sign and the number plates.
    fn signs(&self, mesh: &mut Mesh) {
        let section = self.shell.section(self.shell.front.x);
        let z = section[row::GLASS_HIGH].z - 0.05;
        let block = |mesh: &mut Mesh, x: f64, z: f64, half: DVec3, skin| {
            let center = DVec3::new(x, 0.0, z);
            mesh.block(center - half, center + half, skin);
        };
        let x = self.shell.cap_x(true, z);
        block(mesh, x - 0.03, z, DVec3::new(0.05, 0.75, 0.13), DARK);
        block(mesh, x - 0.02, z, DVec3::new(0.05, 0.62, 0.07), LETTERS);
        for front in [true, false] {
            let x = self.shell.cap_x(front, 0.62);
            block(mesh, x, 0.62, DVec3::new(0.02, 0.26, 0.055), PLATE);
        }
    }
}
