use glam::DVec2;

use super::line::Line;
use crate::plan::{Junction, JunctionEdge, Network};

/// Streets as strips: a line along each road, and all kerbs with the sidewalks behind them.
#[derive(Debug)]
pub(super) struct StreetStrips<'a> {
    /// Source network.
    pub(super) network: &'a Network,
    /// Line along each road; `None` if a road has no length.
    pub(super) lines: Vec<Option<Line>>,
    /// Kerbs of roads and junctions.
    pub(super) kerbs: Vec<Kerb>,
}

/// Kerb with the road on its left and the sidewalk on its right.
#[derive(Debug)]
pub(super) struct Kerb {
    /// Edge of the road.
    pub(super) points: Vec<DVec2>,
    /// Offset vectors away from the road, scaled so that offset edges remain parallel.
    pub(super) outs: Vec<DVec2>,
    /// Width of the sidewalk at each point, meters.
    pub(super) widths_m: Vec<f64>,
}

impl Kerb {
    /// Returns point `i` moved into the sidewalk by `inwards_m`, limited to its width.
    pub(super) fn point(&self, i: usize, inwards_m: f64) -> DVec2 {
        self.points[i] + self.outs[i] * inwards_m.min(self.widths_m[i])
    }

    /// Returns point `i` of the sidewalk's back edge, moved towards the road by `less_m`.
    pub(super) fn back(&self, i: usize, less_m: f64) -> DVec2 {
        self.points[i] + self.outs[i] * (self.widths_m[i] - less_m).max(0.0)
    }
}

impl<'a> StreetStrips<'a> {
    pub(super) fn new(network: &'a Network) -> Self {
        let lines: Vec<Option<Line>> = network.roads.iter().map(|road| Line::new(&road.centerline)).collect();
        let mut kerbs = Vec::new();
        for (road, line) in network.roads.iter().zip(&lines) {
            let Some(line) = line else { continue };
            for left in [-1.0, 1.0] {
                let point = |s: &f64| line.point(*s, left * road.half_width_m);
                let out = |s: &f64| {
                    (line.point(*s, left * (road.half_width_m + 1.0)) - point(s)).normalize_or(DVec2::X)
                };
                let mut points: Vec<DVec2> = line.stations().iter().map(point).collect();
                let mut outs: Vec<DVec2> = line.stations().iter().map(out).collect();
                if left > 0.0 {
                    points.reverse();
                    outs.reverse();
                }
                kerbs.push(Kerb { widths_m: vec![road.sidewalk_m; points.len()], points, outs });
            }
        }
        kerbs.extend(network.junctions.iter().flat_map(|junction| junction_kerbs(network, junction)));
        Self { network, lines, kerbs }
    }

    /// Returns the area of all streets as convex counter-clockwise polygons; sidewalks are narrowed by
    /// `less_m` at the back.
    pub(super) fn areas(&self, less_m: f64) -> Vec<Vec<DVec2>> {
        let mut areas = Vec::new();
        for (road, line) in self.network.roads.iter().zip(&self.lines) {
            let (Some(line), half) = (line, road.half_width_m) else { continue };
            for s in line.stations().windows(2) {
                let corner = |i: usize, left: f64| line.point(s[i], left * half);
                areas.push(vec![corner(0, -1.0), corner(1, -1.0), corner(1, 1.0), corner(0, 1.0)]);
            }
        }
        for junction in &self.network.junctions {
            let outline = &junction.outline;
            let next = |i: usize| outline[(i + 1) % outline.len()];
            areas.extend((0..outline.len()).map(|i| vec![junction.centre, outline[i], next(i)]));
        }
        for kerb in &self.kerbs {
            for i in 1..kerb.points.len() {
                let (a, b, c, d) =
                    (kerb.points[i - 1], kerb.back(i - 1, less_m), kerb.back(i, less_m), kerb.points[i]);
                areas.extend([vec![a, b, c], vec![a, c, d]]);
            }
        }
        areas.retain_mut(|area| {
            let twice = area_twice(area);
            if twice < 0.0 {
                area.reverse();
            }
            twice.abs() > 1e-6
        });
        areas
    }
}

/// Returns twice the area of a polygon, m²; positive if counter-clockwise.
pub(super) fn area_twice(polygon: &[DVec2]) -> f64 {
    let next = |i: usize| polygon[(i + 1) % polygon.len()];
    (0..polygon.len()).map(|i| polygon[i].perp_dot(next(i))).sum()
}

/// Returns the kerbs between the road mouths of a junction.
fn junction_kerbs(network: &Network, junction: &Junction) -> Vec<Kerb> {
    let count = junction.outline.len().min(junction.edges.len());
    let edge = |i: usize| junction.edges[i % count];
    let corner = |i: usize| junction.outline[i % count];
    let mouths: Vec<usize> = (0..count).filter(|i| edge(*i) != JunctionEdge::Kerb).collect();
    if mouths.is_empty() {
        let whole: Vec<DVec2> = (0..=count).map(corner).collect();
        return if count < 3 { Vec::new() } else { vec![kerb(whole, [None; 2], [junction.sidewalk_m; 2])] };
    }
    let mut kerbs = Vec::new();
    for (k, &first) in mouths.iter().enumerate() {
        let last = mouths.get(k + 1).copied().unwrap_or(mouths[0] + count);
        let points: Vec<DVec2> = (first + 1..=last).map(corner).collect();
        if points.len() < 2 {
            continue;
        }
        let mouth = |i: usize| (corner(i + 1) - corner(i)).normalize_or_zero();
        let width = |i: usize| match edge(i) {
            JunctionEdge::Road(road) => network.roads.get(road).map_or(junction.sidewalk_m, |r| r.sidewalk_m),
            JunctionEdge::Kerb => junction.sidewalk_m,
        };
        kerbs.push(kerb(points, [Some(mouth(first)), Some(-mouth(last))], [width(first), width(last)]));
    }
    kerbs
}

/// Returns a kerb, optionally with given edges across the sidewalk at its ends; the width is interpolated
/// linearly.
fn kerb(points: Vec<DVec2>, ends: [Option<DVec2>; 2], widths_m: [f64; 2]) -> Kerb {
    let out = |i: usize| -(points[i + 1] - points[i]).normalize_or_zero().perp();
    let last = points.len() - 1;
    let outs = (0..=last).map(|i| {
        let given = if i == 0 {
            ends[0]
        } else if i == last {
            ends[1]
        } else {
            None
        };
        let (before, after) = (out(if i == 0 { 0 } else { i - 1 }), out(i.min(last - 1)));
        given.unwrap_or_else(|| {
            let middle = (before + after).normalize_or(after);
            middle / middle.dot(after).max(0.6)
        })
    });
    let outs = outs.collect();
    let mut at = vec![0.0];
    for pair in points.windows(2) {
        at.push(at[at.len() - 1] + pair[0].distance(pair[1]));
    }
    let whole = at[last].max(1e-9);
    let widths_m = at.iter().map(|s| widths_m[0] + (widths_m[1] - widths_m[0]) * s / whole).collect();
    Kerb { points, outs, widths_m }
}
