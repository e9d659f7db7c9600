use super::extras::{SHOPS, awning, balcony, door, shop_sign};
use super::openings::{Opening, OpeningKind, panes};
use super::properties::House;
use crate::built::sketch::Wall;
use crate::mesh::{Mesh, Skin, Surface};

/// Depth of panes in the wall, meters.
const RECESS_M: f64 = 0.13;
/// Depth of walls below the ground, meters.
pub(super) const FOOT_M: f64 = 0.1;

/// Adds a facade towards a street: recessed windows, ground floor, mouldings and balconies.
pub(super) fn street(mesh: &mut Mesh, wall: &Wall, house: &mut House, front: bool) {
    let bays = ((wall.length - 0.6) / house.bay_m).round().max(1.0) as usize;
    let bay_m = wall.length / bays as f64;
    ground_floor(mesh, wall, house, bays, front);
    let width = house.window[0].min(bay_m - 0.5);
    let mut balconies = Vec::new();
    if house.balconies && house.floors > 2 && bays > 1 {
        let column = house.draw.below(bays);
        let mirrored = if house.draw.chance(0.5) { bays - 1 - column } else { column };
        balconies = vec![column, mirrored];
        balconies.dedup();
    }
    for floor in 1..house.floors {
        let low = house.ground_m + (floor - 1) as f64 * house.floor_m;
        let top = low + house.floor_m;
        let opening = |bay: usize| {
            let middle = (bay as f64 + 0.5) * bay_m;
            let sill = low + if balconies.contains(&bay) { 0.12 } else { house.sill_m };
            let high = (low + house.sill_m + house.window[1]).min(top - 0.35);
            let u = [middle - width / 2.0, middle + width / 2.0];
            Opening { u, v: [sill, high], kind: OpeningKind::Window }
        };
        let openings: Vec<Opening> = (0..bays).map(opening).collect();
        // Glazing bars of high windows are not visible.
        let leaves = house.leaves;
        house.leaves = if floor < 3 { leaves } else { 1 };
        row(mesh, wall, [low, top], &openings, house, house.wall);
        house.leaves = leaves;
        for &bay in &balconies {
            let u = openings[bay].u;
            let room = (bay_m - width).min(0.9) / 2.0;
            balcony(mesh, wall, [u[0] - room, u[1] + room], low + 0.02, house);
        }
    }
    if house.mouldings {
        let u = [-0.05, wall.length + 0.05];
        wall.slab(mesh, u, [house.ground_m - 0.1, house.ground_m + 0.08], [0.0, 0.1], house.trim);
    }
    if house.mouldings || house.slope.is_none() {
        let (top, u) = (house.eaves_m(), [-0.05, wall.length + 0.05]);
        wall.slab(mesh, u, [top - 0.28, top - 0.12], [0.0, 0.14], house.trim);
        wall.slab(mesh, u, [top - 0.12, top], [0.0, 0.28], house.trim);
    }
}

/// Adds a facade towards yards, with flat windows.
pub(super) fn yard(mesh: &mut Mesh, wall: &Wall, house: &mut House) {
    blank(mesh, wall, house);
    let bays = ((wall.length - 1.0) / (1.5 * house.bay_m)).floor() as usize;
    let retained: Vec<bool> = (0..bays).map(|_| house.draw.chance(0.8)).collect();
    for floor in 0..house.floors {
        let low = if floor == 0 { 0.0 } else { house.ground_m + (floor - 1) as f64 * house.floor_m };
        for (bay, retained) in retained.iter().enumerate() {
            if *retained {
                let middle = wall.length * (bay as f64 + 0.5) / bays as f64;
                let u = [middle - house.window[0] / 2.0, middle + house.window[0] / 2.0];
                let v = [low + house.sill_m, low + house.sill_m + house.window[1].min(1.5)];
                wall.quad(mesh, u, v, 0.02, house.frame);
                let hole = Opening { u, v, kind: OpeningKind::Window };
                panes(mesh, wall, &hole, 0.035, 1, &mut house.draw);
            }
        }
    }
}

/// Adds a plain wall; only the part above the neighbour is visible.
pub(super) fn blank(mesh: &mut Mesh, wall: &Wall, house: &House) {
    wall.quad(mesh, [0.0, wall.length], [-FOOT_M, house.eaves_m()], 0.0, house.wall);
}

