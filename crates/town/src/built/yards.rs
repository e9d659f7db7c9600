use glam::{DVec2, DVec3};
use point_skeleton::hash::noise;

use super::cells::{Cells, Place};
use super::draw::Draw;
use super::ground::GROUND_M;
use super::occupancy::{Occupancy, Occupant};
use super::plants::{Crown, Species, bush, tree};
use super::street_strips::StreetStrips;
use super::style::{District, Style};
use crate::mesh::{Mesh, Skin, Surface};

/// Width of a square that may hold one tree, meters.
const SPACING_M: f64 = 13.0;
/// Extent of trees around the streets, and distance of the hills, meters.
const OUTSIDE_M: f64 = 95.0;
const HILLS_M: f64 = 225.0;

/// Adds trees behind the houses and around the town, and distant hills.
pub(super) fn yards(
    strips: &StreetStrips,
    middle: DVec2,
    style: &Style,
    occupancy: &Occupancy,
    cells: &mut Cells,
) {
    let corners = || strips.kerbs.iter().flat_map(|kerb| &kerb.points).copied();
    let (Some(low), Some(high)) = (corners().reduce(DVec2::min), corners().reduce(DVec2::max)) else {
        return;
    };
    let count = |extent: f64| ((extent + 2.0 * OUTSIDE_M) / SPACING_M).ceil() as i64;
    for i in 0..count(high.x - low.x) {
        for j in 0..count(high.y - low.y) {
            let mut draw = Draw::new(style.seed, &[0x7a4d, i, j]);
            let off = DVec2::new(draw.between(0.0, 1.0), draw.between(0.0, 1.0));
            let place = low - OUTSIDE_M + (DVec2::new(i as f64, j as f64) + off) * SPACING_M;
            plant(place, middle, style, occupancy, cells, &mut draw);
        }
    }
    hills((low + high) / 2.0, (high - low).min_element() / 2.0 + HILLS_M, style, cells);
}

/// Adds a tree or a bush at a position if it is free.
fn plant(
    place: DVec2,
    middle: DVec2,
    style: &Style,
    occupancy: &Occupancy,
    cells: &mut Cells,
    draw: &mut Draw,
) {
    let share = match style.quarter(place, middle) {
        District::Centre => 0.4,
        District::Rows => 0.5,
        District::Gardens => 0.55,
    };
    let groves = noise(style.seed ^ 0x99, place.x / 45.0, place.y / 45.0);
    let square = |half: f64| super::sketch::corners(place - half, place + half);
    if !draw.chance(share * 1.6 * groves) || !occupancy.is_free(&square(1.2)) {
        return;
    }
    let at = Place { at: place.extend(GROUND_M), yaw_rad: draw.between(0.0, std::f64::consts::TAU) };
    let rgb = draw.pick(style.leaves);
    let crown = Crown::new(draw.shade(rgb, 0.15), draw.seed());
    let near_house = occupancy.meets(&square(3.2)).any(|taken| taken == Occupant::House);
    if near_house || draw.chance(0.15) {
        let mut mesh = Mesh::default();
        bush(&mut mesh, DVec3::ZERO, draw.between(0.6, 1.1), crown);
        cells.stand(&mesh, at);
        return;
    }
    let height = draw.between(5.5, 10.0);
    let (species, wide) = match draw.below(6) {
        0 => (Species::Slender, 0.17),
        1 | 2 if groves > 0.5 => (Species::Conifer, 0.24),
        _ => (Species::Broad, 0.33),
    };
    let crown = if species == Species::Conifer {
        Crown::new(draw.shade([52, 82, 56], 0.15), draw.seed())
    } else {
        crown
    };
    cells.stand(&tree(species, height, wide * height, crown, false), at);
}

/// Adds a ring of wooded hills as a background at the ends of streets.
fn hills(centre: DVec2, radius: f64, style: &Style, cells: &mut Cells) {
    let count = (std::f64::consts::TAU * (radius + 45.0) / 40.0).ceil() as i64;
    let corner = |i: i64, ring: usize| {
        let turn = std::f64::consts::TAU * (i % count) as f64 / count as f64;
        let height =
            [-1.0, 10.0 + 30.0 * noise(style.seed ^ 0x4111, 3.0 * turn.cos() + 9.0, 3.0 * turn.sin() + 9.0)];
        (centre + DVec2::from_angle(turn) * (radius + 45.0 * ring as f64)).extend(GROUND_M + height[ring])
    };
    let skin = Skin::new(style.leaves[0].map(|c| (f64::from(c) * 0.9) as u8), Surface::Foliage);
    for i in 0..count {
        let face = [corner(i + 1, 0), corner(i, 0), corner(i, 1), corner(i + 1, 1)];
        let face = face.map(|p| {
            let inwards = (centre - p.truncate()).normalize_or_zero();
            (
                p,
                (inwards * 0.5).extend(0.87).normalize_or(DVec3::Z),
                DVec2::new(p.x + 0.6 * p.y, p.z - 0.4 * p.y),
            )
        });
        let mut mesh = Mesh::default();
        mesh.fan(&face, skin);
        cells.add_large(mesh);
    }
}
