//! Cars, pickups and vans.
//!
//! # How it works
//! [`Style`] has the proportion ranges of a shape, [`Car`] the values drawn from them; `parts` builds the
//! triangles.

mod parts;
mod style;

use glam::DVec3;

use super::colors::{self, DARK, TRIM};
use super::curve::{Corner, Curve};
use super::dice::Dice;
use super::kind::BodyKind;
use super::shell::{Arch, Bed, End, Shell};
use crate::mesh::Skin;
use style::Style;

/// Car with all its dimensions: meters, x forward from the middle of its length.
#[derive(Clone, Debug)]
pub(super) struct Car {
    /// Size including mirrors.
    pub(super) size_m: DVec3,
    shell: Shell,
    paint: Skin,
    roof: Skin,
    /// Sills and bumpers.
    cladding: Skin,
    /// Surroundings of the windows.
    pillar: Skin,
    /// Panes of a side: from, to.
    panes: Vec<[f64; 2]>,
    windscreen: [f64; 2],
    rear_screen: [f64; 2],
    doors: Vec<f64>,
    /// Radius and width of a tyre.
    wheel: [f64; 2],
    spokes: usize,
    rails: bool,
    rim: Skin,
    /// Length of head and tail lamps along the side, and whether tail lamps are upright.
    lamps: [f64; 2],
    upright_lamps: bool,
    grille: Skin,
    /// Lowest row of the grille, and share of the half width at which lamps start.
    grille_row: usize,
    lamp_share: f64,
}

impl Car {
    /// Draws a car of a kind; other kinds give a sedan.
    pub(super) fn new(kind: BodyKind, dice: &mut Dice) -> Self {
        let style = dice.pick(&style::of_kind(kind));
        let [length, height] = [dice.between(style.length), dice.between(style.height)];
        let mirror = dice.between([0.075, 0.105]);
        let width = dice.between(style.width) + 2.0 * mirror;
        let half = length / 2.0;
        let mut share = |range: [f64; 2]| half - length * dice.between(range);
        let marks = Marks {
            cowl: share(style.cowl),
            roof_front: share(style.roof_front),
            roof_rear: share(style.roof_rear),
            deck: share(style.deck),
        };
        let heights = style.heights.map(|range| height * dice.between(range));
        let shell = shell(style, &marks, heights, [length, width - 2.0 * mirror, height], dice);
        let mut car = Self {
            size_m: DVec3::new(length, width, height),
            wheel: [shell.arches[0].z, dice.between([0.20, 0.24])],
            shell,
            paint: if style.fleet { colors::fleet_paint(dice) } else { colors::paint(dice) },
            roof: DARK,
            cladding: TRIM,
            pillar: TRIM,
            panes: Vec::new(),
            windscreen: between(marks.roof_front, marks.cowl, [0.05, 0.93]),
            rear_screen: between(marks.deck, marks.roof_rear, style.rear_glass),
            doors: Vec::new(),
            spokes: dice.pick(&[5, 7]),
            rails: dice.chance(style.rails),
            rim: colors::RIM,
            lamps: [dice.between([0.16, 0.34]), dice.between([0.26, 0.5])],
            upright_lamps: style.upright_lamps,
            grille: DARK,
            grille_row: dice.pick(&style.grilles),
            lamp_share: dice.between([0.52, 0.72]),
        };
        car.look(style, dice);
        car.panes_and_doors(style, &marks);
        car
    }

    /// Draws trim colors that may differ from the paint.
    fn look(&mut self, style: &Style, dice: &mut Dice) {
        self.roof =
            if dice.chance(style.dark_roof) { Skin { rgb: [22, 23, 25], ..self.paint } } else { self.paint };
        self.cladding = if dice.chance(style.clad) { TRIM } else { self.paint };
        self.pillar = if style.body_pillars { self.paint } else { DARK };
        self.rim = if dice.chance(0.25) { Skin { rgb: [58, 59, 62], ..colors::RIM } } else { colors::RIM };
        self.grille = if dice.chance(0.2) { colors::CHROME } else { DARK };
    }

