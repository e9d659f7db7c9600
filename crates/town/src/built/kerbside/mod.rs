pub(super) mod furniture;

use glam::DVec2;

use self::furniture::Sign;
use super::cells::{Cells, Place};
use super::draw::Draw;
use super::lots::Frontage;
use super::plants::{Crown, Species, tree};
use super::style::{District, Style};
use crate::mesh::{Mesh, Skin, Surface};
use crate::plan::{JunctionKind, KERB_M, Network, Road};

/// Distance from the kerb to the middle of objects beside it, meters; walkers pass behind them.
pub(super) const POST_M: f64 = 0.45;

/// Adds all objects on the sidewalks.
pub(super) fn furnish(
    network: &Network,
    frontages: &[Frontage],
    style: &Style,
    town_middle: DVec2,
    cells: &mut Cells,
) {
    for (i, frontage) in frontages.iter().enumerate() {
        let road = &network.roads[frontage.road];
        let centre = frontage.line.point(frontage.line.length() / 2.0, frontage.kerb_m);
        let mut street = Street {
            frontage,
            road,
            crossings: crossings(network, frontage),
            quarter: style.quarter(centre, town_middle),
            style,
            taken: Vec::new(),
            draw: Draw::new(style.seed, &[0xf07, i as i64]),
            // Both sides of a road have the same trees.
            shared: Draw::new(style.seed, &[0x70ad, frontage.road as i64]),
            cells,
        };
        // Drivers beside the kerb come from the line's end and reach the junction at its start.
        let ends = if i % 2 == 0 { road.junctions } else { [road.junctions[1], road.junctions[0]] };
        let kind = network.junctions.get(ends[0]).map(|junction| junction.kind);
        street.right_of_way(kind);
        street.lamps(i % 2 == 1);
        street.bus_stop();
        street.trees();
        street.small_things();
    }
}

/// Returns the positions of crossings along a side of a road, meters.
fn crossings(network: &Network, frontage: &Frontage) -> Vec<f64> {
    let here = network.crossings.iter().filter(|crossing| crossing.road == frontage.road);
    here.map(|crossing| frontage.line.locate(crossing.outline.iter().sum::<DVec2>() / 4.0)[0]).collect()
}

/// Side of a road that objects are placed on.
struct Street<'a> {
    frontage: &'a Frontage,
    road: &'a Road,
    crossings: Vec<f64>,
    quarter: District,
    style: &'a Style,
    /// Occupied places: position along the line, and half the width, meters.
    taken: Vec<[f64; 2]>,
    draw: Draw,
    shared: Draw,
    cells: &'a mut Cells,
}

