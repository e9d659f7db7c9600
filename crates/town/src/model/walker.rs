//! People on foot.

use std::f64::consts::TAU;

use glam::DVec3;

use super::colors;
use super::dice::Dice;
use super::figure::Figure;
use crate::mesh::{Skin, Surface};

/// Pose count of a walking cycle.
pub(super) const POSES: usize = 12;

/// Clothing below the waist.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Legs {
    Trousers,
    Shorts,
    Skirt,
}

/// Pedestrian, with dimensions in meters.
#[derive(Clone, Debug)]
pub(super) struct Walker {
    height: f64,
    /// Breadth relative to the usual one at that height.
    build: f64,
    /// Half the maximum angle between the legs, radians.
    stride_rad: f64,
    pub(super) child: bool,
    legs: Legs,
    /// Length of the coat below the waist, share of the height.
    coat: f64,
    long_hair: bool,
    bald: bool,
    hat: Option<Skin>,
    backpack: Option<Skin>,
    bag: Option<Skin>,
    bare_arms: bool,
    skin: Skin,
    hair: Skin,
    top: Skin,
    bottom: Skin,
    shoes: Skin,
}

impl Walker {
    pub(super) fn new(dice: &mut Dice) -> Self {
        let child = dice.chance(0.14);
        let height = if child { dice.between([1.05, 1.42]) } else { dice.between([1.56, 1.92]) };
        let worn = |dice: &mut Dice, share: f64| dice.chance(share).then(|| colors::cloth(dice));
        Self {
            height,
            build: dice.between([0.88, 1.2]),
            stride_rad: dice.between([0.36, 0.47]),
            child,
            legs: dice.pick(&[
                Legs::Trousers,
                Legs::Trousers,
                Legs::Trousers,
                Legs::Trousers,
                Legs::Shorts,
                Legs::Skirt,
            ]),
            coat: if dice.chance(0.25) { dice.between([0.10, 0.24]) } else { 0.035 },
            long_hair: dice.chance(0.4),
            bald: dice.chance(0.08),
            hat: worn(dice, 0.15),
            backpack: worn(dice, 0.2),
            bag: worn(dice, 0.18),
            bare_arms: dice.chance(0.3),
            skin: colors::skin(dice),
            hair: colors::hair(dice),
            top: colors::cloth(dice),
            bottom: colors::legwear(dice),
            shoes: colors::shaded(
                dice.pick(&[[48, 42, 38], [30, 30, 32], [210, 208, 202], [110, 74, 48]]),
                dice,
                Surface::Rubber,
            ),
        }
    }

    /// Returns the length of a whole cycle, meters.
    pub(super) fn cycle_m(&self) -> f64 {
        4.0 * 0.49 * self.height * self.stride_rad.sin()
    }

    /// Returns the pose with the longest reach ahead and back.
    pub(super) fn widest(&self) -> usize {
        POSES / 4
    }

    /// Returns the figure in a pose, with its feet on z = 0.
    pub(super) fn figure(&self, pose: usize) -> Figure {
        let h = self.height;
        // Pose 0 has both legs side by side.
        let phase = (pose % POSES) as f64 / POSES as f64 * TAU + TAU / 4.0;
        let mut figure = Figure::default();
        let hip = 0.525 * h;
        for side in [1.0, -1.0] {
            let phase = if side > 0.0 { phase } else { phase + TAU / 2.0 };
            self.leg(&mut figure, side, hip, phase);
            self.arm(&mut figure, side, phase + TAU / 2.0);
        }
        self.trunk(&mut figure, hip);
        self.head(&mut figure);
        let low = figure.bounds()[0].z;
        figure.shift(DVec3::Z * -low);
        figure
    }

