//! Hull of a vehicle: cross sections, one at each `x`.
//!
//! # How it works
//! A section is [`ROWS`] points of the left side, from the middle of the underside over sill, shoulder,
//! window and roof edge to the middle of the top. All sections have the same rows, so rows from nose to tail
//! bound hood, windows, pillars and roof. Wheel arches raise the underside.

use glam::DVec3;

use super::curve::Curve;
use crate::mesh::{Mesh, Skin};

/// Point count of a section.
pub(super) const ROWS: usize = 12;

/// Rows of a section (see the module).
pub(super) mod row {
    pub(in super::super) const SILL: usize = 2;
    pub(in super::super) const MIDDLE: usize = 3;
    pub(in super::super) const HIGH: usize = 4;
    pub(in super::super) const SHOULDER: usize = 5;
    pub(in super::super) const GLASS_LOW: usize = 6;
    pub(in super::super) const GLASS_HIGH: usize = 7;
    pub(in super::super) const RAIL: usize = 8;
    pub(in super::super) const ROOF_EDGE: usize = 9;
}

/// Wheel arch in the underside, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arch {
    pub(super) x: f64,
    /// Height of the axle.
    pub(super) z: f64,
    pub(super) radius: f64,
}

/// Open cargo bed in the top, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bed {
    pub(super) rear: f64,
    pub(super) front: f64,
    pub(super) floor: f64,
}

/// Front or rear end of the hull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct End {
    pub(super) x: f64,
    /// Bulge of its middle, meters.
    pub(super) bow: f64,
    /// Share of the width that it narrows over `taper_m`.
    pub(super) taper: f64,
    pub(super) taper_m: f64,
    /// Rise of the underside at the end, meters.
    pub(super) lift: f64,
    /// Height of the shoulder line.
    pub(super) belt: f64,
}

/// Hull of a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shell {
    pub(super) rear: End,
    pub(super) front: End,
    pub(super) half_width: f64,
    /// Height along the middle.
    pub(super) top: Curve,
    /// Height of the underside.
    pub(super) under: f64,
    /// Inward lean of windows, meters per meter of height.
    pub(super) tumble: f64,
    /// Bulge of fenders, meters.
    pub(super) flare: f64,
    pub(super) arches: Vec<Arch>,
    pub(super) bed: Option<Bed>,
}

/// Minimum height of the top above the shoulder, meters.
const EDGE_M: f64 = 0.07;

/// Offset of patch borders from the hull, meters; negative is inside.
const SUNK_M: f64 = -0.004;

impl Shell {
    /// Returns the left half of the section at `x`.
    pub(super) fn section(&self, x: f64) -> [DVec3; ROWS] {
        let (under, top) = (self.under(x), self.top.at(x));
        let shoulder = self.shoulder(x).max(under + 0.05);
        let width = self.half_width_at(x);
        let side = |share: f64| {
            let z = under + (shoulder - under) * share;
            (width * self.barrel(z), z)
        };
        let rise = (top - shoulder).max(0.02);
        let roof_edge = top - (0.08 * rise).min(0.045);
        let rail = roof_edge - (0.07 * rise).min(0.05);
        let glass_high = rail - (0.10 * rise).min(0.06);
        let glass_low = shoulder + (0.2 * rise).min(0.03);
        let [(low, low_z), (middle, middle_z), (high, high_z)] = [side(0.1), side(0.42), side(0.72)];
        let (belt, _) = side(1.0);
        let pane = belt - 0.016;
        let pane_high = pane - 0.01 - self.tumble * (glass_high - glass_low);
        let rail_y = pane_high - 0.015 - self.tumble * (rail - glass_high);
        let bed = self.bed.filter(|bed| (bed.rear..=bed.front).contains(&x));
        let (edge, edge_z, top) = match bed {
            Some(bed) => (rail_y - 0.02, bed.floor, bed.floor),
            None => (rail_y - 0.055, roof_edge, top),
        };
        [
            [0.0, under],
            [low - 0.05, under],
            [low, low_z],
            [middle, middle_z],
            [high, high_z],
            [belt, shoulder],
            [pane, glass_low],
            [pane_high, glass_high],
            [rail_y, rail],
            [edge, edge_z],
            [edge * 0.52, edge_z + (top - edge_z) * 0.76],
            [0.0, top],
        ]
        .map(|[y, z]| DVec3::new(x, y, z))
    }