    fn panes_and_doors(&mut self, style: &Style, marks: &Marks) {
        let front = marks.roof_front + 0.66 * (marks.cowl - marks.roof_front);
        let rear = marks.roof_rear + style.rear_pane * (marks.deck - marks.roof_rear);
        let at = |share: f64| front + (rear - front) * share;
        let ends: Vec<f64> = style.pillars.iter().map(|share| at(*share)).collect();
        let mut from = front;
        for (i, to) in ends.iter().copied().chain([rear]).enumerate() {
            let half_pillar = 0.035;
            let [start, end] = [
                if i == 0 { from } else { from - half_pillar },
                if i == ends.len() { to } else { to + half_pillar },
            ];
            if style.blind_from.is_none_or(|blind| i < blind) && start - end > 0.1 {
                self.panes.push([end, start]);
            }
            from = to;
        }
        let first = marks.roof_front + 0.9 * (marks.cowl - marks.roof_front);
        self.doors = std::iter::once(first).chain(style.door_lines.iter().map(|share| at(*share))).collect();
    }
}

/// Positions where the top bends, meters.
struct Marks {
    cowl: f64,
    roof_front: f64,
    roof_rear: f64,
    deck: f64,
}

/// Interpolates two shares between two positions.
fn between(from: f64, to: f64, shares: [f64; 2]) -> [f64; 2] {
    shares.map(|share| from + (to - from) * share)
}

fn shell(
    style: &Style,
    marks: &Marks,
    [nose, cowl, roof_rear, deck, tail, belt_front, belt_rear]: [f64; 7],
    [length, width, height]: [f64; 3],
    dice: &mut Dice,
) -> Shell {
    let half = length / 2.0;
    let radius = dice.between(style.wheel);
    let [front_axle, rear_axle] = [dice.between(style.front_axle), dice.between(style.rear_axle)];
    let under = dice.between(style.under);
    let arch = |share: f64| Arch { x: half - share * length, z: radius, radius: radius + style.gap };
    let corner = |x: f64, z: f64, round: f64| Corner { x, z, round };
    let bonnet = (half - 0.03 * length) * 0.55 + marks.cowl * 0.45;
    let middle = 0.55 * marks.roof_front + 0.45 * marks.roof_rear;
    let mut corners = vec![
        corner(half, nose - 0.06 * height, 0.0),
        corner(half - 0.022 * length, nose, 0.12),
        corner(bonnet, nose + (cowl - nose) * style.bonnet, 0.3),
        corner(marks.cowl, cowl, 0.10),
        corner(marks.roof_front, height - 0.022 * height, 0.36),
        corner(middle, height, 0.6),
        corner(marks.roof_rear, roof_rear, style.rear_round),
        corner(marks.deck, deck, 0.14),
    ];
    if style.bed {
        corners.push(corner(-half, tail, 0.0));
    } else {
        corners.push(corner(-half + 0.012 * length, tail, 0.08));
        corners.push(corner(-half, tail - 0.05 * height, 0.0));
    }
    corners.reverse();
    // Raises the bed's floor above the wheels.
    let floor = 2.0 * radius + style.gap + 0.06;
    let bed = style.bed.then_some(Bed { rear: -half + 0.08, front: marks.deck - 0.10, floor });
    let mut end = |x: f64, bow, taper: [f64; 2], lift, belt| {
        let taper = dice.between(taper);
        End { x, bow, taper, taper_m: 0.85, lift, belt }
    };
    Shell {
        front: end(half - style.bow[1], style.bow[1], style.taper[1], 0.07, belt_front),
        rear: end(-half + style.bow[0], style.bow[0], style.taper[0], 0.10, belt_rear),
        half_width: width / 2.0,
        top: Curve::new(&corners),
        under,
        tumble: style.tumble,
        flare: style.flare,
        arches: vec![arch(front_axle), arch(rear_axle)],
        bed,
    }
}
