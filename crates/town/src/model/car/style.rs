//! Proportion ranges of each car shape.

use crate::model::kind::BodyKind;

/// Ranges that a car's dimensions are drawn from: in meters, as shares of the length from the front, or as
/// shares of the height.
#[derive(Clone, Copy, Debug)]
pub(super) struct Style {
    pub(super) length: [f64; 2],
    /// Width without mirrors.
    pub(super) width: [f64; 2],
    pub(super) height: [f64; 2],
    /// Shares of the length: end of the bonnet, start and end of the roof, end of the slope behind it.
    pub(super) cowl: [f64; 2],
    pub(super) roof_front: [f64; 2],
    pub(super) roof_rear: [f64; 2],
    pub(super) deck: [f64; 2],
    /// Shares of the height: nose, cowl, rear of the roof, deck, tail, shoulder line in front and behind.
    pub(super) heights: [[f64; 2]; 7],
    pub(super) front_axle: [f64; 2],
    pub(super) rear_axle: [f64; 2],
    /// Radius of the wheels, and gap to their arches, meters.
    pub(super) wheel: [f64; 2],
    pub(super) gap: f64,
    pub(super) under: [f64; 2],
    pub(super) tumble: f64,
    pub(super) flare: f64,
    /// Bulge in the middle and taper of tail and nose.
    pub(super) bow: [f64; 2],
    pub(super) taper: [[f64; 2]; 2],
    /// Share of the bonnet's rise that is in its front half.
    pub(super) bonnet: f64,
    pub(super) rear_round: f64,
    /// Glass part of the slope behind the roof, as shares from its lower end.
    pub(super) rear_glass: [f64; 2],
    /// Share of that slope beside which side windows extend.
    pub(super) rear_pane: f64,
    /// Pillars and door gaps, as shares between the ends of the side windows.
    pub(super) pillars: &'static [f64],
    pub(super) door_lines: &'static [f64],
    /// Index of the first pane that is replaced with sheet metal.
    pub(super) blind_from: Option<usize>,
    pub(super) bed: bool,
    /// Probabilities of cladding, roof rails and a dark roof.
    pub(super) clad: f64,
    pub(super) rails: f64,
    pub(super) dark_roof: f64,
    /// Whether pillars between windows are painted.
    pub(super) body_pillars: bool,
    pub(super) upright_lamps: bool,
    /// Lowest row of the grille; 9 for no grille.
    pub(super) grilles: [usize; 4],
    /// Whether it is painted in fleet colors.
    pub(super) fleet: bool,
}

/// Returns the styles of a kind, the typical one first; frequent styles are repeated.
pub(super) fn of_kind(kind: BodyKind) -> [&'static Style; 4] {
    match kind {
        BodyKind::Hatchback => [&HATCH, &HATCH, &HATCH, &ESTATE],
        BodyKind::Suv => [&SUV, &SUV, &SUV, &CROSSOVER],
        BodyKind::Pickup => [&HARD_TOP, &DOUBLE_CAB, &DOUBLE_CAB, &SINGLE_CAB],
        BodyKind::Van => [&PANEL_VAN, &PANEL_VAN, &MINIBUS, &MINIBUS],
        _ => [&SEDAN, &SEDAN, &SEDAN, &COUPE],
    }
}

const SEDAN: Style = Style {
    length: [4.45, 4.95],
    width: [1.76, 1.88],
    height: [1.41, 1.49],
    cowl: [0.245, 0.29],
    roof_front: [0.415, 0.46],
    roof_rear: [0.65, 0.73],
    deck: [0.80, 0.88],
    heights: [
        [0.44, 0.505],
        [0.63, 0.685],
        [0.945, 0.975],
        [0.685, 0.755],
        [0.64, 0.71],
        [0.625, 0.665],
        [0.655, 0.70],
    ],
    front_axle: [0.175, 0.205],
    rear_axle: [0.765, 0.80],
    wheel: [0.305, 0.35],
    gap: 0.045,
    under: [0.165, 0.195],
    tumble: 0.34,
    flare: 0.015,
    bow: [0.05, 0.09],
    taper: [[0.09, 0.13], [0.11, 0.16]],
    bonnet: 0.55,
    rear_round: 0.34,
    rear_glass: [0.16, 0.93],
    rear_pane: 0.42,
    pillars: &[0.52],
    door_lines: &[0.52, 0.97],
    blind_from: None,
    bed: false,
    clad: 0.12,
    rails: 0.0,
    dark_roof: 0.12,
    body_pillars: false,
    upright_lamps: false,
    grilles: [4, 4, 3, 9],
    fleet: false,
};

