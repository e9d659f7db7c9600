//! Triangles of a car.

use glam::DVec3;

use super::Car;
use crate::mesh::{Mesh, Ring, Skin};
use crate::model::colors::{BLINKER, DARK, GLASS, HEAD_LAMP, PLATE, TAIL_LAMP, TRIM};
use crate::model::shell::row;
use crate::model::wheel;

impl Car {
    /// Returns its triangles, approximately of its size, with smooth normals.
    pub(in crate::model) fn mesh(&self) -> Mesh {
        let mut edges: Vec<f64> = self.panes.iter().flatten().copied().collect();
        edges.extend(self.windscreen.iter().chain(&self.rear_screen));
        edges.extend([self.shell.front.x - self.lamps[0], self.shell.rear.x + self.lamps[1]]);
        let stations = self.shell.stations(&edges);
        let mut mesh = self.shell.hull(&stations, |x, row| hull_skin(self, x, row));
        mesh.append(&self.shell.cap(true, |row, c| nose_skin(self, row, c)));
        mesh.append(&self.shell.cap(false, |row, c| tail_skin(self, row, c)));
        lines(self, &mut mesh);
        mirror(self, &mut mesh);
        wheel::under(&self.shell, self.wheel, (self.rim, self.spokes), &mut mesh);
        if self.rails {
            rail(self, &mut mesh);
        }
        mesh.mirror_y();
        plates(self, &mut mesh);
        mesh.smooth(0.7);
        mesh
    }
}

fn hull_skin(car: &Car, x: f64, row: usize) -> Skin {
    let within = |range: &[f64; 2]| (range[0]..range[1]).contains(&x);
    let cabin = car.panes.first().zip(car.panes.last()).map(|(first, last)| [last[0], first[1]]);
    let in_cabin = cabin.is_some_and(|range| within(&range));
    let [head, tail] = [x > car.shell.front.x - car.lamps[0], x < car.shell.rear.x + car.lamps[1]];
    let in_bed = car.shell.bed.is_some_and(|bed| (bed.rear - 0.02..bed.front + 0.02).contains(&x));
    match row {
        0 | 1 => DARK,
        2 => car.cladding,
        row::HIGH if head => HEAD_LAMP,
        row::MIDDLE | row::HIGH if tail && car.upright_lamps && x < car.shell.rear.x + 0.16 => TAIL_LAMP,
        row::HIGH if tail && !car.upright_lamps => TAIL_LAMP,
        row::GLASS_LOW if car.panes.iter().any(within) => GLASS,
        row::SHOULDER | row::GLASS_LOW if in_cabin => car.pillar,
        row::RAIL.. if in_bed => TRIM,
        row::ROOF_EDGE.. if within(&car.windscreen) || within(&car.rear_screen) => GLASS,
        row::RAIL.. if (car.rear_screen[0]..car.windscreen[1]).contains(&x) => car.roof,
        _ => car.paint,
    }
}

/// Returns the skin of the nose: grille, lamps and air intake.
fn nose_skin(car: &Car, row: usize, c: f64) -> Skin {
    let grille = (car.grille_row..row::SHOULDER).contains(&row) && c < car.lamp_share - 0.06;
    match row {
        1 => DARK,
        2 if c < 0.72 => DARK,
        2 => car.cladding,
        _ if grille => car.grille,
        row::MIDDLE if c > 0.86 => BLINKER,
        row::HIGH if c > car.lamp_share => HEAD_LAMP,
        _ => car.paint,
    }
}

fn tail_skin(car: &Car, row: usize, c: f64) -> Skin {
    match row {
        1 => DARK,
        2 => car.cladding,
        row::MIDDLE if car.upright_lamps && c > 0.8 => TAIL_LAMP,
        row::HIGH if c > if car.upright_lamps { 0.8 } else { 0.56 } => TAIL_LAMP,
        _ => car.paint,
    }
}

/// Adds gaps and handles of the left doors.
fn lines(car: &Car, mesh: &mut Mesh) {
    for (i, x) in car.doors.iter().enumerate() {
        mesh.append(&car.shell.patch(&[x - 0.008, x + 0.008], [row::SILL, row::SHOULDER], 0.003, DARK));
        let next = car.doors.get(i + 1);
        if let Some(rear) = next {
            let x = rear + 0.14;
            let section = car.shell.section(x);
            let at = section[row::HIGH].lerp(section[row::SHOULDER], 0.55);
            let half = DVec3::new(0.10, 0.018, 0.016);
            mesh.block(at - half, at + half, car.paint);
        }
    }
}

/// Adds the left mirror, which reaches to the side of the box.
fn mirror(car: &Car, mesh: &mut Mesh) {
    let x = car.panes.first().map_or(0.0, |pane| pane[1]) - 0.10;
    let section = car.shell.section(x);
    let foot = section[row::GLASS_LOW];
    let out = car.size_m.y / 2.0;
    let half = DVec3::new(0.075, 0.10, 0.065 * car.size_m.z / 1.45);
    let center = DVec3::new(x, out - half.y, foot.z + 0.3 * half.z);
    mesh.cylinder(DVec3::new(x, foot.y - 0.03, foot.z), center, [0.03, 0.03], 5, DARK);
    let ring = |share: f64, size: f64| Ring {
        center: center + DVec3::X * half.x * share,
        u: DVec3::Y * half.y * size,
        v: DVec3::Z * half.z * size,
    };
    let rings = [ring(-1.0, 0.9), ring(-0.5, 1.0), ring(0.4, 0.85), ring(1.0, 0.4)];
    mesh.tube(&rings, 8, |_, _| car.paint);
}

/// Adds the left roof rail.
fn rail(car: &Car, mesh: &mut Mesh) {
    let [front, rear] = [car.windscreen[0] - 0.35, car.rear_screen[1] + 0.20];
    let at = |i: u8| {
        let x = rear + (front - rear) * f64::from(i) / 4.0;
        let edge = car.shell.section(x)[row::ROOF_EDGE];
        DVec3::new(x, edge.y - 0.02, edge.z + if (1..4).contains(&i) { 0.035 } else { -0.01 })
    };
    for i in 0..4 {
        mesh.cylinder(at(i), at(i + 1), [0.018, 0.018], 4, TRIM);
    }
}

/// Adds number plates, which reach to the ends of the box.
fn plates(car: &Car, mesh: &mut Mesh) {
    for front in [true, false] {
        let height = if front {
            0.30
        } else if car.upright_lamps {
            0.42
        } else {
            0.48
        } * car.size_m.z;
        let height = height.max(car.shell.under + 0.20);
        let x = car.shell.cap_x(front, height);
        let half = DVec3::new(0.02, 0.26, 0.055);
        let center = DVec3::new(x, 0.0, height);
        mesh.block(center - half, center + half, PLATE);
    }
}
