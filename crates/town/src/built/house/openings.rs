//! Openings in walls, and the glass in them.

use crate::built::draw::Draw;
use crate::built::sketch::Wall;
use crate::mesh::{Mesh, Skin, Surface};

/// Width of window frames, meters.
const FRAME_M: f64 = 0.06;
/// Color of glass; the shader adds the reflected sky and the room.
const GLASS: [u8; 3] = [70, 84, 96];

/// Opening in a wall.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opening {
    /// Left and right edges, meters along the wall.
    pub(super) u: [f64; 2],
    /// Lower and upper edges, meters above the ground.
    pub(super) v: [f64; 2],
    pub(super) kind: OpeningKind,
}

/// Kind of an opening.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OpeningKind {
    Window,
    Shop,
    Door,
}

/// Adds the glass of a window as adjacent leaves; its pattern starts at the opening's lower left corner.
pub(super) fn panes(mesh: &mut Mesh, wall: &Wall, hole: &Opening, out: f64, leaves: usize, draw: &mut Draw) {
    let glass = Skin { rgb: GLASS, surface: Surface::Window, seed: draw.seed() as u32 & 0xff_ffff };
    let local = wall.moved(hole.u[0], hole.v[0], 0.0);
    let (width, height) = (hole.u[1] - hole.u[0], hole.v[1] - hole.v[0]);
    for leaf in 0..leaves {
        let part = |k: usize| width * k as f64 / leaves as f64;
        let frame = FRAME_M.min(0.2 * width);
        let u = [
            part(leaf) + frame * if leaf == 0 { 1.0 } else { 0.5 },
            part(leaf + 1) - frame * if leaf + 1 == leaves { 1.0 } else { 0.5 },
        ];
        local.quad(mesh, u, [frame, height - frame], out, glass);
    }
}