const COUPE: Style = Style {
    length: [4.3, 4.75],
    width: [1.80, 1.90],
    height: [1.34, 1.42],
    cowl: [0.27, 0.30],
    roof_front: [0.44, 0.47],
    roof_rear: [0.63, 0.67],
    deck: [0.875, 0.91],
    rear_pane: 0.36,
    pillars: &[0.62],
    door_lines: &[0.64],
    taper: [[0.11, 0.15], [0.13, 0.18]],
    dark_roof: 0.25,
    flare: 0.025,
    ..SEDAN
};

const HATCH: Style = Style {
    length: [3.85, 4.40],
    width: [1.70, 1.81],
    height: [1.44, 1.56],
    cowl: [0.235, 0.265],
    roof_front: [0.395, 0.43],
    roof_rear: [0.845, 0.885],
    deck: [0.955, 0.972],
    heights: [
        [0.47, 0.51],
        [0.645, 0.68],
        [0.945, 0.97],
        [0.66, 0.70],
        [0.60, 0.63],
        [0.635, 0.655],
        [0.665, 0.69],
    ],
    front_axle: [0.19, 0.205],
    rear_axle: [0.815, 0.835],
    wheel: [0.30, 0.33],
    tumble: 0.30,
    bow: [0.06, 0.09],
    taper: [[0.08, 0.12], [0.11, 0.15]],
    rear_round: 0.16,
    rear_glass: [0.14, 0.90],
    rear_pane: -0.15,
    pillars: &[0.46],
    door_lines: &[0.46, 0.85],
    clad: 0.2,
    dark_roof: 0.2,
    upright_lamps: true,
    ..SEDAN
};

const ESTATE: Style = Style {
    length: [4.45, 4.85],
    width: [1.77, 1.86],
    height: [1.45, 1.53],
    cowl: [0.245, 0.27],
    roof_front: [0.405, 0.43],
    roof_rear: [0.875, 0.905],
    rear_axle: [0.785, 0.805],
    wheel: [0.315, 0.34],
    pillars: &[0.38, 0.72],
    door_lines: &[0.38, 0.74],
    rails: 0.6,
    ..HATCH
};

const SUV: Style = Style {
    length: [4.55, 5.05],
    width: [1.86, 1.98],
    height: [1.80, 1.93],
    cowl: [0.25, 0.28],
    roof_front: [0.395, 0.425],
    roof_rear: [0.88, 0.915],
    deck: [0.962, 0.978],
    heights: [
        [0.52, 0.56],
        [0.635, 0.665],
        [0.955, 0.98],
        [0.65, 0.68],
        [0.58, 0.61],
        [0.625, 0.645],
        [0.645, 0.67],
    ],
    front_axle: [0.185, 0.20],
    rear_axle: [0.785, 0.805],
    wheel: [0.36, 0.395],
    gap: 0.055,
    under: [0.22, 0.26],
    tumble: 0.25,
    flare: 0.025,
    bow: [0.05, 0.07],
    taper: [[0.07, 0.11], [0.09, 0.13]],
    bonnet: 0.65,
    rear_round: 0.14,
    rear_glass: [0.16, 0.88],
    rear_pane: -0.1,
    pillars: &[0.37, 0.69],
    door_lines: &[0.37, 0.70],
    clad: 0.65,
    rails: 0.55,
    dark_roof: 0.2,
    upright_lamps: true,
    grilles: [4, 3, 3, 9],
    ..SEDAN
};