    /// Adds thigh, shank and shoe.
    fn leg(&self, figure: &mut Figure, side: f64, hip: f64, phase: f64) {
        let (h, b) = (self.height, self.build);
        let y = side * 0.047 * h * b;
        let thigh = self.stride_rad * swing(phase);
        let knee_bend = 0.12 + 0.85 * (-phase.sin()).max(0.0).powf(1.5);
        let down = |angle: f64| DVec3::new(angle.sin(), 0.0, -angle.cos());
        let from = DVec3::new(0.0, y, hip);
        let knee = from + down(thigh) * 0.245 * h;
        let ankle = knee + down(thigh - knee_bend) * 0.235 * h;
        let shank = if self.legs == Legs::Trousers { self.bottom } else { self.skin };
        let loose = if self.legs == Legs::Trousers { 1.12 } else { 0.95 };
        let calf = knee.lerp(ankle, 0.35);
        let cover = if self.legs == Legs::Skirt { self.skin } else { self.bottom };
        let radius = |share: f64| share * h * b.sqrt();
        figure.limb(&[(from, radius(0.043)), (knee, radius(0.034))], 8, cover);
        figure.limb(
            &[(knee, radius(0.033)), (calf, radius(0.032 * loose)), (ankle, radius(0.023 * loose))],
            8,
            shank,
        );
        let pitch = -0.25 * phase.cos().max(0.0).powi(4) + 0.75 * (-(phase - 0.35).cos()).max(0.0).powi(3);
        let (ahead, up) =
            (DVec3::new(pitch.cos(), 0.0, -pitch.sin()), DVec3::new(pitch.sin(), 0.0, pitch.cos()));
        let sole = ankle - up * 0.02 * h;
        let place = |along: f64, up_by: f64| sole + ahead * along * h + up * up_by * h;
        let rings = [
            (place(-0.035, 0.0), 0.014 * h, 0.018 * h),
            (place(-0.02, 0.004), 0.022 * h, 0.022 * h),
            (place(0.04, -0.002), 0.018 * h, 0.026 * h),
            (place(0.09, -0.008), 0.012 * h, 0.024 * h),
            (place(0.112, -0.011), 0.007 * h, 0.014 * h),
        ];
        figure.trunk(&rings, 8, self.shoes);
    }

    fn arm(&self, figure: &mut Figure, side: f64, phase: f64) {
        let (h, b) = (self.height, self.build);
        let y = side * 0.106 * h * b.sqrt();
        let swing = 0.95 * self.stride_rad * phase.cos();
        let down = |angle: f64| DVec3::new(angle.sin(), side * 0.10, -angle.cos()).normalize();
        let shoulder = DVec3::new(-0.005 * h, y, 0.793 * h);
        let elbow = shoulder + down(swing - 0.08) * 0.165 * h;
        let wrist = elbow + down(swing + 0.28) * 0.145 * h;
        let hand = wrist + down(swing + 0.3) * 0.05 * h;
        let radius = |share: f64| share * h * b.sqrt();
        figure.limb(&[(shoulder, radius(0.030)), (elbow, radius(0.026))], 7, self.top);
        let sleeve = if self.bare_arms { self.skin } else { self.top };
        figure.limb(&[(elbow, radius(0.025)), (wrist, radius(0.019))], 6, sleeve);
        figure.limb(&[(wrist, radius(0.016)), (hand, radius(0.019))], 5, self.skin);
        if let Some(skin) = self.bag.filter(|_| side > 0.0) {
            let at = hand - DVec3::Z * 0.13 * h;
            figure.trunk(
                &[
                    (at - DVec3::Z * 0.07 * h, 0.10 * h, 0.03 * h),
                    (at + DVec3::Z * 0.06 * h, 0.085 * h, 0.02 * h),
                    (hand, 0.012 * h, 0.008 * h),
                ],
                8,
                skin,
            );
        }
    }

