//! People on bicycles.

use std::f64::consts::TAU;

use glam::DVec3;

use super::colors::{self, CHROME, DARK, TAIL_LAMP, TYRE};
use super::dice::Dice;
use super::figure::{Figure, joint};
use crate::mesh::{Ring, Skin, Surface};

/// Pose count of a pedal revolution.
pub(super) const POSES: usize = 12;
/// Distance that the bicycle moves in a pedal revolution, meters.
pub(super) const CYCLE_M: f64 = 4.2;

/// Person on a bicycle; dimensions in meters.
#[derive(Clone, Debug)]
pub(super) struct Cyclist {
    /// Scale of the whole figure.
    scale: f64,
    wheel: f64,
    /// Half the distance between the axles.
    half_base: f64,
    /// Angle of the spine above the horizontal, radians.
    lean_rad: f64,
    grip: DVec3,
    frame: Skin,
    top: Skin,
    legs: Skin,
    skin: Skin,
    head: Skin,
    helmet: bool,
    shorts: bool,
    basket: bool,
    backpack: Option<Skin>,
}

const FRAMES: [[u8; 3]; 7] = [
    [40, 78, 130],
    [28, 28, 30],
    [170, 36, 34],
    [60, 112, 84],
    [196, 198, 200],
    [120, 126, 132],
    [222, 150, 40],
];

impl Cyclist {
    pub(super) fn new(dice: &mut Dice) -> Self {
        let lean = dice.between([0.0, 1.0]);
        let helmet = dice.chance(0.55);
        Self {
            scale: dice.between([0.94, 1.06]),
            wheel: dice.between([0.325, 0.35]),
            half_base: dice.between([0.50, 0.55]),
            // Riders that sit upright have higher grips.
            lean_rad: 1.22 - 0.45 * lean,
            grip: DVec3::new(0.30 + 0.06 * lean, 0.27, 1.06 - 0.10 * lean),
            frame: colors::shaded(dice.pick(&FRAMES), dice, Surface::CarPaint),
            top: colors::cloth(dice),
            legs: colors::legwear(dice),
            skin: colors::skin(dice),
            head: if helmet {
                colors::shaded(
                    dice.pick(&[[228, 228, 224], [34, 34, 36], [180, 40, 36], [60, 100, 160]]),
                    dice,
                    Surface::Plain,
                )
            } else {
                colors::hair(dice)
            },
            helmet,
            shorts: dice.chance(0.35),
            basket: dice.chance(0.25),
            backpack: dice.chance(0.3).then(|| colors::cloth(dice)),
        }
    }

    /// Returns the figure in a pose, on z = 0.
    pub(super) fn figure(&self, pose: usize) -> Figure {
        let turn = (pose % POSES) as f64 / POSES as f64 * TAU;
        let mut figure = Figure::default();
        self.bicycle(&mut figure);
        self.trunk(&mut figure);
        for side in [1.0, -1.0] {
            self.leg(&mut figure, side, if side > 0.0 { turn } else { turn + TAU / 2.0 });
            self.arm(&mut figure, side);
        }
        figure.scale(self.scale);
        let low = figure.bounds()[0].z;
        figure.shift(DVec3::Z * -low);
        figure
    }

    fn bicycle(&self, figure: &mut Figure) {
        let (r, base) = (self.wheel, self.half_base);
        let at = |x: f64, z: f64| DVec3::new(x, 0.0, z);
        let (rear, front) = (at(-base, r), at(base, r));
        let (crank, saddle, stem) = (at(-0.06, 0.29), at(-0.20, 0.92), at(0.30, 0.80));
        for hub in [rear, front] {
            let tyre = [[r - 0.035, -0.016], [r, 0.0], [r - 0.035, 0.016], [r - 0.035, -0.016]];
            figure.revolve(hub, &tyre, 20, TYRE);
            let rim = [[r - 0.055, 0.0], [r - 0.034, -0.012], [r - 0.034, 0.012], [r - 0.055, 0.0]];
            figure.revolve(hub, &rim, 20, CHROME);
            for spoke in 0..4 {
                let (sin, cos) = (f64::from(spoke) * TAU / 8.0).sin_cos();
                let out = DVec3::new(cos, 0.0, sin) * (r - 0.05);
                figure.rod(hub - out, hub + out, 0.004, CHROME);
            }
            figure.rod(hub - DVec3::Y * 0.05, hub + DVec3::Y * 0.05, 0.02, DARK);
        }
        for (from, to, radius) in [
            (crank, saddle, 0.018),
            (saddle.lerp(crank, 0.22), stem, 0.018),
            (crank, stem - DVec3::Z * 0.10, 0.02),
            (stem - DVec3::Z * 0.13 + DVec3::X * 0.02, at(0.27, self.grip.z), 0.018),
            (stem - DVec3::Z * 0.10 + DVec3::X * 0.02, front, 0.016),
            (rear, crank, 0.014),
            (rear, saddle.lerp(crank, 0.25), 0.012),
        ] {
            figure.rod(from, to, radius, self.frame);
        }
        let bar = |side: f64| DVec3::new(self.grip.x - 0.04, side * (self.grip.y + 0.03), self.grip.z);
        figure.limb(&[(bar(1.0), 0.014), (at(0.30, self.grip.z), 0.014), (bar(-1.0), 0.014)], 6, DARK);
        let seat =
            [(at(-0.33, 0.925), 0.02, 0.07), (at(-0.26, 0.93), 0.03, 0.075), (at(-0.08, 0.935), 0.015, 0.02)];
        figure.trunk(&seat, 8, DARK);
        let disc = [at(-0.06, 0.29) - DVec3::Y * 0.06, at(-0.06, 0.29) - DVec3::Y * 0.05];
        let rings = disc.map(|c| Ring::circle(c, DVec3::Y, 0.085));
        figure.tubes.push(super::figure::Tube { rings: rings.to_vec(), segments: 12, skin: DARK });
        let lamp = saddle - DVec3::new(0.03, 0.0, 0.12);
        figure.rod(lamp, lamp - DVec3::X * 0.03, 0.025, TAIL_LAMP);
        if self.basket {
            let basket = [(at(0.45, 0.80), 0.12, 0.14), (at(0.46, 1.0), 0.15, 0.18)];
            figure.trunk(&basket, 8, Skin::new([112, 84, 56], Surface::Wood));
        }
    }

