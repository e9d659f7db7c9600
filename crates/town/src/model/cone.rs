//! Traffic cones.

use glam::DVec3;

use super::dice::Dice;
use crate::mesh::{Mesh, Skin, Surface};

const ORANGE: Skin = Skin::new([222, 92, 30], Surface::Plain);
const WHITE: Skin = Skin::new([230, 230, 224], Surface::Plain);

/// Traffic cone with its white collars.
#[derive(Clone, Debug)]
pub(super) struct Cone {
    pub(super) size_m: DVec3,
    collars: usize,
    foot: Skin,
}

impl Cone {
    pub(super) fn new(dice: &mut Dice) -> Self {
        let height = dice.between([0.48, 0.78]);
        let foot = height * dice.between([0.52, 0.6]);
        let size_m = DVec3::new(foot, foot, height);
        let black = Skin::new([40, 40, 42], Surface::Rubber);
        Self { size_m, collars: dice.pick(&[1, 2]), foot: if dice.chance(0.4) { black } else { ORANGE } }
    }

    pub(super) fn mesh(&self) -> Mesh {
        let (h, half) = (self.size_m.z, self.size_m.x / 2.0);
        let mut mesh = Mesh::default();
        let low = 0.045;
        mesh.chamfered(DVec3::new(-half, -half, 0.0), DVec3::new(half, half, low), 0.012, self.foot);
        let radius = |share: f64| half * (0.78 + (0.12 - 0.78) * share);
        let shares = [0.0, 0.34, 0.52, 0.66, 0.8, 1.0];
        let mut profile: Vec<[f64; 2]> = shares.iter().map(|s| [radius(*s), low + (h - low) * s]).collect();
        profile.push([0.0, h]);
        let collars = self.collars;
        mesh.lathe((DVec3::ZERO, DVec3::Z), &profile, 20, |ring, _| match ring {
            1 => WHITE,
            3 if collars > 1 => WHITE,
            _ => ORANGE,
        });
        mesh.smooth(0.7);
        mesh
    }
}
