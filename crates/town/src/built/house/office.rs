use super::extras::SHOPS;
use super::facade::{self, FOOT_M};
use super::openings::{Opening, OpeningKind, panes};
use super::properties::House;
use super::roof;
use crate::built::lots::Side;
use crate::built::sketch::Wall;
use crate::mesh::{Mesh, Skin, Surface};

/// Spacing of the mullions in glass bands, meters.
const MULLION_M: f64 = 2.7;

/// Adds an office: a large building with bands of glass and a flat roof.
pub(super) fn office(mesh: &mut Mesh, house: &mut House) {
    house.floors = 4 + house.draw.below(4);
    house.ground_m = 4.2;
    house.floor_m = 3.4;
    house.slope = None;
    house.wall.surface = house.draw.pick(&[Surface::Concrete, Surface::Plaster, Surface::Plain]);
    house.wall.rgb =
        house.draw.pick(&[[186, 186, 182], [120, 124, 130], [206, 200, 188], [86, 92, 100], [160, 142, 124]]);
    house.frame = Skin::new(house.draw.pick(&[[60, 62, 66], [196, 198, 200]]), Surface::Metal);
    let glassy = house.draw.chance(0.4);
    for (i, wall) in house.walls().into_iter().enumerate() {
        if house.sides[i] == Side::Party {
            facade::blank(mesh, &wall, house);
            continue;
        }
        let bars = (wall.length / MULLION_M).floor().max(1.0) as usize;
        lobby(mesh, &wall, house, bars, i == 0);
        for floor in 1..house.floors {
            let low = house.ground_m + (floor - 1) as f64 * house.floor_m;
            let v = if glassy {
                [low + 0.25, low + house.floor_m - 0.1]
            } else {
                [low + 0.95, low + house.floor_m - 0.45]
            };
            wall.quad(mesh, [0.0, wall.length], [low, v[0]], 0.0, house.wall);
            wall.quad(mesh, [0.0, wall.length], [v[1], low + house.floor_m], 0.0, house.wall);
            band(mesh, &wall, v, bars, house);
        }
    }
    roof::roof(mesh, house);
}

/// Adds a slightly recessed band of glass between two heights.
fn band(mesh: &mut Mesh, wall: &Wall, v: [f64; 2], bars: usize, house: &mut House) {
    let edge = 0.35;
    wall.quad(mesh, [0.0, edge], v, 0.0, house.wall);
    wall.quad(mesh, [wall.length - edge, wall.length], v, 0.0, house.wall);
    let inner = [edge, wall.length - edge];
    wall.reveal(mesh, inner, v, 0.15, house.frame);
    wall.shelf(mesh, inner, [v[0] - 0.06, v[0]], [-0.15, 0.05], house.frame);
    wall.quad(mesh, inner, v, -0.15, house.frame);
    let step = (inner[1] - inner[0]) / bars as f64;
    for i in 0..bars {
        let u = [edge + step * i as f64, edge + step * (i + 1) as f64];
        panes(mesh, wall, &Opening { u, v, kind: OpeningKind::Window }, -0.12, 1, &mut house.draw);
        if i > 0 {
            wall.slab(mesh, [u[0] - 0.04, u[0] + 0.04], v, [-0.15, 0.02], house.frame);
        }
    }
}

/// Adds the ground floor: glass almost from floor to ceiling, and at the front a canopy with a sign.
fn lobby(mesh: &mut Mesh, wall: &Wall, house: &mut House, bars: usize, front: bool) {
    let v = [0.15, house.ground_m - 0.7];
    wall.quad(mesh, [0.0, wall.length], [-FOOT_M, v[0]], 0.0, house.base);
    wall.quad(mesh, [0.0, wall.length], [v[1], house.ground_m], 0.0, house.wall);
    band(mesh, wall, v, bars, house);
    if front {
        let middle = wall.length / 2.0;
        wall.slab(mesh, [middle - 3.0, middle + 3.0], [2.9, 3.1], [0.0, 1.4], house.frame);
        let sign = Skin {
            rgb: house.draw.pick(&SHOPS),
            surface: Surface::Sign,
            seed: house.draw.seed() as u32 & 0xff_ffff,
        };
        let local = wall.moved(middle - 2.4, house.ground_m - 0.6, 0.0);
        local.slab(mesh, [0.0, 4.8], [0.0, 0.6], [0.0, 0.08], sign);
    }
}
