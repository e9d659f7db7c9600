use glam::{DVec2, DVec3};

use super::facade::FOOT_M;
use super::openings::{Opening, OpeningKind, panes};
use super::properties::{House, walls};
use crate::built::sketch::{Wall, column, corners};
use crate::mesh::{Mesh, Skin, Surface};

/// Adds a church: a nave with a steep roof behind a tower with a spire.
pub(super) fn church(mesh: &mut Mesh, house: &mut House) {
    let (w, d, eaves) = (house.width, house.depth, 7.5);
    house.wall.surface = house.draw.pick(&[Surface::Plaster, Surface::Brick, Surface::Concrete]);
    let nave = walls(w, d).map(|wall| Wall::new(wall.at(0.0, 0.0, 0.0), wall.at(wall.length, 0.0, 0.0)));
    for (i, wall) in nave.iter().enumerate() {
        let wall = if i == 0 { wall.moved(0.0, 0.0, -5.0) } else { *wall };
        let u = match i {
            1 => [5.0, d],
            3 => [0.0, d - 5.0],
            _ => [0.0, w],
        };
        wall.quad(mesh, u, [-FOOT_M, eaves], 0.0, house.wall);
        if i % 2 == 1 {
            for k in 0..5 {
                let middle = u[0] + (u[1] - u[0]) * (f64::from(k) + 0.5) / 5.0;
                pointed(mesh, &wall, middle, [2.2, 5.6], house);
                let edge = u[0] + (u[1] - u[0]) * f64::from(k) / 5.0;
                wall.slab(mesh, [edge - 0.3, edge + 0.3], [-FOOT_M, 5.8], [0.0, 0.6], house.trim);
            }
        }
    }
    let ridge = eaves + w / 2.0 * 1.1;
    for (wall, from, to) in [(nave[1], 4.8, d + 0.2), (nave[3], -0.2, d - 4.8)] {
        let face = [
            [from, eaves - 0.3, 0.4],
            [to, eaves - 0.3, 0.4],
            [to, ridge, -w / 2.0],
            [from, ridge, -w / 2.0],
        ];
        wall.polygon(mesh, &face, house.roof);
        wall.polygon(
            mesh,
            &[[from, eaves, 0.0], [to, eaves, 0.0], [to, eaves - 0.3, 0.4], [from, eaves - 0.3, 0.4]],
            house.trim,
        );
    }
    let gable = [[0.0, eaves], [w, eaves], [w / 2.0, ridge]];
    nave[0].moved(0.0, 0.0, -5.0).shape(mesh, &gable, 0.0, house.wall);
    nave[2].shape(mesh, &gable, 0.0, house.wall);
    tower(mesh, house, ridge + 5.0);
}

/// Adds the tower in front of the nave; its portal faces the street.
fn tower(mesh: &mut Mesh, house: &mut House, top: f64) {
    let (low, high) = (DVec2::new(house.width / 2.0 - 3.2, 0.0), DVec2::new(house.width / 2.0 + 3.2, 6.4));
    let around = corners(low, high);
    column(mesh, around, [-FOOT_M, top], house.wall);
    let wall = |i: usize| Wall::new(around[i].extend(0.0), around[(i + 1) % 4].extend(0.0));
    for side in [0, 1, 2, 3].map(wall) {
        for v in [[top - 4.2, top - 1.2], [7.0, 9.0]] {
            pointed(mesh, &side, side.length / 2.0, v, house);
        }
        for v in [6.0, top - 5.2, top - 0.3] {
            side.slab(mesh, [-0.12, side.length + 0.12], [v, v + 0.3], [0.0, 0.15], house.trim);
        }
    }
    let front = wall(0);
    let middle = front.length / 2.0;
    front.slab(mesh, [middle - 1.6, middle + 1.6], [-0.1, 0.15], [0.0, 1.2], house.trim);
    front.quad(mesh, [middle - 1.5, middle + 1.5], [0.0, 3.6], 0.03, house.trim);
    front.quad(mesh, [middle - 1.1, middle + 1.1], [0.15, 3.1], 0.05, house.door);
    let clock = front.at(middle, top - 6.2, 0.06);
    let dial = Skin::new([232, 228, 214], Surface::Plain);
    crate::built::sketch::disc(mesh, clock, DVec3::NEG_Y, 0.75, 16, dial);
    let tip = ((low + high) / 2.0).extend(top + 9.0);
    for i in 0..4 {
        mesh.polygon(&[around[i].extend(top), around[(i + 1) % 4].extend(top), tip], house.roof);
    }
    let cross = Skin::new([206, 176, 84], Surface::Metal);
    mesh.block(tip - DVec3::new(0.05, 0.05, 0.3), tip + DVec3::new(0.05, 0.05, 1.4), cross);
    mesh.block(tip + DVec3::new(-0.4, -0.05, 0.8), tip + DVec3::new(0.4, 0.05, 0.9), cross);
}

/// Adds a tall window with a pointed top.
fn pointed(mesh: &mut Mesh, wall: &Wall, middle: f64, v: [f64; 2], house: &mut House) {
    let half = 0.6;
    let outline = |half: f64, v: [f64; 2]| {
        let shoulder = v[1] - half;
        [
            [middle - half, v[0]],
            [middle + half, v[0]],
            [middle + half, shoulder],
            [middle, v[1]],
            [middle - half, shoulder],
        ]
    };
    wall.shape(mesh, &outline(half + 0.15, [v[0] - 0.15, v[1] + 0.2]), 0.03, house.trim);
    let hole =
        Opening { u: [middle - half, middle + half], v: [v[0], v[1] - half], kind: OpeningKind::Window };
    wall.shape(mesh, &outline(half, v), 0.045, house.frame);
    panes(mesh, wall, &hole, 0.06, 2, &mut house.draw);
}
