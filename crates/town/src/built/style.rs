use glam::DVec2;
use point_skeleton::hash::noise;

use super::draw::Draw;
use crate::mesh::Surface;

/// Building type of a district.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum District {
    /// Tenements wall to wall, shops, offices.
    Centre,
    /// Town houses in short rows.
    Rows,
    /// Detached houses in gardens.
    Gardens,
}

/// Style shared by all of a town.
#[derive(Clone, Debug)]
pub(super) struct Style {
    /// Seed of all random choices.
    pub(super) seed: u64,
    /// Colors and shapes of houses.
    pub(super) palette: &'static Palette,
    /// sRGB colors of the streets and the ground.
    pub(super) asphalt: [u8; 3],
    pub(super) kerb: [u8; 3],
    pub(super) slabs: [u8; 3],
    pub(super) lawn: [u8; 3],
    /// Color of lines between directions.
    pub(super) middle_line: [u8; 3],
    /// Color of poles, lamps and fences.
    pub(super) metal: [u8; 3],
    /// Colors of leaves.
    pub(super) leaves: &'static [[u8; 3]],
    /// Kind of the street lamps: 0 modern, 1 old.
    pub(super) lamp: usize,
    /// Offset of the density that selects the quarter; higher values favor the centre's type.
    density: f64,
}

/// Colors and proportions of houses in a kind of town.
#[derive(Debug)]
pub(super) struct Palette {
    /// sRGB color and material of walls.
    pub(super) walls: &'static [([u8; 3], Surface)],
    /// Colors of trim around windows and at eaves.
    pub(super) trims: &'static [[u8; 3]],
    /// Colors of window frames.
    pub(super) frames: &'static [[u8; 3]],
    pub(super) roofs: &'static [[u8; 3]],
    pub(super) doors: &'static [[u8; 3]],
    /// Share of houses with flat roofs.
    pub(super) flat: f64,
    /// Share of houses with shutters.
    pub(super) shutters: f64,
    /// Range of roof slopes, rise over run.
    pub(super) slope: [f64; 2],
}

const PALETTES: [Palette; 6] = [
    // Red brick.
    Palette {
        walls: &[
            ([152, 82, 64], Surface::Brick),
            ([170, 98, 76], Surface::Brick),
            ([134, 72, 60], Surface::Brick),
            ([186, 128, 96], Surface::Brick),
            ([120, 80, 70], Surface::Brick),
            ([222, 208, 184], Surface::Plaster),
        ],
        trims: &[[226, 220, 206], [206, 196, 176], [238, 236, 228]],
        frames: &[[238, 238, 234], [60, 66, 64], [42, 44, 48]],
        roofs: &[[88, 90, 98], [104, 98, 96], [126, 74, 62]],
        doors: &[[34, 70, 60], [110, 30, 34], [30, 44, 76], [28, 28, 30]],
        flat: 0.45,
        shutters: 0.0,
        slope: [0.7, 1.0],
    },
    // Colored plaster.
    Palette {
        walls: &[
            ([236, 208, 152], Surface::Plaster),
            ([222, 170, 138], Surface::Plaster),
            ([190, 204, 176], Surface::Plaster),
            ([228, 194, 190], Surface::Plaster),
            ([176, 196, 214], Surface::Plaster),
            ([240, 228, 202], Surface::Plaster),
            ([206, 150, 112], Surface::Plaster),
        ],
        trims: &[[244, 240, 230], [232, 224, 206]],
        frames: &[[244, 244, 240], [110, 76, 52]],
        roofs: &[[170, 88, 62], [152, 76, 58], [184, 106, 76]],
        doors: &[[96, 62, 42], [52, 76, 60], [124, 48, 40]],
        flat: 0.1,
        shutters: 0.35,
        slope: [0.75, 1.2],
    },
    // Cut stone and zinc.
    Palette {
        walls: &[
            ([222, 210, 188], Surface::Plaster),
            ([208, 196, 176], Surface::Concrete),
            ([230, 220, 204], Surface::Plaster),
            ([196, 184, 166], Surface::Concrete),
            ([214, 196, 168], Surface::Plaster),
        ],
        trims: &[[236, 230, 216], [216, 208, 190]],
        frames: &[[236, 234, 226], [70, 72, 76]],
        roofs: &[[110, 120, 132], [96, 104, 116], [84, 88, 98]],
        doors: &[[38, 62, 54], [66, 46, 38], [34, 44, 66]],
        flat: 0.15,
        shutters: 0.3,
        slope: [0.8, 1.1],
    },
    // White walls and clay tiles.
    Palette {
        walls: &[
            ([240, 236, 226], Surface::Plaster),
            ([246, 240, 224], Surface::Plaster),
            ([226, 178, 112], Surface::Plaster),
            ([214, 132, 96], Surface::Plaster),
            ([232, 214, 180], Surface::Plaster),
        ],
        trims: &[[250, 246, 236], [222, 190, 140]],
        frames: &[[92, 62, 44], [60, 96, 92], [70, 110, 140]],
        roofs: &[[196, 116, 78], [182, 100, 70], [206, 132, 92]],
        doors: &[[92, 58, 38], [44, 92, 110], [60, 96, 70]],
        flat: 0.3,
        shutters: 0.6,
        slope: [0.35, 0.5],
    },
    // Painted boards and brick.
    Palette {
        walls: &[
            ([150, 54, 46], Surface::Wood),
            ([218, 178, 96], Surface::Wood),
            ([92, 118, 134], Surface::Wood),
            ([230, 228, 218], Surface::Wood),
            ([104, 128, 104], Surface::Wood),
            ([222, 214, 196], Surface::Plaster),
            ([160, 88, 68], Surface::Brick),
        ],
        trims: &[[242, 242, 236], [234, 230, 220]],
        frames: &[[244, 244, 242], [56, 60, 62]],
        roofs: &[[74, 76, 82], [92, 84, 82], [138, 70, 56]],
        doors: &[[44, 74, 96], [148, 52, 40], [70, 92, 66], [224, 184, 80]],
        flat: 0.1,
        shutters: 0.05,
        slope: [0.7, 1.1],
    },
    // Modern: concrete, white, dark panels.
    Palette {
        walls: &[
            ([186, 184, 178], Surface::Concrete),
            ([232, 232, 228], Surface::Plaster),
            ([98, 100, 106], Surface::Plaster),
            ([206, 198, 184], Surface::Plaster),
            ([150, 108, 76], Surface::Wood),
            ([160, 164, 168], Surface::Concrete),
            ([178, 140, 118], Surface::Brick),
        ],
        trims: &[[214, 214, 210], [120, 122, 126], [240, 240, 238]],
        frames: &[[52, 54, 58], [230, 230, 228], [84, 88, 92]],
        roofs: &[[84, 86, 90], [118, 118, 120]],
        doors: &[[44, 46, 50], [150, 104, 66], [170, 60, 44]],
        flat: 0.75,
        shutters: 0.0,
        slope: [0.4, 0.7],
    },
];