const CROSSOVER: Style = Style {
    length: [4.15, 4.5],
    width: [1.79, 1.88],
    height: [1.62, 1.74],
    roof_rear: [0.84, 0.875],
    wheel: [0.335, 0.36],
    under: [0.19, 0.22],
    tumble: 0.28,
    pillars: &[0.46, 0.82],
    door_lines: &[0.46, 0.82],
    clad: 0.85,
    dark_roof: 0.35,
    ..SUV
};

const DOUBLE_CAB: Style = Style {
    length: [5.55, 6.0],
    width: [1.98, 2.06],
    height: [2.055, 2.13],
    cowl: [0.255, 0.28],
    roof_front: [0.36, 0.385],
    roof_rear: [0.625, 0.655],
    deck: [0.65, 0.675],
    heights: [
        [0.58, 0.615],
        [0.655, 0.68],
        [0.965, 0.985],
        [0.615, 0.64],
        [0.61, 0.635],
        [0.615, 0.635],
        [0.60, 0.62],
    ],
    front_axle: [0.175, 0.19],
    rear_axle: [0.775, 0.80],
    wheel: [0.40, 0.43],
    gap: 0.07,
    under: [0.34, 0.40],
    tumble: 0.22,
    flare: 0.03,
    bow: [0.02, 0.05],
    taper: [[0.02, 0.04], [0.05, 0.08]],
    bonnet: 0.8,
    rear_round: 0.12,
    rear_glass: [0.28, 0.88],
    rear_pane: -0.25,
    pillars: &[0.5],
    door_lines: &[0.5, 1.02],
    bed: true,
    clad: 0.5,
    rails: 0.0,
    dark_roof: 0.0,
    upright_lamps: true,
    grilles: [3, 3, 3, 4],
    ..SEDAN
};

const SINGLE_CAB: Style = Style {
    length: [5.35, 5.75],
    roof_rear: [0.52, 0.55],
    deck: [0.545, 0.575],
    pillars: &[0.74],
    door_lines: &[0.98],
    fleet: true,
    ..DOUBLE_CAB
};

/// Pickup with a lid over its bed as high as the cab.
const HARD_TOP: Style = Style {
    roof_rear: [0.935, 0.95],
    deck: [0.968, 0.976],
    heights: [
        [0.58, 0.615],
        [0.655, 0.68],
        [0.94, 0.97],
        [0.66, 0.69],
        [0.61, 0.635],
        [0.615, 0.635],
        [0.60, 0.62],
    ],
    rear_pane: -0.4,
    pillars: &[0.27, 0.53],
    door_lines: &[0.27, 0.54],
    bed: false,
    ..DOUBLE_CAB
};

const PANEL_VAN: Style = Style {
    length: [4.95, 5.6],
    width: [1.93, 2.05],
    height: [2.06, 2.45],
    cowl: [0.155, 0.18],
    roof_front: [0.29, 0.325],
    roof_rear: [0.955, 0.972],
    deck: [0.978, 0.986],
    heights: [
        [0.435, 0.47],
        [0.555, 0.585],
        [0.965, 0.985],
        [0.50, 0.53],
        [0.45, 0.48],
        [0.545, 0.56],
        [0.545, 0.56],
    ],
    front_axle: [0.165, 0.185],
    rear_axle: [0.775, 0.80],
    wheel: [0.33, 0.36],
    gap: 0.05,
    under: [0.20, 0.25],
    tumble: 0.15,
    flare: 0.012,
    bow: [0.03, 0.07],
    taper: [[0.03, 0.05], [0.09, 0.13]],
    bonnet: 0.62,
    rear_round: 0.14,
    rear_glass: [0.18, 0.82],
    rear_pane: -0.3,
    pillars: &[0.25, 0.60],
    door_lines: &[0.245, 0.59],
    blind_from: Some(1),
    bed: false,
    clad: 0.6,
    rails: 0.0,
    dark_roof: 0.0,
    body_pillars: true,
    upright_lamps: true,
    grilles: [4, 4, 4, 3],
    fleet: true,
};

const MINIBUS: Style = Style { blind_from: None, clad: 0.25, fleet: false, ..PANEL_VAN };