impl Street<'_> {
    fn length(&self) -> f64 {
        self.frontage.line.length()
    }

    fn metal(&self) -> Skin {
        Skin::new(self.style.metal, Surface::Metal)
    }

    /// Places an object at `along_m` if half its width is free on both sides; returns whether it was placed.
    fn stand(&mut self, along_m: f64, half_m: f64, from_kerb_m: f64, thing: &Mesh) -> bool {
        let free = along_m - half_m > 0.5
            && along_m + half_m < self.length() - 0.5
            && self.crossings.iter().all(|s| (s - along_m).abs() > half_m + 1.8)
            && self.taken.iter().all(|[s, half]| (s - along_m).abs() > half_m + half + 0.3);
        if free {
            self.taken.push([along_m, half_m]);
            let line = &self.frontage.line;
            let at = line.point(along_m, self.frontage.kerb_m + from_kerb_m).extend(KERB_M);
            self.cells.stand(thing, Place::facing(at, line.direction(along_m)));
        }
        free
    }

    /// Adds lights or stop signs before the junction at the line's start, street names and other signs.
    fn right_of_way(&mut self, kind: Option<JunctionKind>) {
        let crossing = self.crossings.iter().copied().filter(|s| *s < 20.0).reduce(f64::min);
        let at = crossing.map_or(1.6, |s| s + 2.1);
        let metal = self.metal();
        match kind {
            Some(JunctionKind::Signals) => {
                let arm = (self.road.lanes_each_way > 1).then_some(POST_M + self.frontage.kerb_m * 0.6);
                self.stand(at, 0.2, POST_M, &furniture::signal(arm, metal));
            }
            Some(JunctionKind::Stop) => {
                self.stand(at, 0.2, POST_M, &furniture::sign(Sign::Stop, metal));
            }
            _ => {}
        }
        if kind != Some(JunctionKind::Free) {
            let rgb = Draw::new(self.style.seed, &[0x516]).pick(&[
                [24, 70, 130],
                [26, 96, 60],
                [232, 232, 226],
                [120, 34, 34],
            ]);
            self.stand(1.0, 0.3, POST_M, &furniture::sign(Sign::Names(rgb), metal));
            for s in [self.length() - 1.4, self.length() - 3.0, 2.6] {
                if self.quarter == District::Centre {
                    self.stand(s, 0.15, 0.35, &furniture::bollard(metal));
                }
            }
        }
        let metal = Skin::new([130, 134, 136], Surface::Metal);
        if self.draw.chance(0.3) {
            self.stand(self.length() - 14.0, 0.2, POST_M, &furniture::sign(Sign::Speed, metal));
        }
        if self.road.parking_m[0] + self.road.parking_m[1] > 1.0 {
            self.stand(17.0, 0.2, POST_M, &furniture::sign(Sign::Parking, metal));
        }
    }

    fn lamps(&mut self, staggered: bool) {
        let step = self.shared.between(22.0, 30.0);
        let lamp = furniture::lamp(self.style.lamp, self.metal());
        let mut at = 8.0 + if staggered { step / 2.0 } else { 0.0 };
        while at < self.length() {
            // A lamp without room is shifted along by up to 2.7 m.
            let _ = (0..4).any(|k| self.stand(at + 0.9 * f64::from(k), 0.25, POST_M, &lamp));
            at += step;
        }
    }

    fn bus_stop(&mut self) {
        let parking = self.road.parking_m[0].max(self.road.parking_m[1]) > 0.0;
        if self.frontage.sidewalk_m < 3.4 || parking || self.length() < 50.0 || !self.draw.chance(0.6) {
            return;
        }
        let (at, rgb) = (self.length() * self.draw.between(0.4, 0.6), self.color());
        let shelter = furniture::shelter(self.metal(), rgb, self.draw.seed() as u32 & 0xff_ffff);
        self.stand(at, 2.3, 0.3, &shelter);
    }

    fn color(&mut self) -> [u8; 3] {
        self.draw.pick(&[
            [196, 60, 48],
            [40, 98, 150],
            [222, 180, 60],
            [66, 132, 96],
            [210, 210, 204],
            [130, 70, 130],
        ])
    }

    fn trees(&mut self) {
        let planted = self.shared.chance(match self.quarter {
            District::Centre => 0.55,
            District::Rows => 0.7,
            District::Gardens => 0.5,
        });
        let (step, leaves) = (self.shared.between(8.0, 13.0), self.shared.pick(self.style.leaves));
        let species = if self.shared.chance(0.2) { Species::Slender } else { Species::Broad };
        let size = self.shared.between(0.0, 1.0);
        if !planted {
            return;
        }
        let mut at = 5.0 + self.draw.between(0.0, 4.0);
        while at < self.length() - 4.0 {
            let slim = if species == Species::Slender { 1.6 } else { 0.0 };
            let height = 6.2 + slim + 2.6 * size + self.draw.between(-0.5, 0.5);
            let wide = if species == Species::Slender {
                1.25
            } else {
                1.5 + 0.5 * size + self.draw.between(-0.15, 0.25)
            };
            let crown = Crown::new(self.draw.shade(leaves, 0.12), self.draw.seed());
            let mut thing = furniture::pit();
            thing.append(&tree(species, height, wide, crown, true));
            self.stand(at, 0.7, POST_M, &thing);
            at += step + self.draw.between(-0.8, 0.8);
        }
    }

    /// Adds bins, benches, hydrants, cabinets, advertising columns, bicycle stands and bollards.
    fn small_things(&mut self) {
        let wide = self.frontage.sidewalk_m > 3.3;
        let busy = match self.quarter {
            District::Centre => 9.0,
            District::Rows => 16.0,
            District::Gardens => 30.0,
        };
        let mut at = self.draw.between(4.0, 4.0 + busy);
        while at < self.length() - 3.0 {
            let metal = self.metal();
            match self.draw.below(8) {
                0 | 1 => {
                    self.stand(at, 0.3, POST_M, &furniture::bin(Skin { surface: Surface::Plain, ..metal }))
                }
                2 => self.stand(at, 0.95, 0.3, &furniture::bench(metal)),
                3 => self.stand(at, 0.3, POST_M, &furniture::hydrant()),
                4 => self.stand(at, 0.6, POST_M, &furniture::cabinet()),
                5 if wide => {
                    let (rgb, seed) = (self.color(), self.draw.seed() as u32 & 0xff_ffff);
                    self.stand(at, 0.6, 0.62, &furniture::bill_column(rgb, seed))
                }
                6 if wide => self.stand(at, 1.1, POST_M, &furniture::bicycle_stand(metal)),
                _ => self.stand(at, 0.15, 0.35, &furniture::bollard(metal)),
            };
            at += busy * self.draw.between(0.6, 1.4);
        }
    }
}