    /// Returns the height of the shoulder line at `x`.
    pub(super) fn shoulder(&self, x: f64) -> f64 {
        let share = (x - self.rear.x) / (self.front.x - self.rear.x);
        let belt = self.rear.belt + (self.front.belt - self.rear.belt) * share;
        let most = self.top.at(x) - EDGE_M;
        // Smooth minimum of both.
        (belt + most - (belt - most).hypot(0.03)) / 2.0
    }

    /// Returns half the width at `x`, at the widest height.
    pub(super) fn half_width_at(&self, x: f64) -> f64 {
        let narrow = |end: &End| {
            let away = (x - end.x).abs();
            let near = (1.0 - away / end.taper_m).max(0.0).powf(2.2);
            let corner = (1.0 - away / 0.12).max(0.0).powi(2);
            1.0 - end.taper * near - 0.04 * corner
        };
        let flare = self.arches.iter().map(|a| (-((x - a.x) / (1.2 * a.radius)).powi(4)).exp());
        let flare = self.flare * flare.fold(0.0, f64::max);
        (self.half_width - self.flare + flare) * narrow(&self.rear) * narrow(&self.front)
    }

    /// Returns the share of the width at a height: sides curve inward at the bottom and the top.
    fn barrel(&self, z: f64) -> f64 {
        let belt = self.rear.belt.max(self.front.belt);
        let widest = 0.62 * belt;
        if z < widest {
            1.0 - 0.09 * ((widest - z) / widest).powi(2)
        } else {
            1.0 - 0.035 * ((z - widest) / (belt - widest)).powi(2)
        }
    }

    fn under(&self, x: f64) -> f64 {
        let lift = |end: &End| end.lift * (1.0 - (x - end.x).abs() / 0.45).max(0.0).powi(2);
        let plain = self.under + lift(&self.rear) + lift(&self.front);
        let arch = |a: &Arch| {
            let square = a.radius * a.radius - (x - a.x).powi(2);
            // Tolerates rounding errors, which would close the arch at its ends.
            if square > -1e-9 { a.z + square.max(0.0).sqrt() } else { 0.0 }
        };
        self.arches.iter().map(arch).fold(plain, f64::max)
    }

    /// Returns the positions of the sections: at `edges`, at arches and ends, and at bends of the top unless
    /// another is near.
    pub(super) fn stations(&self, edges: &[f64]) -> Vec<f64> {
        let mut exact: Vec<f64> = edges.to_vec();
        exact.extend([self.rear.x, self.front.x]);
        for arch in &self.arches {
            let r = arch.radius;
            let offsets = [1.0, 0.88, 0.42].map(|share| share * r);
            exact.extend(offsets.iter().chain(&[r + 0.012]).flat_map(|o| [arch.x - o, arch.x + o]));
        }
        if let Some(bed) = self.bed {
            exact.extend([bed.rear, bed.rear - 0.012, bed.front, bed.front + 0.012]);
        }
        exact.retain(|x| (self.rear.x..=self.front.x).contains(x));
        exact.sort_by(f64::total_cmp);
        exact.dedup_by(|a, b| *a - *b < 0.004);
        let ends = [(self.rear.x, 1.0), (self.front.x, -1.0)];
        let ends = ends.into_iter().flat_map(|(x, s)| [0.04, 0.14, 0.35].map(|away| x + s * away));
        let (first, last) = (self.rear.x, self.front.x);
        for x in self.top.bends().chain(ends).filter(|x| (first..=last).contains(x)) {
            if exact.iter().all(|other| (other - x).abs() > 0.09) {
                exact.push(x);
            }
        }
        exact.sort_by(f64::total_cmp);
        exact
    }

    /// Returns the left half without ends. `skin` takes the middle between two sections and the lower row.
    pub(super) fn hull(&self, stations: &[f64], skin: impl Fn(f64, usize) -> Skin) -> Mesh {
        let sections: Vec<[DVec3; ROWS]> = stations.iter().map(|x| self.section(*x)).collect();
        let mut mesh = Mesh::default();
        mesh.loft(&sections, |i, j| Some(skin((stations[i] + stations[i + 1]) / 2.0, j)));
        mesh
    }

