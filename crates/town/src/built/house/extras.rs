use super::openings::{Opening, OpeningKind, panes};
use super::properties::House;
use crate::built::sketch::Wall;
use crate::mesh::{Mesh, Skin, Surface};

/// sRGB colors of shop signs and awnings.
pub(super) const SHOPS: [[u8; 3]; 9] = [
    [164, 36, 40],
    [24, 84, 62],
    [28, 60, 112],
    [214, 160, 40],
    [38, 38, 40],
    [228, 222, 208],
    [112, 40, 84],
    [30, 120, 130],
    [206, 96, 40],
];

/// Adds a door with a window above, a step, and for some houses a canopy.
pub(super) fn door(mesh: &mut Mesh, wall: &Wall, hole: &Opening, house: &mut House) {
    let Opening { u, v, .. } = *hole;
    let (depth, leaf_top) = (0.24, v[0] + 1.95);
    wall.reveal(mesh, u, v, depth, house.trim);
    wall.quad(mesh, u, v, -depth, house.door);
    let light = Opening { u, v: [leaf_top, v[1]], kind: OpeningKind::Window };
    panes(mesh, wall, &light, 0.02 - depth, 1, &mut house.draw);
    for part in [[0.2, 0.85], [1.05, 1.75]] {
        let darker = Skin { rgb: house.door.rgb.map(|c| (f64::from(c) * 0.75) as u8), ..house.door };
        let across = [u[0] + 0.15, u[1] - 0.15];
        wall.quad(mesh, across, [v[0] + part[0], v[0] + part[1]], 0.015 - depth, darker);
    }
    wall.slab(
        mesh,
        [u[1] - 0.12, u[1] - 0.09],
        [v[0] + 0.95, v[0] + 1.1],
        [-depth, 0.06 - depth],
        house.metal,
    );
    wall.slab(
        mesh,
        [u[0] - 0.25, u[1] + 0.25],
        [-0.05, v[0]],
        [-depth, 0.16],
        Skin::new([156, 152, 146], Surface::Concrete),
    );
    for side in [[u[0] - 0.14, u[0]], [u[1], u[1] + 0.14]] {
        wall.quad(mesh, side, [v[0], v[1] + 0.14], 0.03, house.trim);
    }
    wall.quad(mesh, u, [v[1], v[1] + 0.14], 0.03, house.trim);
    if !house.shop && house.draw.chance(0.4) {
        let out = house.draw.between(0.7, 1.1);
        wall.slab(mesh, [u[0] - 0.3, u[1] + 0.3], [v[1] + 0.16, v[1] + 0.28], [0.0, out], house.trim);
    }
}

/// Adds a shop sign above its windows, and for some shops a projecting sign.
pub(super) fn shop_sign(
    mesh: &mut Mesh,
    wall: &Wall,
    u: [f64; 2],
    v: [f64; 2],
    skin: Skin,
    house: &mut House,
) {
    let skin = Skin { seed: house.draw.seed() as u32 & 0xff_ffff, ..skin };
    let local = wall.moved(u[0], v[0], 0.0);
    local.slab(mesh, [0.0, u[1] - u[0]], [0.0, v[1] - v[0]], [0.0, 0.09], skin);
    if house.draw.chance(0.35) {
        let (at, low) = (u[0] + 0.15, v[1] + 0.1);
        wall.slab(mesh, [at, at + 0.1], [low, low + 0.75], [0.12, 0.85], skin);
        wall.slab(mesh, [at + 0.03, at + 0.07], [low + 0.6, low + 0.65], [0.0, 0.12], house.metal);
    }
}

/// Adds a slanted awning with a hanging front edge.
pub(super) fn awning(mesh: &mut Mesh, wall: &Wall, u: [f64; 2], top: f64, house: &mut House) {
    let skin = Skin {
        rgb: house.draw.pick(&SHOPS),
        surface: Surface::Cloth,
        seed: house.draw.seed() as u32 & 0xff_ffff,
    };
    let (out, low, hem) = (1.15, top - 0.55, top - 0.75);
    let [a, b] = u;
    for (a, b) in [(a, b), (b, a)] {
        // Both faces are visible.
        wall.polygon(mesh, &[[a, low, out], [b, low, out], [b, top, 0.02], [a, top, 0.02]], skin);
        wall.polygon(mesh, &[[a, hem, out], [b, hem, out], [b, low, out], [a, low, out]], skin);
    }
    for end in [a, b] {
        wall.polygon(mesh, &[[end, low, out], [end, top, 0.02], [end, low, 0.02]], skin);
        wall.polygon(mesh, &[[end, low, 0.02], [end, top, 0.02], [end, low, out]], skin);
    }
}

/// Adds a balcony: a slab with a railing of bars or boards.
pub(super) fn balcony(mesh: &mut Mesh, wall: &Wall, u: [f64; 2], floor: f64, house: &mut House) {
    let out = 0.95;
    wall.slab(mesh, u, [floor - 0.14, floor], [0.0, out], house.trim);
    let top = floor + 1.0;
    let rail = house.metal;
    wall.slab(mesh, u, [top - 0.05, top], [out - 0.06, out], rail);
    if house.mouldings {
        let count = ((u[1] - u[0]) / 0.26).ceil() as usize;
        for i in 0..=count {
            let at = u[0] + 0.015 + (u[1] - u[0] - 0.03) * i as f64 / count as f64;
            wall.quad(mesh, [at - 0.013, at + 0.013], [floor, top], out - 0.02, rail);
            wall.polygon(
                mesh,
                &[
                    [at + 0.013, floor, out - 0.04],
                    [at - 0.013, floor, out - 0.04],
                    [at - 0.013, top, out - 0.04],
                    [at + 0.013, top, out - 0.04],
                ],
                rail,
            );
        }
    } else {
        wall.slab(mesh, [u[0], u[1]], [floor, top - 0.05], [out - 0.05, out - 0.01], house.trim);
        wall.polygon(
            mesh,
            &[
                [u[1], floor, out - 0.05],
                [u[0], floor, out - 0.05],
                [u[0], top, out - 0.05],
                [u[1], top, out - 0.05],
            ],
            house.trim,
        );
    }
    for at in u {
        let inner = if at == u[0] { at + 0.03 } else { at - 0.03 };
        let ends = [at.min(inner), at.max(inner)];
        wall.slab(mesh, ends, [top - 0.05, top], [0.0, out], rail);
    }
}