fn ground_floor(mesh: &mut Mesh, wall: &Wall, house: &mut House, bays: usize, front: bool) {
    let bay_m = wall.length / bays as f64;
    let entrance = if front { house.draw.below(bays) } else { bays };
    let mut openings = Vec::new();
    for bay in 0..bays {
        let middle = (bay as f64 + 0.5) * bay_m;
        let hole = |half: f64, v: [f64; 2], kind| Opening { u: [middle - half, middle + half], v, kind };
        openings.push(if bay == entrance {
            let half = (bay_m / 2.0 - 0.3).min(if house.shop { 0.6 } else { 0.52 });
            hole(half, [0.12, 2.35], OpeningKind::Door)
        } else if house.shop {
            hole(bay_m / 2.0 - 0.22, [0.45, house.ground_m - 1.0], OpeningKind::Shop)
        } else {
            let top = (house.sill_m + house.window[1]).min(house.ground_m - 0.35);
            hole(house.window[0].min(bay_m - 0.5) / 2.0, [house.sill_m, top], OpeningKind::Window)
        });
    }
    if let Some(door) = openings.get(entrance) {
        house.door_at = door.u;
    }
    row(mesh, wall, [-FOOT_M, house.ground_m], &openings, house, house.base);
    if house.shop {
        // Shops use the bays on both sides of the house's door.
        for bays in [0..entrance.min(bays), (entrance + 1).min(bays)..bays] {
            let (Some(first), Some(last)) = (openings[bays.clone()].first(), openings[bays].last()) else {
                continue;
            };
            let u = [first.u[0] - 0.1, last.u[1] + 0.1];
            let rgb = house.draw.pick(&SHOPS);
            shop_sign(
                mesh,
                wall,
                u,
                [house.ground_m - 0.85, house.ground_m - 0.25],
                Skin::new(rgb, Surface::Sign),
                house,
            );
            if house.draw.chance(0.45) {
                awning(mesh, wall, u, house.ground_m - 0.95, house);
            }
        }
    } else {
        let plinth = Skin { rgb: house.base.rgb.map(|c| (f64::from(c) * 0.7) as u8), ..house.base };
        let gap =
            openings.get(entrance).map_or([wall.length; 2], |door| [door.u[0] - 0.15, door.u[1] + 0.15]);
        for u in [[0.0, gap[0]], [gap[1], wall.length]] {
            if u[1] - u[0] > 0.05 {
                wall.shelf(mesh, u, [-FOOT_M, 0.42], [0.0, 0.05], plinth);
            }
        }
    }
}

/// Adds a storey of a wall, with openings from left to right.
pub(super) fn row(
    mesh: &mut Mesh,
    wall: &Wall,
    v: [f64; 2],
    openings: &[Opening],
    house: &mut House,
    skin: Skin,
) {
    let mut from = 0.0;
    let alike = openings.windows(2).all(|pair| pair[0].v == pair[1].v);
    if alike && let Some(first) = openings.first() {
        let whole = [0.0, wall.length];
        wall.quad(mesh, whole, [v[0], first.v[0]], 0.0, skin);
        wall.quad(mesh, whole, [first.v[1], v[1]], 0.0, skin);
    }
    for hole in openings {
        let high = if alike { hole.v } else { v };
        wall.quad(mesh, [from, hole.u[0]], high, 0.0, skin);
        from = hole.u[1];
        if !alike {
            wall.quad(mesh, hole.u, [v[0], hole.v[0]], 0.0, skin);
            wall.quad(mesh, hole.u, [hole.v[1], v[1]], 0.0, skin);
        }
        match hole.kind {
            OpeningKind::Window => window(mesh, wall, hole, house),
            OpeningKind::Shop => shop_window(mesh, wall, hole, house),
            OpeningKind::Door => door(mesh, wall, hole, house),
        }
    }
    let high = match openings.first() {
        Some(first) if alike => first.v,
        _ => v,
    };
    wall.quad(mesh, [from, wall.length], high, 0.0, skin);
}

fn window(mesh: &mut Mesh, wall: &Wall, hole: &Opening, house: &mut House) {
    let Opening { u, v, .. } = *hole;
    wall.reveal(mesh, u, v, RECESS_M, house.trim);
    wall.quad(mesh, u, v, -RECESS_M, house.frame);
    panes(mesh, wall, hole, 0.02 - RECESS_M, house.leaves, &mut house.draw);
    // The sill also closes the lower side of the opening.
    wall.shelf(mesh, [u[0] - 0.07, u[1] + 0.07], [v[0] - 0.07, v[0]], [-RECESS_M, 0.09], house.trim);
    if house.lintels {
        wall.quad(mesh, [u[0] - 0.12, u[1] + 0.12], [v[1], v[1] + 0.2], 0.025, house.trim);
    }
    if let Some(skin) = house.shutters {
        let width = (u[1] - u[0]) / 2.0;
        for u in [[u[0] - width, u[0]], [u[1], u[1] + width]] {
            wall.quad(mesh, [u[0] + 0.02, u[1] - 0.02], v, 0.04, skin);
        }
    }
}

fn shop_window(mesh: &mut Mesh, wall: &Wall, hole: &Opening, house: &mut House) {
    wall.reveal(mesh, hole.u, hole.v, RECESS_M, house.frame);
    wall.shelf(mesh, hole.u, [hole.v[0] - 0.05, hole.v[0]], [-RECESS_M, 0.04], house.frame);
    wall.quad(mesh, hole.u, hole.v, -RECESS_M, house.frame);
    let leaves = if hole.u[1] - hole.u[0] > 2.4 { 2 } else { 1 };
    panes(mesh, wall, hole, 0.02 - RECESS_M, leaves, &mut house.draw);
}
