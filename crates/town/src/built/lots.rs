use glam::DVec2;

use super::cells::Place;
use super::draw::Draw;
use super::ground::GROUND_M;
use super::line::Line;
use super::occupancy::{Occupancy, Occupant};
use super::sketch::corners;
use super::street_strips::StreetStrips;
use super::style::{District, Style};

/// Kind of building on a lot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Use {
    House,
    Office,
    Church,
}

/// Surroundings of a house's side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// The side faces a street.
    Street,
    /// The side faces yards.
    Open,
    /// The side touches another house's wall.
    Party,
}

/// Lot of a house: x runs along its front, to the right as seen from the street, y away from the street.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lot {
    /// Its left front corner.
    pub(super) place: Place,
    /// Size along the street and away from it, meters.
    pub(super) size_m: DVec2,
    /// Distance from the sidewalk to the front, meters.
    pub(super) setback_m: f64,
    pub(super) quarter: District,
    pub(super) kind: Use,
    pub(super) seed: u64,
    /// Surroundings of front, right, back and left.
    pub(super) sides: [Side; 4],
}

/// One side of a road, on the left of its line.
#[derive(Debug)]
pub(super) struct Frontage {
    pub(super) line: Line,
    /// Index of the road.
    pub(super) road: usize,
    /// Distance from the line to the kerb, meters.
    pub(super) kerb_m: f64,
    /// Width of the sidewalk, meters.
    pub(super) sidewalk_m: f64,
}

impl Lot {
    /// Returns the corners of a lot's part, counter-clockwise.
    pub(super) fn area(&self, min: DVec2, max: DVec2) -> [DVec2; 4] {
        corners(min, max).map(|p| self.place.point(p))
    }

    /// Returns the corners of the house.
    pub(super) fn footprint(&self) -> [DVec2; 4] {
        self.area(DVec2::ZERO, self.size_m)
    }
}

/// Returns both sides of all roads.
pub(super) fn frontages(strips: &StreetStrips) -> Vec<Frontage> {
    let mut frontages = Vec::new();
    for (road, (plan, line)) in strips.network.roads.iter().zip(&strips.lines).enumerate() {
        let Some(line) = line else { continue };
        for line in [line.clone(), line.reversed()] {
            frontages.push(Frontage { line, road, kerb_m: plan.half_width_m, sidewalk_m: plan.sidewalk_m });
        }
    }
    frontages
}

/// Places houses along all streets and marks their footprints as occupied.
pub(super) fn lots(
    frontages: &[Frontage],
    middle: DVec2,
    style: &Style,
    occupancy: &mut Occupancy,
) -> Vec<Lot> {
    let mut lots = Vec::new();
    let mut churches = 1;
    for (i, frontage) in frontages.iter().enumerate() {
        let mut draw = Draw::new(style.seed, &[0x107, i as i64]);
        let mut at = -16.0;
        // Houses of a street share their front line.
        let shared = draw.between(0.0, 1.0);
        let mut in_row = 0;
        while at < frontage.line.length() + 16.0 {
            let quarter = style.quarter(frontage.line.point(at, frontage.kerb_m + 10.0), middle);
            let wish =
                BuildingRequest::new(quarter, shared, churches > 0 && i > frontages.len() / 3, &mut draw);
            let Some(lot) = wish.fit(frontage, at, occupancy) else {
                at += 1.0;
                continue;
            };
            occupancy.take(&lot.footprint(), Occupant::House);
            if lot.setback_m > 1.0 {
                let front = lot.area(DVec2::new(0.0, 0.05 - lot.setback_m), DVec2::new(lot.size_m.x, 0.0));
                occupancy.take(&front, Occupant::Garden);
            }
            if lot.kind == Use::Church {
                churches -= 1;
            }
            in_row += 1;
            at += lot.size_m.x + wish.gap_m(&mut in_row, &mut draw);
            lots.push(lot);
        }
    }
    for lot in &mut lots {
        lot.sides = sides(lot, occupancy);
    }
    lots
}

/// Building to be placed, before its lot is known.
#[derive(Clone, Copy, Debug)]
struct BuildingRequest {
    quarter: District,
    kind: Use,
    size_m: DVec2,
    setback_m: f64,
    seed: u64,
}

