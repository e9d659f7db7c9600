//! Wheels of vehicles.

use glam::DVec3;

use super::colors::{DARK, TYRE};
use super::shell::Shell;
use crate::mesh::{Mesh, Skin};

/// Wheel of a vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wheel {
    /// Outer end of the hub.
    pub(super) hub: DVec3,
    /// Radius, meters.
    pub(super) radius: f64,
    /// Width, meters, inward from the hub.
    pub(super) width: f64,
    /// 1 if the outside is left, -1 if right.
    pub(super) side: f64,
    pub(super) rim: Skin,
    /// Number of spokes, at least 5.
    pub(super) spokes: usize,
}

impl Wheel {
    /// Adds its triangles.
    pub(super) fn add(&self, mesh: &mut Mesh) {
        let (r, w) = (self.radius, self.width);
        let profile = [
            [0.0, -w],
            [r, -w],
            [r, -0.14 * w],
            [0.93 * r, 0.0],
            [0.68 * r, 0.0],
            [0.64 * r, -0.09 * w],
            [0.0, -0.02 * w],
        ];
        // With few spokes, they are narrower than the gaps between them.
        let share = if self.spokes < 7 { 3 } else { 2 };
        mesh.lathe(
            (self.hub, DVec3::Y * self.side),
            &profile,
            share * self.spokes,
            |ring, segment| match ring {
                0..=3 => TYRE,
                5 if !segment.is_multiple_of(share) => DARK,
                _ => self.rim,
            },
        );
    }
}

/// Adds a shell's left wheels (radius and width in meters), and blocks that close the wheel wells behind
/// them.
pub(super) fn under(shell: &Shell, [radius, width]: [f64; 2], (rim, spokes): (Skin, usize), mesh: &mut Mesh) {
    for arch in &shell.arches {
        let out = shell.half_width_at(arch.x) * 0.985 - 0.012;
        let hub = DVec3::new(arch.x, out, radius);
        Wheel { hub, radius, width, side: 1.0, rim, spokes }.add(mesh);
        let inner = out - width - 0.04;
        let reach = arch.radius * 0.985;
        let lid = shell.shoulder(arch.x - reach).min(shell.shoulder(arch.x + reach));
        let (low, high) = (shell.under - 0.02, lid.min(arch.z + 0.98 * arch.radius));
        mesh.block(DVec3::new(arch.x - reach, -0.01, low), DVec3::new(arch.x + reach, inner, high), DARK);
    }
}
