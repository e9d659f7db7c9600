//! Colors of paint, clothes, skin and hair.

use super::dice::Dice;
use crate::mesh::{Skin, Surface};

pub(super) const DARK: Skin = Skin::new([24, 24, 26], Surface::Plain);
pub(super) const TRIM: Skin = Skin::new([38, 39, 42], Surface::Plain);
pub(super) const GLASS: Skin = Skin::new([36, 44, 50], Surface::CarGlass);
pub(super) const TYRE: Skin = Skin::new([34, 34, 36], Surface::Rubber);
pub(super) const RIM: Skin = Skin::new([158, 160, 165], Surface::Metal);
pub(super) const CHROME: Skin = Skin::new([186, 188, 192], Surface::Metal);
pub(super) const HEAD_LAMP: Skin = Skin::new([232, 234, 228], Surface::Lamp);
pub(super) const TAIL_LAMP: Skin = Skin::new([150, 18, 22], Surface::Plain);
pub(super) const BLINKER: Skin = Skin::new([222, 120, 24], Surface::Plain);
pub(super) const PLATE: Skin = Skin::new([222, 222, 214], Surface::Plain);

/// Car paints; frequent shades have more entries. The first, a grey, is the typical one.
const PAINTS: [[u8; 3]; 26] = [
    [168, 171, 175],
    [236, 237, 235],
    [232, 232, 228],
    [224, 226, 226],
    [214, 211, 202],
    [26, 27, 30],
    [34, 35, 38],
    [22, 24, 30],
    [44, 44, 46],
    [92, 95, 100],
    [112, 115, 118],
    [70, 74, 80],
    [150, 153, 158],
    [190, 193, 196],
    [132, 134, 136],
    [28, 52, 108],
    [46, 82, 140],
    [38, 58, 84],
    [104, 132, 164],
    [146, 26, 30],
    [176, 44, 36],
    [104, 24, 34],
    [40, 72, 56],
    [96, 108, 88],
    [172, 152, 122],
    [196, 128, 44],
];

/// Paints of commercial vehicles.
const FLEETS: [[u8; 3]; 14] = [
    [230, 231, 229],
    [236, 236, 234],
    [226, 228, 228],
    [232, 230, 224],
    [190, 193, 196],
    [96, 99, 104],
    [34, 35, 38],
    [214, 166, 32],
    [188, 40, 34],
    [36, 84, 148],
    [58, 118, 76],
    [122, 82, 52],
    [40, 52, 80],
    [206, 98, 36],
];

pub(super) fn paint(dice: &mut Dice) -> Skin {
    shaded(dice.pick(&PAINTS), dice, Surface::CarPaint)
}

pub(super) fn fleet_paint(dice: &mut Dice) -> Skin {
    shaded(dice.pick(&FLEETS), dice, Surface::CarPaint)
}

/// Returns a skin with the brightness varied by up to 8 %.
pub(super) fn shaded(rgb: [u8; 3], dice: &mut Dice, surface: Surface) -> Skin {
    let factor = dice.between([0.92, 1.08]);
    Skin::new(rgb.map(|v| (f64::from(v) * factor).round().clamp(0.0, 255.0) as u8), surface)
}

const CLOTHES: [[u8; 3]; 18] = [
    [74, 80, 96],
    [40, 42, 48],
    [28, 28, 30],
    [58, 66, 84],
    [112, 114, 118],
    [222, 220, 214],
    [232, 232, 230],
    [150, 42, 44],
    [188, 70, 54],
    [52, 88, 142],
    [96, 140, 176],
    [54, 96, 72],
    [120, 128, 84],
    [196, 168, 120],
    [214, 178, 64],
    [128, 78, 118],
    [202, 132, 150],
    [120, 84, 60],
];

const LEGWEAR: [[u8; 3]; 9] = [
    [52, 60, 82],
    [38, 44, 62],
    [30, 30, 33],
    [44, 44, 48],
    [84, 98, 124],
    [98, 98, 100],
    [150, 134, 108],
    [112, 92, 70],
    [200, 194, 182],
];

const SKINS: [[u8; 3]; 7] = [
    [206, 164, 136],
    [226, 184, 158],
    [214, 172, 144],
    [190, 142, 112],
    [158, 112, 84],
    [116, 78, 58],
    [84, 58, 46],
];

const HAIRS: [[u8; 3]; 8] = [
    [62, 46, 36],
    [30, 26, 24],
    [44, 34, 28],
    [92, 66, 44],
    [136, 100, 60],
    [186, 156, 104],
    [150, 148, 146],
    [122, 58, 34],
];

pub(super) fn cloth(dice: &mut Dice) -> Skin {
    shaded(dice.pick(&CLOTHES), dice, Surface::Cloth)
}

pub(super) fn legwear(dice: &mut Dice) -> Skin {
    shaded(dice.pick(&LEGWEAR), dice, Surface::Cloth)
}

pub(super) fn skin(dice: &mut Dice) -> Skin {
    shaded(dice.pick(&SKINS), dice, Surface::Plain)
}

pub(super) fn hair(dice: &mut Dice) -> Skin {
    shaded(dice.pick(&HAIRS), dice, Surface::Plain)
}