impl BuildingRequest {
    fn new(quarter: District, shared: f64, church: bool, draw: &mut Draw) -> Self {
        let office = quarter == District::Centre && draw.chance(0.05);
        let (width, depth, setback_m) = match quarter {
            District::Centre if office => ([20.0, 27.0], [14.0, 17.0], 0.3),
            District::Centre => ([9.5, 16.0], [10.0, 13.0], 0.2),
            District::Rows => ([6.2, 9.0], [8.5, 10.5], 0.6 + 2.6 * shared),
            District::Gardens => ([9.0, 13.0], [8.0, 10.5], 4.0 + 2.5 * shared + draw.between(0.0, 0.8)),
        };
        let church = church && quarter != District::Gardens;
        let (size_m, setback_m) = if church {
            (DVec2::new(14.0, 26.0), 3.0)
        } else {
            (DVec2::new(draw.between(width[0], width[1]), draw.between(depth[0], depth[1])), setback_m)
        };
        let kind = if church {
            Use::Church
        } else if office {
            Use::Office
        } else {
            Use::House
        };
        Self { quarter, kind, size_m, setback_m, seed: draw.seed() }
    }

    /// Returns the lot of the largest variant of the house that fits; `None` if none does.
    fn fit(&self, frontage: &Frontage, at_m: f64, occupancy: &Occupancy) -> Option<Lot> {
        let scales = match self.kind {
            Use::House => [[1.0, 1.0], [1.0, 0.8], [0.72, 0.8], [0.6, 0.62]].as_slice(),
            Use::Office | Use::Church => &[[1.0, 1.0]],
        };
        let mut lots = scales.iter().map(|scale| self.lot(frontage, at_m, self.size_m * DVec2::from(*scale)));
        lots.find(|lot| {
            let margin = if self.kind == Use::Church { 3.0 } else { 0.0 };
            // The garden in front must not reach into another street.
            let min = DVec2::new(-margin, -lot.setback_m + 0.05);
            occupancy.is_free(&lot.area(min, lot.size_m + DVec2::splat(margin)))
        })
    }

    fn lot(&self, frontage: &Frontage, at_m: f64, size_m: DVec2) -> Lot {
        let back_m = frontage.kerb_m + frontage.sidewalk_m;
        let edge = |s: f64| frontage.line.point(s, back_m);
        let along = (edge(at_m + size_m.x) - edge(at_m)).normalize_or(DVec2::X);
        // If the street bends towards the house, the whole front is set back.
        let behind = |i: i32| (edge(at_m + size_m.x * f64::from(i) / 6.0) - edge(at_m)).dot(along.perp());
        let bulge = (0..=6).map(behind).fold(0.0, f64::max);
        let setback_m = self.setback_m + if bulge > 0.02 { bulge } else { 0.0 };
        let corner = edge(at_m) + along.perp() * setback_m;
        // Along a bent street, the chord limits the width of the front.
        let width = (edge(at_m + size_m.x) - edge(at_m)).dot(along);
        let place = Place::facing(corner.extend(GROUND_M), along);
        Lot {
            place,
            size_m: DVec2::new(width, size_m.y),
            setback_m,
            quarter: self.quarter,
            kind: self.kind,
            seed: self.seed,
            sides: [Side::Street, Side::Open, Side::Open, Side::Open],
        }
    }

    /// Returns the gap to the next house, meters.
    fn gap_m(&self, in_row: &mut i32, draw: &mut Draw) -> f64 {
        let gap = match (self.quarter, self.kind) {
            (_, Use::Church) => 4.0,
            (District::Centre, _) => {
                if draw.chance(0.1) {
                    draw.between(2.5, 5.0)
                } else {
                    0.02
                }
            }
            (District::Rows, _) if *in_row < 4 && !draw.chance(0.12) => 0.02,
            (District::Rows, _) => draw.between(2.5, 6.0),
            (District::Gardens, _) => draw.between(3.5, 9.0),
        };
        if gap > 1.0 {
            *in_row = 0;
        }
        gap
    }
}

/// Returns the surroundings of each house side.
fn sides(lot: &Lot, occupancy: &Occupancy) -> [Side; 4] {
    let (w, d) = (lot.size_m.x, lot.size_m.y);
    let beyond = |low: f64, high: f64| {
        [
            [DVec2::new(1.0, -high), DVec2::new(w - 1.0, -low)],
            [DVec2::new(w + low, 1.0), DVec2::new(w + high, d - 1.0)],
            [DVec2::new(1.0, d + low), DVec2::new(w - 1.0, d + high)],
            [DVec2::new(-high, 1.0), DVec2::new(-low, d - 1.0)],
        ]
    };
    let meets =
        |[min, max]: [DVec2; 2], by: Occupant| occupancy.meets(&lot.area(min, max)).any(|taken| taken == by);
    let (next, far) = (beyond(0.05, 0.8), beyond(0.05, 7.0));
    std::array::from_fn(|i| match () {
        () if i == 0 => Side::Street,
        () if meets(next[i], Occupant::House) => Side::Party,
        () if meets(far[i], Occupant::Street) && !meets(far[i], Occupant::House) => Side::Street,
        () => Side::Open,
    })
}