    fn hip(&self) -> DVec3 {
        DVec3::new(-0.20, 0.0, 1.0)
    }

    /// Unit direction from the hip upward.
    fn spine(&self) -> DVec3 {
        DVec3::new(self.lean_rad.cos(), 0.0, self.lean_rad.sin())
    }

    fn leg(&self, figure: &mut Figure, side: f64, turn: f64) {
        let hip = self.hip() + DVec3::new(0.02, side * 0.085, 0.0);
        let pedal = DVec3::new(-0.06 + 0.165 * turn.cos(), side * 0.115, 0.29 - 0.165 * turn.sin());
        let ankle = pedal + DVec3::new(-0.07, 0.0, 0.085);
        let knee = joint(hip, ankle, [0.44, 0.42], DVec3::X);
        figure.limb(&[(hip, 0.088), (knee, 0.058)], 6, self.legs);
        let (shank, calf) = (if self.shorts { self.skin } else { self.legs }, knee.lerp(ankle, 0.35));
        figure.limb(&[(knee, 0.055), (calf, 0.054), (ankle, 0.037)], 6, shank);
        let sole = pedal + DVec3::Z * 0.035;
        let shoe = [
            (sole - DVec3::X * 0.13, 0.03, 0.03),
            (sole - DVec3::X * 0.07, 0.04, 0.038),
            (sole + DVec3::X * 0.06, 0.026, 0.044),
            (sole + DVec3::X * 0.12, 0.016, 0.03),
        ];
        figure.trunk(&shoe, 8, DARK);
        let crank = DVec3::new(-0.06, side * 0.06, 0.29);
        figure.rod(crank, DVec3::new(pedal.x, crank.y, pedal.z), 0.012, CHROME);
        let plate = DVec3::new(0.0, side * 0.05, 0.0);
        figure.rod(DVec3::new(pedal.x, crank.y, pedal.z), pedal + plate, 0.018, DARK);
    }

    fn arm(&self, figure: &mut Figure, side: f64) {
        let shoulder = self.hip() + self.spine() * 0.50 + DVec3::new(0.0, side * 0.185, 0.0);
        let grip = DVec3::new(self.grip.x, side * self.grip.y, self.grip.z + 0.02);
        let elbow = joint(shoulder, grip, [0.29, 0.29], DVec3::new(-0.4, side * 0.7, -1.0));
        figure.limb(&[(shoulder, 0.058), (elbow, 0.045)], 6, self.top);
        let sleeve = if self.shorts { self.skin } else { self.top };
        figure.limb(&[(elbow, 0.043), (grip, 0.034)], 6, sleeve);
        figure.limb(
            &[(grip - DVec3::Y * side * 0.03, 0.032), (grip + DVec3::Y * side * 0.03, 0.032)],
            6,
            self.skin,
        );
    }

    fn trunk(&self, figure: &mut Figure) {
        let (hip, up) = (self.hip(), self.spine());
        let place = |along: f64| hip + up * along;
        let torso = [
            (place(-0.10), 0.10, 0.14),
            (place(-0.02), 0.115, 0.168),
            (place(0.14), 0.108, 0.152),
            (place(0.34), 0.118, 0.175),
            (place(0.47), 0.098, 0.19),
            (place(0.545), 0.065, 0.14),
            (place(0.57), 0.05, 0.07),
        ];
        figure.trunk(&torso, 12, self.top);
        let neck = place(0.55);
        let head = neck + DVec3::new(0.09, 0.0, 0.165);
        figure.limb(&[(neck, 0.058), (head - DVec3::Z * 0.05, 0.055)], 8, self.skin);
        figure.ball(head, DVec3::new(0.098, 0.08, 0.12), DVec3::Z, self.skin);
        let grow = if self.helmet { 1.16 } else { 1.03 };
        let cap = [
            (head + DVec3::new(-0.03, 0.0, -0.01), 0.076 * grow, 0.082 * grow),
            (head + DVec3::new(-0.005, 0.0, 0.055), 0.092 * grow, 0.082 * grow),
            (head + DVec3::new(-0.005, 0.0, 0.10), 0.072 * grow, 0.062 * grow),
            (head + DVec3::new(-0.005, 0.0, 0.125 * grow), 0.034 * grow, 0.028 * grow),
        ];
        figure.trunk(&cap, 10, self.head);
        if let Some(skin) = self.backpack {
            let behind = DVec3::Y.cross(up) * -0.15;
            let at = |along: f64| place(along) + behind;
            let pack = [
                (at(0.06), 0.04, 0.10),
                (at(0.12), 0.08, 0.13),
                (at(0.38), 0.085, 0.135),
                (at(0.48), 0.05, 0.10),
            ];
            figure.trunk(&pack, 8, skin);
        }
    }
}