    fn trunk(&self, figure: &mut Figure, hip: f64) {
        let (h, b) = (self.height, self.build);
        let at = |x: f64, z: f64| DVec3::new(x * h, 0.0, z * h);
        let belly = 0.058 + 0.05 * (b - 0.95).max(0.0);
        let hip = hip / h;
        let mut torso = Vec::new();
        if self.coat > 0.05 {
            torso.push((at(0.0, hip - self.coat), (0.06 + 0.46 * self.coat) * h, 0.112 * h * b));
        }
        torso.extend([
            (at(0.0, hip - 0.03), 0.066 * h * b, 0.096 * h * b),
            (at(-0.004, hip + 0.03), 0.064 * h * b, 0.094 * h * b),
            (at(0.004, hip + 0.09), belly * h * b, 0.086 * h * b),
            (at(0.004, 0.72), 0.066 * h * b, 0.098 * h * b),
            (at(-0.002, 0.775), 0.058 * h * b, 0.108 * h * b.sqrt()),
            (at(-0.006, 0.806), 0.048 * h * b.sqrt(), 0.108 * h * b.sqrt()),
            (at(-0.008, 0.828), 0.036 * h, 0.078 * h),
            (at(-0.008, 0.845), 0.030 * h, 0.042 * h),
        ]);
        figure.trunk(&torso, 10, self.top);
        let seat = [
            (at(0.0, hip - 0.065), 0.05 * h * b, 0.082 * h * b),
            (at(-0.006, hip - 0.01), 0.062 * h * b, 0.092 * h * b),
            (at(0.0, hip + 0.04), 0.055 * h * b, 0.085 * h * b),
        ];
        figure.trunk(&seat, 10, self.bottom);
        if self.legs == Legs::Skirt {
            let hem = [
                (at(0.0, 0.30), 0.17 * h, 0.125 * h * b),
                (at(0.0, hip - 0.05), 0.092 * h, 0.102 * h * b),
                (at(0.0, hip + 0.06), 0.058 * h, 0.086 * h * b),
            ];
            figure.trunk(&hem, 12, self.bottom);
        }
        if let Some(skin) = self.backpack {
            let pack = [
                (at(-0.095, 0.575), 0.03 * h, 0.06 * h),
                (at(-0.10, 0.60), 0.052 * h, 0.08 * h),
                (at(-0.095, 0.72), 0.05 * h, 0.082 * h),
                (at(-0.08, 0.79), 0.028 * h, 0.06 * h),
            ];
            figure.trunk(&pack, 8, skin);
        }
    }

    fn head(&self, figure: &mut Figure) {
        // Children's heads are nearly as large as adults'.
        let h = self.height;
        let size = 0.062 * (0.55 * h + 0.45 * 1.74);
        let top = 1.0 * h - 0.004 * h;
        let center = DVec3::new(0.012 * h, 0.0, top - 1.12 * size);
        let neck = DVec3::new(-0.006 * h, 0.0, 0.82 * h);
        figure.limb(&[(neck, 0.034 * h), (center - DVec3::Z * 0.6 * size, 0.032 * h)], 8, self.skin);
        figure.ball(center, DVec3::new(0.92, 0.76, 1.12) * size, DVec3::Z, self.skin);
        let nose = center + DVec3::new(0.93, 0.0, -0.12) * size;
        figure.limb(&[(nose, 0.10 * size), (nose - DVec3::Z * 0.12 * size, 0.14 * size)], 6, self.skin);
        let cap = |figure: &mut Figure, skin, grow: f64| {
            let at = |x: f64, z: f64| center + DVec3::new(x, 0.0, z) * size;
            let crown = [
                (at(-0.34, -0.55), 0.52 * size * grow, 0.66 * size * grow),
                (at(-0.26, -0.1), 0.72 * size * grow, 0.80 * size * grow),
                (at(-0.10, 0.42), 0.84 * size * grow, 0.79 * size * grow),
                (at(-0.06, 0.86), 0.70 * size * grow, 0.60 * size * grow),
                (at(-0.04, 1.12), 0.34 * size * grow, 0.28 * size * grow),
            ];
            figure.trunk(&crown, 10, skin);
        };
        if !self.bald {
            cap(figure, self.hair, 1.04);
        }
        if self.long_hair {
            let at = |x: f64, z: f64| center + DVec3::new(x, 0.0, z) * size;
            let mane = [
                (at(-0.75, -2.1), 0.18 * size, 0.5 * size),
                (at(-0.62, -1.2), 0.34 * size, 0.74 * size),
                (at(-0.45, -0.1), 0.5 * size, 0.84 * size),
                (at(-0.3, 0.5), 0.4 * size, 0.6 * size),
            ];
            figure.trunk(&mane, 8, self.hair);
        }
        if let Some(skin) = self.hat {
            let at = |x: f64, z: f64| center + DVec3::new(x, 0.0, z) * size;
            let hat = [
                (at(0.12, 0.36), 1.12 * size, 0.86 * size),
                (at(0.0, 0.55), 0.96 * size, 0.88 * size),
                (at(-0.02, 0.95), 0.82 * size, 0.74 * size),
                (at(-0.02, 1.2), 0.4 * size, 0.36 * size),
            ];
            figure.trunk(&hat, 10, skin);
        }
    }
}

/// Returns the position of a leg between ahead (1) and back (-1). During stance it moves back linearly, so
/// that the foot does not slide.
fn swing(phase: f64) -> f64 {
    let phase = phase.rem_euclid(TAU);
    if phase < TAU / 2.0 { 1.0 - 4.0 * phase / TAU } else { phase.cos() }
}