const GREEN: &[[u8; 3]] = &[[74, 112, 50], [88, 124, 56], [62, 98, 48], [102, 130, 58]];
const SPRING: &[[u8; 3]] = &[[116, 150, 66], [136, 164, 76], [98, 138, 62], [226, 184, 196], [150, 168, 84]];
const AUTUMN: &[[u8; 3]] = &[[176, 118, 44], [196, 146, 52], [150, 84, 40], [120, 120, 52], [164, 60, 40]];
const DEEP: &[[u8; 3]] = &[[50, 88, 48], [58, 96, 60], [70, 104, 46], [48, 82, 54]];

impl Style {
    /// Derives the style from a town's seed.
    pub(super) fn new(seed: u64) -> Self {
        let mut draw = Draw::new(seed, &[0x5747]);
        let leaves = draw.pick(&[GREEN, SPRING, DEEP, AUTUMN, GREEN]);
        let autumn = leaves == AUTUMN;
        Self {
            seed,
            palette: &PALETTES[draw.below(PALETTES.len())],
            asphalt: draw.pick(&[[88, 89, 93], [76, 77, 80], [98, 97, 96], [84, 82, 80]]),
            kerb: draw.pick(&[[186, 182, 174], [172, 172, 170], [198, 192, 180]]),
            slabs: draw.pick(&[[166, 162, 154], [178, 168, 152], [150, 148, 146], [172, 152, 136]]),
            lawn: if autumn {
                [124, 128, 66]
            } else {
                draw.pick(&[[92, 124, 60], [108, 132, 66], [84, 114, 62]])
            },
            middle_line: draw.pick(&[[226, 226, 220], [226, 184, 60]]),
            metal: draw.pick(&[[66, 72, 70], [44, 62, 54], [118, 122, 124], [40, 42, 46]]),
            leaves,
            lamp: draw.below(2),
            density: draw.between(-0.1, 0.14),
        }
    }

    /// Returns the type of quarter at a position.
    pub(super) fn quarter(&self, place: DVec2, middle: DVec2) -> District {
        let off = place.distance(middle) / 260.0;
        let at = place / 90.0;
        let density = 1.0 - off + 0.75 * (noise(self.seed ^ 0x71, at.x, at.y) - 0.5) + self.density;
        match density {
            d if d > 0.58 => District::Centre,
            d if d > 0.3 => District::Rows,
            _ => District::Gardens,
        }
    }
}
