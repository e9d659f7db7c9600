//! Properties of a house, drawn from its lot's seed and the town's palette.

use glam::DVec3;

use crate::built::draw::Draw;
use crate::built::lots::{Lot, Side};
use crate::built::sketch::Wall;
use crate::built::style::{District, Style};
use crate::mesh::{Skin, Surface};

/// Colors of flat roofs: gravel, felt, sheets.
const FLAT_ROOFS: [[u8; 3]; 3] = [[118, 116, 112], [92, 92, 94], [150, 146, 138]];

/// Properties of a house. Lengths in meters.
#[derive(Clone, Debug)]
pub(super) struct House {
    pub(super) width: f64,
    pub(super) depth: f64,
    pub(super) floors: usize,
    pub(super) ground_m: f64,
    pub(super) floor_m: f64,
    pub(super) wall: Skin,
    /// Skin of the ground floor.
    pub(super) base: Skin,
    pub(super) trim: Skin,
    pub(super) frame: Skin,
    pub(super) door: Skin,
    pub(super) roof: Skin,
    /// Roof slope, rise over run; `None` for a flat roof.
    pub(super) slope: Option<f64>,
    /// Whether the ridge runs across the street instead of along it.
    pub(super) gable_front: bool,
    pub(super) shop: bool,
    /// Width and height of a window.
    pub(super) window: [f64; 2],
    /// Height of windows above the floor.
    pub(super) sill_m: f64,
    /// Spacing of windows.
    pub(super) bay_m: f64,
    pub(super) leaves: usize,
    pub(super) shutters: Option<Skin>,
    /// Whether windows have lintels.
    pub(super) lintels: bool,
    /// Whether there are mouldings above the ground floor and below the roof.
    pub(super) mouldings: bool,
    pub(super) balconies: bool,
    pub(super) metal: Skin,
    /// Extent of its door along the front.
    pub(super) door_at: [f64; 2],
    pub(super) sides: [Side; 4],
    pub(super) draw: Draw,
}

impl House {
    pub(super) fn new(lot: &Lot, style: &Style) -> Self {
        let mut draw = Draw::new(lot.seed, &[1]);
        let palette = style.palette;
        let centre = lot.quarter == District::Centre;
        let (rgb, surface) = draw.pick(palette.walls);
        let pattern = |draw: &mut Draw, rgb: [u8; 3], surface| Skin {
            rgb,
            surface,
            seed: draw.seed() as u32 & 0xff_ffff,
        };
        let rgb = draw.shade(rgb, 0.07);
        let wall = pattern(&mut draw, rgb, surface);
        let trim = pattern(&mut draw, [0; 3], Surface::Plaster);
        let trim = Skin { rgb: draw.pick(palette.trims), ..trim };
        let shop = centre && draw.chance(0.6);
        let base = if shop || draw.chance(0.3) {
            let darker = wall.rgb.map(|c| (f64::from(c) * 0.78) as u8);
            let rgb = draw.pick(&[trim.rgb, darker, [150, 146, 138]]);
            pattern(&mut draw, rgb, if surface == Surface::Brick { Surface::Plaster } else { surface })
        } else {
            wall
        };
        let floors = match lot.quarter {
            District::Centre => 3 + draw.below(4),
            District::Rows => 2 + draw.below(2),
            District::Gardens => 1 + draw.below(2),
        };
        let flat =
            draw.chance(if lot.quarter == District::Gardens { palette.flat / 2.0 } else { palette.flat });
        let modern = flat && palette.flat > 0.6;
        let window = if modern {
            [draw.between(1.4, 2.2), draw.between(1.3, 1.7)]
        } else {
            [draw.between(0.9, 1.25), draw.between(1.35, 1.8)]
        };
        let roof_rgb = draw.pick(if flat { &FLAT_ROOFS } else { palette.roofs });
        let roof_rgb = draw.shade(roof_rgb, 0.1);
        let frame = Skin::new(draw.pick(palette.frames), Surface::Plain);
        let shutter = Skin::new(draw.pick(palette.doors), Surface::Wood);
        Self {
            width: lot.size_m.x,
            depth: lot.size_m.y,
            floors,
            ground_m: if shop { draw.between(3.7, 4.3) } else { draw.between(2.9, 3.4) },
            floor_m: draw.between(2.8, if centre { 3.4 } else { 3.0 }),
            wall,
            base,
            trim,
            frame,
            door: Skin::new(draw.pick(palette.doors), Surface::Wood),
            roof: pattern(&mut draw, roof_rgb, if flat { Surface::Concrete } else { Surface::RoofTiles }),
            slope: if flat { None } else { Some(draw.between(palette.slope[0], palette.slope[1])) },
            gable_front: !centre && draw.chance(0.3),
            shop,
            window,
            sill_m: if modern { draw.between(0.5, 0.9) } else { draw.between(0.8, 0.95) },
            bay_m: window[0] + draw.between(1.15, if centre { 2.1 } else { 1.9 }),
            leaves: if modern { 1 + draw.below(2) } else { 2 },
            shutters: draw.chance(palette.shutters).then_some(shutter),
            lintels: !modern && draw.chance(0.6),
            mouldings: !modern && centre && draw.chance(0.8),
            balconies: centre && draw.chance(0.32),
            metal: Skin::new(style.metal, Surface::Metal),
            door_at: [lot.size_m.x / 2.0 - 1.0, lot.size_m.x / 2.0 + 1.0],
            sides: lot.sides,
            draw,
        }
    }

    /// Returns the height of the walls above the ground, meters.
    pub(super) fn eaves_m(&self) -> f64 {
        self.ground_m + (self.floors - 1) as f64 * self.floor_m
    }

    /// Returns the walls: front, right, back, left.
    pub(super) fn walls(&self) -> [Wall; 4] {
        walls(self.width, self.depth)
    }
}

/// Returns the walls of a rectangle: front, right, back, left.
pub(super) fn walls(width: f64, depth: f64) -> [Wall; 4] {
    let corner = |x: f64, y: f64| DVec3::new(x, y, 0.0);
    let corners = [corner(0.0, 0.0), corner(width, 0.0), corner(width, depth), corner(0.0, depth)];
    std::array::from_fn(|i| Wall::new(corners[i], corners[(i + 1) % 4]))
}
