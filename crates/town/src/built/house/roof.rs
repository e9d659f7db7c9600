use glam::DVec3;

use super::openings::{Opening, OpeningKind, panes};
use super::properties::{House, walls};
use crate::built::lots::Side;
use crate::built::sketch::Wall;
use crate::mesh::{Mesh, Skin, Surface};

/// Overhang of eaves, meters.
const EAVES_M: f64 = 0.4;

/// Adds the roof of a house, with chimneys and dormers.
pub(super) fn roof(mesh: &mut Mesh, house: &mut House) {
    let top = house.eaves_m();
    match house.slope {
        None => flat(mesh, house, top),
        // In a frame rotated by 90°, the ridge runs across the street.
        Some(slope) if house.gable_front => {
            let mut turned = Mesh::default();
            let party = [house.sides[0], house.sides[2]].map(|side| side == Side::Party);
            gable(&mut turned, house, [house.depth, house.width], slope, party);
            for vertex in &mut turned.vertices {
                let turn = |[x, y, z]: [f32; 3], at: f32| [at - y, x, z];
                vertex.position = turn(vertex.position, house.width as f32);
                vertex.normal = turn(vertex.normal, 0.0);
            }
            mesh.append(&turned);
        }
        Some(slope) => {
            let party = [house.sides[3], house.sides[1]].map(|side| side == Side::Party);
            gable(mesh, house, [house.width, house.depth], slope, party);
            if house.floors > 1 && house.draw.chance(0.5) {
                dormers(mesh, house, slope);
            }
        }
    }
    if house.slope.is_some() {
        chimneys(mesh, house);
    }
}

/// Adds a flat roof with a parapet and up to two roof structures.
fn flat(mesh: &mut Mesh, house: &mut House, top: f64) {
    let (w, d, rim, thick) = (house.width, house.depth, top + 0.7, 0.25);
    mesh.polygon(&[[0.0, 0.0], [w, 0.0], [w, d], [0.0, d]].map(|[x, y]| DVec3::new(x, y, top)), house.roof);
    for wall in walls(w, d) {
        wall.quad(mesh, [0.0, wall.length], [top, rim], 0.0, house.wall);
        let inner =
            [[wall.length, top, -thick], [0.0, top, -thick], [0.0, rim, -thick], [wall.length, rim, -thick]];
        wall.polygon(mesh, &inner, house.wall);
        wall.slab(mesh, [0.0, wall.length], [rim, rim + 0.08], [-thick, 0.04], house.trim);
    }
    for _ in 0..house.draw.below(3) {
        let size = DVec3::new(
            house.draw.between(1.0, 3.0),
            house.draw.between(1.0, 2.5),
            house.draw.between(0.8, 2.4),
        );
        let room = DVec3::new(w - 2.0 - size.x, d - 2.0 - size.y, 0.0).max(DVec3::ZERO);
        let at = DVec3::new(
            1.0 + house.draw.between(0.0, 1.0) * room.x,
            1.0 + house.draw.between(0.0, 1.0) * room.y,
            top,
        );
        mesh.block(
            at,
            at + size,
            house.draw.pick(&[house.wall, house.metal, Skin::new([168, 170, 172], Surface::Metal)]),
        );
    }
}

/// Adds a pitched roof over a rectangle with its ridge along x; `party` marks adjoining houses at the left
/// and the right.
fn gable(mesh: &mut Mesh, house: &mut House, [w, d]: [f64; 2], slope: f64, party: [bool; 2]) {
    let (top, rise) = (house.eaves_m(), d / 2.0 * slope);
    let eaves = top - EAVES_M * slope;
    let hip = if house.draw.chance(0.3) && party == [false; 2] { (w / 2.0 - 0.6).min(d / 2.0) } else { 0.0 };
    let verge = party.map(|party| if party || hip > 0.0 { 0.0 } else { 0.25 });
    let out = if hip > 0.0 { EAVES_M } else { 0.0 };
    let ends = [-verge[0] - out, w + verge[1] + out];
    let ridge = [ends[0] + hip + out * f64::from(hip > 0.0), ends[1] - hip - out * f64::from(hip > 0.0)];
    let thick = 0.16;
    let sides = walls(w, d);
    for wall in [sides[0], sides[2]] {
        let mirrored = wall.at(0.0, 0.0, 0.0).x > 0.5 * w;
        let (ends, ridge) =
            if mirrored { ([w - ends[1], w - ends[0]], [w - ridge[1], w - ridge[0]]) } else { (ends, ridge) };
        let face = [
            [ends[0], eaves, EAVES_M],
            [ends[1], eaves, EAVES_M],
            [ridge[1], top + rise, -d / 2.0],
            [ridge[0], top + rise, -d / 2.0],
        ];
        wall.polygon(mesh, &face.map(|[u, v, out]| [u, v + thick, out]), house.roof);
        wall.polygon(
            mesh,
            &[[ends[0], top, 0.0], [ends[1], top, 0.0], [ends[1], eaves, EAVES_M], [ends[0], eaves, EAVES_M]],
            house.trim,
        );
        let gutter = Skin::new([120, 122, 124], Surface::Metal);
        wall.shelf(mesh, ends, [eaves - 0.02, eaves + thick], [EAVES_M - 0.01, EAVES_M + 0.1], gutter);
        if hip == 0.0 {
            verges(mesh, &wall, ends, [eaves, top + rise], [EAVES_M, -d / 2.0], thick, house.trim);
        }
    }
    for (i, wall) in [sides[3], sides[1]].into_iter().enumerate() {
        if hip > 0.0 {
            let face =
                [[-EAVES_M, eaves, EAVES_M], [d + EAVES_M, eaves, EAVES_M], [d / 2.0, top + rise, -hip]];
            wall.polygon(mesh, &face.map(|[u, v, out]| [u, v + thick, out]), house.roof);
            wall.shelf(
                mesh,
                [-EAVES_M, d + EAVES_M],
                [eaves - 0.02, eaves + thick],
                [EAVES_M - 0.05, EAVES_M],
                house.trim,
            );
            continue;
        }
        wall.shape(mesh, &[[0.0, top], [d, top], [d / 2.0, top + rise]], 0.0, house.wall);
        if !party[i] && house.floors > 1 && rise > 2.6 {
            let u = [d / 2.0 - 0.45, d / 2.0 + 0.45];
            let hole = Opening { u, v: [top + 0.5, top + 1.6], kind: OpeningKind::Window };
            wall.quad(mesh, u, hole.v, 0.02, house.frame);
            panes(mesh, &wall, &hole, 0.035, 1, &mut house.draw);
        }
    }
}