    /// Returns the left half of an end. `skin` takes the lower row and the position between middle (0) and
    /// side (1).
    pub(super) fn cap(&self, front: bool, skin: impl Fn(usize, f64) -> Skin) -> Mesh {
        let end = if front { &self.front } else { &self.rear };
        let section = self.section(end.x);
        let columns = cap_columns(&section);
        let lines: Vec<Vec<DVec3>> = (1..=row::ROOF_EDGE)
            .map(|row| columns.iter().map(|c| self.on_cap(front, &section, row, *c)).collect())
            .collect();
        let mut mesh = Mesh::default();
        let lines: Vec<Vec<DVec3>> = match front {
            true => lines,
            false => lines
                .into_iter()
                .map(|mut line| {
                    line.reverse();
                    line
                })
                .collect(),
        };
        let last = columns.len() - 2;
        mesh.loft(&lines, |i, j| {
            let j = if front { j } else { last - j };
            Some(skin(i + 1, (columns[j] + columns[j + 1]) / 2.0))
        });
        mesh
    }

    /// Returns the point of an end at a row and a share of the half width; row [`row::ROOF_EDGE`] is the
    /// upper rim.
    fn on_cap(&self, front: bool, section: &[DVec3; ROWS], row: usize, c: f64) -> DVec3 {
        let (end, sign) = if front { (&self.front, 1.0) } else { (&self.rear, -1.0) };
        let [low, high] = [section[1].z, section[row::RAIL].z];
        if row >= row::ROOF_EDGE {
            let rail = &section[row::RAIL];
            return DVec3::new(end.x, rail.y * c, rim_height(section, rail.y * c));
        }
        let up = (section[row].z - low) / (high - low);
        let bow = end.bow * (1.0 - c * c) * (1.0 - (2.0 * up - 1.0).powi(4));
        DVec3::new(end.x + sign * bow, section[row].y * c, section[row].z)
    }

    /// Returns the `x` of an end's middle at a height, meters.
    pub(super) fn cap_x(&self, front: bool, z: f64) -> f64 {
        let (end, sign) = if front { (&self.front, 1.0) } else { (&self.rear, -1.0) };
        let section = self.section(end.x);
        let up = ((z - section[1].z) / (section[row::RAIL].z - section[1].z)).clamp(0.0, 1.0);
        end.x + sign * end.bow * (1.0 - (2.0 * up - 1.0).powi(4))
    }

    /// Returns a panel offset from the left side, between two rows, at the given `xs`; its borders descend
    /// into the hull.
    pub(super) fn patch(&self, xs: &[f64], rows: [usize; 2], out: f64, skin: Skin) -> Mesh {
        let (Some(first), Some(last)) = (xs.first(), xs.last()) else { return Mesh::default() };
        let line = |(x, out): (f64, f64)| -> Vec<DVec3> {
            let section = self.section(x);
            let place = |(k, out): (usize, f64)| {
                let along = section[k + 1] - section[k - 1];
                section[k] + DVec3::new(0.0, along.z, -along.y).normalize_or_zero() * out
            };
            let inner = (rows[0]..=rows[1]).map(|k| (k, out));
            std::iter::once((rows[0], SUNK_M)).chain(inner).chain([(rows[1], SUNK_M)]).map(place).collect()
        };
        let inner = xs.iter().map(|x| (*x, out));
        let places = std::iter::once((*first, SUNK_M)).chain(inner).chain([(*last, SUNK_M)]);
        let mut mesh = Mesh::default();
        mesh.loft(&places.map(line).collect::<Vec<_>>(), |_, _| Some(skin));
        mesh
    }
}

/// Returns shares of the half width, including the corners of the upper rim.
fn cap_columns(section: &[DVec3; ROWS]) -> [f64; 5] {
    let rail = section[row::RAIL].y;
    let [inner, outer] = [section[10].y / rail, section[9].y / rail];
    [0.0, inner, (inner + outer) / 2.0, outer, 1.0]
}

/// Returns the height of a section's upper rim at `y`.
fn rim_height(section: &[DVec3; ROWS], y: f64) -> f64 {
    let rim = &section[row::RAIL..];
    let piece = rim.windows(2).find(|pair| (pair[1].y..=pair[0].y).contains(&y));
    piece.map_or(section[ROWS - 1].z, |pair| {
        let share = (pair[0].y - y) / (pair[0].y - pair[1].y);
        pair[0].z + (pair[1].z - pair[0].z) * share
    })
}
