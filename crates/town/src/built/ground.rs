use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::float::single::SingleFloatOverlay;
use i_triangle::float::triangulatable::Triangulatable;
use i_triangle::float::triangulation::RawTriangulation;

use super::cells::{CELL_M, Cells, cell_of};
use super::street_strips::{Kerb, StreetStrips, area_twice};
use super::style::Style;
use crate::mesh::{Mesh, Skin, Surface};
use crate::plan::KERB_M;

/// Height of lawns and yards, meters: slightly below the sidewalks.
pub(super) const GROUND_M: f64 = KERB_M - 0.02;
/// Width of the kerb stones, meters.
const STONE_M: f64 = 0.16;
/// Extent of the ground beyond the streets, meters.
const AROUND_M: f64 = 260.0;
/// Overlap of the ground with the sidewalks above it, meters.
const BELOW_M: f64 = 0.2;

/// Adds roads, junctions, kerbs, sidewalks, and the ground between them.
pub(super) fn ground(strips: &StreetStrips, style: &Style, cells: &mut Cells) {
    let asphalt = Skin::new(style.asphalt, Surface::Asphalt);
    for (road, line) in strips.network.roads.iter().zip(&strips.lines) {
        let Some(line) = line else { continue };
        for s in line.stations().windows(2) {
            let corner = |i: usize, left: f64| line.point(s[i], left * road.half_width_m);
            let corners = [corner(0, -1.0), corner(1, -1.0), corner(1, 1.0), corner(0, 1.0)];
            flat(cells.near(line.point((s[0] + s[1]) / 2.0, 0.0)), &corners, 0.0, asphalt);
        }
    }
    for junction in &strips.network.junctions {
        let outline: Vec<[f64; 2]> = junction.outline.iter().map(|p| p.to_array()).collect();
        triangles(&outline.triangulate(), |corners| {
            flat(cells.near(corners.iter().sum::<DVec2>() / 3.0), &corners, 0.0, asphalt);
        });
    }
    for kerb in &strips.kerbs {
        sidewalk(kerb, style, cells);
    }
    between(strips, style, cells);
}

/// Calls `each` with the triangles of a triangulation, counter-clockwise.
fn triangles(of: &RawTriangulation<[f64; 2]>, mut each: impl FnMut([DVec2; 3])) {
    let (points, indices) = (of.points(), of.triangle_indices::<u32>());
    for corners in indices.chunks_exact(3) {
        each(std::array::from_fn(|i| DVec2::from(points[corners[i] as usize])));
    }
}

/// Adds a convex polygon on the ground, counter-clockwise seen from above; its pattern is continuous across
/// the town.
pub(super) fn flat(mesh: &mut Mesh, corners: &[DVec2], z: f64, skin: Skin) {
    let corners: Vec<(DVec3, DVec3, DVec2)> = corners.iter().map(|p| (p.extend(z), DVec3::Z, *p)).collect();
    mesh.fan(&corners, skin);
}

/// Adds the face and the stones of a kerb, the slabs behind it, and their back edge.
fn sidewalk(kerb: &Kerb, style: &Style, cells: &mut Cells) {
    let stone = Skin::new(style.kerb, Surface::Concrete);
    let slabs = Skin::new(style.slabs, Surface::Sidewalk);
    let mut along = 0.0;
    for i in 1..kerb.points.len() {
        let (a, b) = (kerb.points[i - 1], kerb.points[i]);
        let s = [along, along + a.distance(b)];
        along = s[1];
        let mesh = cells.near((a + b) / 2.0);
        let strip = |mesh: &mut Mesh, from: f64, to: f64, skin: Skin| {
            let corner = |i: usize, s: f64, inwards: f64| {
                (kerb.point(i, inwards).extend(KERB_M), DVec3::Z, DVec2::new(s, inwards))
            };
            let corners = [(i - 1, s[0], from), (i - 1, s[0], to), (i, s[1], to), (i, s[1], from)];
            mesh.fan(&corners.map(|(i, s, inwards)| corner(i, s, inwards)), skin);
        };
        strip(mesh, 0.0, STONE_M, stone);
        strip(mesh, STONE_M, kerb.widths_m[i - 1].max(kerb.widths_m[i]), slabs);
        let upright = |mesh: &mut Mesh, ends: [DVec2; 2], z: [f64; 2]| {
            mesh.polygon(
                &[ends[0].extend(z[0]), ends[1].extend(z[0]), ends[1].extend(z[1]), ends[0].extend(z[1])],
                stone,
            );
        };
        upright(mesh, [b, a], [0.0, KERB_M]);
        upright(mesh, [kerb.back(i - 1, 0.0), kerb.back(i, 0.0)], [GROUND_M - 0.03, KERB_M]);
    }
}

/// Adds the ground that no street covers, cell by cell.
fn between(strips: &StreetStrips, style: &Style, cells: &mut Cells) {
    let areas = strips.areas(BELOW_M);
    let mut low = DVec2::splat(f64::INFINITY);
    let mut high = DVec2::splat(f64::NEG_INFINITY);
    let mut holes: BTreeMap<[i64; 2], Vec<Vec<[f64; 2]>>> = BTreeMap::new();
    for area in &areas {
        let min = area.iter().copied().reduce(DVec2::min).unwrap_or_default();
        let max = area.iter().copied().reduce(DVec2::max).unwrap_or_default();
        (low, high) = (low.min(min), high.max(max));
        let (from, to) = (cell_of(min), cell_of(max));
        for x in from[0]..=to[0] {
            for y in from[1]..=to[1] {
                holes.entry([x, y]).or_default().push(area.iter().map(|p| p.to_array()).collect());
            }
        }
    }
    if !(low.is_finite() && high.is_finite()) {
        return;
    }
    let (from, to) = (cell_of(low - AROUND_M), cell_of(high + AROUND_M));
    for x in from[0]..=to[0] {
        for y in from[1]..=to[1] {
            let (min, max) = (
                DVec2::new(x as f64, y as f64) * CELL_M,
                DVec2::new(x as f64 + 1.0, y as f64 + 1.0) * CELL_M,
            );
            let square = [[min.x, min.y], [max.x, min.y], [max.x, max.y], [min.x, max.y]];
            let lawn = Skin::new(style.lawn, Surface::Grass);
            let mesh = cells.mesh([x, y]);
            let Some(holes) = holes.get(&[x, y]) else {
                flat(mesh, &square.map(DVec2::from), GROUND_M, lawn);
                continue;
            };
            for shape in square.overlay(holes, OverlayRule::Difference, FillRule::NonZero) {
                // Neighbouring pieces of streets may leave slivers between them.
                let outer: Vec<DVec2> = shape.iter().take(1).flatten().map(|p| DVec2::from(*p)).collect();
                if area_twice(&outer).abs() < 0.1 {
                    continue;
                }
                triangles(&shape.triangulate(), |corners| flat(mesh, &corners, GROUND_M, lawn));
            }
        }
    }
}