/// Adds the edges of a slope above the gables.
fn verges(mesh: &mut Mesh, wall: &Wall, ends: [f64; 2], v: [f64; 2], out: [f64; 2], thick: f64, skin: Skin) {
    for (u, right) in [(ends[0], false), (ends[1], true)] {
        let mut face =
            [[u, v[0], out[0]], [u, v[0] + thick, out[0]], [u, v[1] + thick, out[1]], [u, v[1], out[1]]];
        if right {
            face.reverse();
        }
        wall.polygon(mesh, &face, skin);
    }
}

/// Adds dormers to the front slope.
fn dormers(mesh: &mut Mesh, house: &mut House, slope: f64) {
    let front = house.walls()[0];
    let (wide, tall, back) = (1.3, 1.35, 0.6);
    if house.depth / 2.0 * slope < tall + 1.2 {
        return;
    }
    let count = ((house.width - 1.5) / 3.2).floor() as usize;
    let low = house.eaves_m() + back * slope + 0.12;
    for i in 0..count {
        let middle = house.width * (i as f64 + 0.5) / count as f64;
        let u = [middle - wide / 2.0, middle + wide / 2.0];
        let (v, out) = ([low, low + tall], -back);
        front.quad(mesh, u, v, out, house.trim);
        let hole = Opening {
            u: [u[0] + 0.18, u[1] - 0.18],
            v: [low + 0.15, low + tall - 0.12],
            kind: OpeningKind::Window,
        };
        front.quad(mesh, hole.u, hole.v, out + 0.015, house.frame);
        panes(mesh, &front, &hole, out + 0.03, 2, &mut house.draw);
        // Cheeks and roof of a dormer end where they meet the slope.
        let deep = out - tall / slope;
        front.polygon(
            mesh,
            &[[u[0], low, out], [u[0], low + tall, out], [u[0], low + tall, deep]],
            house.trim,
        );
        front.polygon(
            mesh,
            &[[u[1], low + tall, deep], [u[1], low + tall, out], [u[1], low, out]],
            house.trim,
        );
        let (over, peak) = (0.15, 0.35);
        let peak_deep = deep - peak / slope;
        let (top, ridge) = (low + tall, low + tall + peak);
        front.polygon(
            mesh,
            &[
                [u[0] - over, top - 0.05, out + over],
                [middle, ridge, out + over],
                [middle, ridge, peak_deep],
                [u[0] - over, top - 0.05, deep],
            ],
            house.roof,
        );
        front.polygon(
            mesh,
            &[
                [middle, ridge, out + over],
                [u[1] + over, top - 0.05, out + over],
                [u[1] + over, top - 0.05, deep],
                [middle, ridge, peak_deep],
            ],
            house.roof,
        );
        front.polygon(mesh, &[[u[0], top, out], [u[1], top, out], [middle, ridge - 0.04, out]], house.trim);
    }
}

fn chimneys(mesh: &mut Mesh, house: &mut House) {
    let (w, d) = (house.width, house.depth);
    let slope = house.slope.unwrap_or(0.0);
    let half = if house.gable_front { w } else { d } / 2.0;
    for side in 0..2 {
        if !house.draw.chance(0.55) {
            continue;
        }
        let off = house.draw.between(0.4, 1.4);
        let last = if house.gable_front { d } else { w } - 0.9;
        let along = [0.9, last][side];
        let (x, y) = if house.gable_front { (half + off, along) } else { (along, half + off) };
        let high = house.eaves_m() + half * slope;
        let brick = Skin::new([140, 86, 70], Surface::Brick);
        mesh.block(
            DVec3::new(x - 0.35, y - 0.3, high - off * slope - 0.6),
            DVec3::new(x + 0.35, y + 0.3, high + 0.9),
            brick,
        );
        mesh.block(
            DVec3::new(x - 0.42, y - 0.37, high + 0.9),
            DVec3::new(x + 0.42, y + 0.37, high + 1.0),
            house.trim,
        );
        for dx in [-0.17, 0.17] {
            let pot = Skin::new([172, 100, 74], Surface::Plain);
            mesh.block(
                DVec3::new(x + dx - 0.1, y - 0.1, high + 1.0),
                DVec3::new(x + dx + 0.1, y + 0.1, high + 1.35),
                pot,
            );
        }
    }
}
