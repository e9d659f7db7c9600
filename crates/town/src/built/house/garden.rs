use glam::{DVec2, DVec3};

use super::properties::House;
use crate::built::ground::flat;
use crate::built::lots::{Lot, Use};
use crate::built::plants::{Crown, bush};
use crate::built::sketch::{Wall, corners};
use crate::built::style::{District, Style};
use crate::mesh::{Mesh, Skin, Surface};

/// Height of paths and paving above the ground, meters: slightly below the sidewalk.
const PAVED_M: f64 = 0.012;

/// Adds the area between a house and the sidewalk: paving, or a path, a fence or a hedge, and bushes.
pub(super) fn front(mesh: &mut Mesh, lot: &Lot, style: &Style, house: &mut House) {
    let (w, out) = (house.width, lot.setback_m);
    let slabs = Skin::new(style.slabs.map(|c| c.saturating_sub(10)), Surface::Sidewalk);
    let pave = |mesh: &mut Mesh, x: [f64; 2], y: [f64; 2]| {
        flat(mesh, &corners(DVec2::new(x[0], y[0]), DVec2::new(x[1], y[1])), PAVED_M, slabs);
    };
    if out < 1.6 || lot.kind != Use::House || lot.quarter == District::Centre {
        pave(mesh, [0.0, w], [-out - 0.15, 0.02]);
        return;
    }
    let gate = [house.door_at[0] - 0.2, house.door_at[1] + 0.2];
    pave(mesh, gate, [-out - 0.15, 0.02]);
    let edge = 0.25 - out;
    let height = house.draw.between(0.7, 1.15);
    let kind = house.draw.below(4);
    for x in [[0.15, gate[0]], [gate[1], w - 0.15]] {
        if x[1] - x[0] > 0.4 {
            match kind {
                0 => hedge(mesh, x, edge, height, style, house),
                1 => low_wall(mesh, x, edge, height, house),
                2 => pickets(mesh, x, edge, height, house),
                _ => {}
            }
        }
    }
    let roomy = ((out - 1.4) / 2.0).max(0.0);
    for _ in 0..house.draw.below(4) {
        let radius = house.draw.between(0.35, 0.7);
        let x = house.draw.between(0.6, w - 0.6);
        if x + radius < gate[0] || x - radius > gate[1] {
            let at = DVec3::new(x, -0.9 - house.draw.between(0.0, 1.0) * roomy, 0.0);
            let rgb = house.draw.pick(&[style.leaves[0], style.leaves[1], [96, 120, 62], [170, 92, 110]]);
            bush(mesh, at, radius, Crown::new(rgb, house.draw.seed()));
        }
    }
}

/// Adds a clipped hedge with a slightly uneven surface.
fn hedge(mesh: &mut Mesh, x: [f64; 2], y: f64, height: f64, style: &Style, house: &mut House) {
    let rgb = house.draw.shade(style.leaves[0], 0.1).map(|c| (f64::from(c) * 0.85) as u8);
    let skin = Skin { rgb, surface: Surface::Foliage, seed: house.draw.seed() as u32 & 0xff_ffff };
    let wall = Wall::new(DVec3::new(x[0], y, 0.0), DVec3::new(x[1], y, 0.0));
    let count = (wall.length / 0.7).ceil() as usize;
    let step = wall.length / count as f64;
    for i in 0..count {
        let u = [step * i as f64, step * (i + 1) as f64];
        let (top, out) = (height + house.draw.between(-0.06, 0.06), house.draw.between(-0.05, 0.04));
        wall.slab(mesh, u, [-0.05, top], [-0.5, out], skin);
        wall.polygon(
            mesh,
            &[[u[1], -0.05, -0.5], [u[0], -0.05, -0.5], [u[0], top, -0.5], [u[1], top, -0.5]],
            skin,
        );
    }
}

fn low_wall(mesh: &mut Mesh, x: [f64; 2], y: f64, height: f64, house: &House) {
    mesh.block(DVec3::new(x[0], y, -0.1), DVec3::new(x[1], y + 0.25, height * 0.7), house.base);
    mesh.block(
        DVec3::new(x[0] - 0.03, y - 0.04, height * 0.7),
        DVec3::new(x[1] + 0.03, y + 0.29, height * 0.7 + 0.06),
        house.trim,
    );
}

fn pickets(mesh: &mut Mesh, x: [f64; 2], y: f64, height: f64, house: &mut House) {
    let skin = Skin::new(house.draw.pick(&[[236, 234, 226], [128, 92, 62], [84, 66, 52]]), Surface::Wood);
    for z in [0.25, height - 0.2] {
        mesh.block(DVec3::new(x[0], y, z), DVec3::new(x[1], y + 0.04, z + 0.07), skin);
    }
    let front = Wall::new(DVec3::new(x[0], y, 0.0), DVec3::new(x[1], y, 0.0));
    let back = Wall::new(DVec3::new(x[1], y, 0.0), DVec3::new(x[0], y, 0.0));
    let count = (front.length / 0.2).floor() as usize;
    for i in 0..count {
        let u = 0.2 * i as f64 + 0.05;
        for wall in [&front, &back] {
            let picket = [
                [u, 0.03],
                [u + 0.11, 0.03],
                [u + 0.11, height - 0.06],
                [u + 0.055, height],
                [u, height - 0.06],
            ];
            wall.shape(mesh, &picket, 0.03, skin);
        }
    }
}
