//! Street furniture. x runs along the kerb, y away from the road, z up from the sidewalk; drivers on the near
//! lanes come from +x.

use glam::{DVec2, DVec3};

use crate::built::sketch::{Wall, bar, disc};
use crate::mesh::{Mesh, Skin, Surface};

const DARK: Skin = Skin::new([34, 36, 38], Surface::Plain);
const STEEL: Skin = Skin::new([150, 154, 156], Surface::Metal);
const WHITE: Skin = Skin::new([236, 236, 232], Surface::Plain);
const PLANKS: Skin = Skin::new([142, 100, 66], Surface::Wood);

fn at(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

fn pole(mesh: &mut Mesh, height: f64, radius: f64, skin: Skin) {
    bar(mesh, [at(0.0, 0.0, -0.05), at(0.0, 0.0, height)], [radius, 0.8 * radius], 7, skin);
}

/// Returns a street lamp: an arm over the road, or a lantern on a post.
pub(in super::super) fn lamp(kind: usize, metal: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    let light = Skin::new([255, 226, 170], Surface::Lamp);
    if kind == 0 {
        pole(&mut mesh, 6.6, 0.085, metal);
        bar(&mut mesh, [at(0.0, 0.0, 6.5), at(0.0, -1.5, 7.0)], [0.055, 0.045], 5, metal);
        mesh.block(at(-0.14, -2.1, 6.98), at(0.14, -1.35, 7.1), metal);
        mesh.polygon(
            &[at(-0.11, -2.05, 6.97), at(-0.11, -1.5, 6.97), at(0.11, -1.5, 6.97), at(0.11, -2.05, 6.97)],
            light,
        );
        mesh.block(at(-0.12, -0.12, 0.0), at(0.12, 0.12, 0.9), metal);
    } else {
        pole(&mut mesh, 4.0, 0.07, metal);
        bar(&mut mesh, [at(0.0, 0.0, 0.0), at(0.0, 0.0, 0.8)], [0.16, 0.1], 7, metal);
        bar(&mut mesh, [at(0.0, 0.0, 4.0), at(0.0, 0.0, 4.5)], [0.13, 0.2], 6, light);
        bar(&mut mesh, [at(0.0, 0.0, 4.5), at(0.0, 0.0, 4.75)], [0.25, 0.0], 6, metal);
    }
    mesh
}

/// Returns traffic lights on a pole, and on an arm over the road if `arm_m` is given. Lamps are unlit,
/// because their state changes over time.
pub(in super::super) fn signal(arm_m: Option<f64>, metal: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    pole(&mut mesh, if arm_m.is_some() { 5.9 } else { 3.4 }, 0.09, metal);
    head(&mut mesh, at(0.16, 0.0, 2.35));
    if let Some(arm_m) = arm_m {
        bar(&mut mesh, [at(0.0, 0.0, 5.6), at(0.0, -arm_m, 5.9)], [0.075, 0.05], 6, metal);
        head(&mut mesh, at(0.16, 0.5 - arm_m, 5.35));
    }
    mesh.block(at(-0.06, -0.2, 0.95), at(0.08, -0.06, 1.2), Skin::new([224, 178, 40], Surface::Plain));
    mesh
}

/// Adds a signal head with three lamps that face +x; `foot` is its lower end.
fn head(mesh: &mut Mesh, foot: DVec3) {
    mesh.block(foot + at(-0.1, -0.17, 0.0), foot + at(0.1, 0.17, 0.96), DARK);
    for side in [0.2, -0.2] {
        let frame = Wall::new(foot + at(0.1, -side, 0.0), foot + at(0.1, side, 0.0));
        if side > 0.0 {
            frame.quad(mesh, [-0.03, 0.43], [-0.05, 1.01], -0.02, DARK);
        }
    }
    for (k, rgb) in [[32, 150, 84], [206, 146, 30], [178, 34, 34]].into_iter().enumerate() {
        let centre = foot + at(0.11, 0.0, 0.18 + 0.3 * k as f64);
        disc(mesh, centre, DVec3::X, 0.11, 8, Skin::new(rgb, Surface::Plain));
        mesh.block(centre + at(0.0, -0.12, 0.1), centre + at(0.16, 0.12, 0.13), DARK);
    }
}

/// Returns a sign on a post, facing +x.
pub(in super::super) fn sign(kind: Sign, metal: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    pole(&mut mesh, 2.75, 0.035, metal);
    let centre = at(0.05, 0.0, 2.35);
    let face = |mesh: &mut Mesh, out: f64, radius: f64, sides: usize, rgb: [u8; 3]| {
        disc(mesh, centre + at(out, 0.0, 0.0), DVec3::X, radius, sides, Skin::new(rgb, Surface::Plain));
    };
    let back = |mesh: &mut Mesh, radius: f64, sides: usize| {
        disc(mesh, centre - at(0.01, 0.0, 0.0), DVec3::NEG_X, radius, sides, STEEL);
    };
    match kind {
        Sign::Stop => {
            back(&mut mesh, 0.42, 8);
            face(&mut mesh, 0.0, 0.42, 8, [238, 238, 234]);
            face(&mut mesh, 0.006, 0.385, 8, [186, 28, 34]);
            let letters = Wall::new(centre + at(0.012, -0.27, -0.09), centre + at(0.012, 0.27, -0.09));
            for k in 0..4 {
                let u = 0.02 + 0.135 * f64::from(k);
                letters.quad(&mut mesh, [u, u + 0.09], [0.0, 0.18], 0.0, WHITE);
            }
        }
        Sign::Speed => {
            back(&mut mesh, 0.32, 14);
            face(&mut mesh, 0.0, 0.32, 14, [190, 30, 34]);
            face(&mut mesh, 0.006, 0.24, 14, [240, 240, 236]);
            let digits = Wall::new(centre + at(0.012, -0.14, -0.1), centre + at(0.012, 0.14, -0.1));
            for u in [0.0, 0.15] {
                digits.quad(&mut mesh, [u, u + 0.11], [0.0, 0.2], 0.0, DARK);
                digits.quad(&mut mesh, [u + 0.035, u + 0.075], [0.04, 0.16], 0.004, WHITE);
            }
        }
        Sign::Parking => {
            mesh.block(
                centre + at(-0.01, -0.25, -0.3),
                centre + at(0.01, 0.25, 0.3),
                Skin::new([28, 84, 166], Surface::Plain),
            );
            let letter = Wall::new(centre + at(0.014, -0.1, -0.2), centre + at(0.014, 0.12, -0.2));
            letter.quad(&mut mesh, [0.0, 0.06], [0.0, 0.4], 0.0, WHITE);
            letter.quad(&mut mesh, [0.06, 0.22], [0.34, 0.4], 0.0, WHITE);
            letter.quad(&mut mesh, [0.06, 0.22], [0.17, 0.23], 0.0, WHITE);
            letter.quad(&mut mesh, [0.16, 0.22], [0.23, 0.34], 0.0, WHITE);
        }
        Sign::Names(rgb) => {
            let plate = Skin { rgb, surface: Surface::Sign, seed: 5 };
            mesh.block(at(-0.5, -0.015, 2.45), at(0.5, 0.015, 2.65), plate);
            mesh.block(at(-0.015, -0.5, 2.68), at(0.015, 0.5, 2.88), plate);
        }
    }
    mesh
}

/// Kind of a sign.
#[derive(Clone, Copy, Debug)]
pub(in super::super) enum Sign {
    Stop,
    Speed,
    Parking,
    /// Street names, on plates of a color.
    Names([u8; 3]),
}

/// Returns a bollard.
pub(in super::super) fn bollard(metal: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    pole(&mut mesh, 0.95, 0.06, metal);
    bar(&mut mesh, [at(0.0, 0.0, 0.72), at(0.0, 0.0, 0.82)], [0.064; 2], 7, WHITE);
    mesh
}

/// Returns a bench that faces the houses.
pub(in super::super) fn bench(metal: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    for y in [0.02, 0.2] {
        mesh.block(at(-0.85, y, 0.42), at(0.85, y + 0.15, 0.47), PLANKS);
    }
    for z in [0.6, 0.78] {
        mesh.block(at(-0.85, -0.06, z), at(0.85, -0.02, z + 0.13), PLANKS);
    }
    for x in [-0.7, 0.7] {
        mesh.block(at(x - 0.03, -0.02, 0.0), at(x + 0.03, 0.34, 0.42), metal);
        mesh.block(at(x - 0.03, -0.03, 0.42), at(x + 0.03, 0.02, 0.9), metal);
    }
    mesh
}

/// Returns a litter bin.
pub(in super::super) fn bin(skin: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    bar(&mut mesh, [at(0.0, 0.0, 0.05), at(0.0, 0.0, 0.85)], [0.2, 0.23], 8, skin);
    bar(&mut mesh, [at(0.0, 0.0, 0.85), at(0.0, 0.0, 0.92)], [0.25, 0.2], 8, DARK);
    mesh
}

/// Returns a fire hydrant.
pub(in super::super) fn hydrant() -> Mesh {
    let mut mesh = Mesh::default();
    let red = Skin::new([186, 38, 34], Surface::Metal);
    bar(&mut mesh, [at(0.0, 0.0, 0.0), at(0.0, 0.0, 0.08)], [0.18; 2], 8, red);
    bar(&mut mesh, [at(0.0, 0.0, 0.08), at(0.0, 0.0, 0.62)], [0.12; 2], 8, red);
    bar(&mut mesh, [at(0.0, 0.0, 0.62), at(0.0, 0.0, 0.78)], [0.15, 0.05], 8, red);
    bar(&mut mesh, [at(-0.22, 0.0, 0.48), at(0.22, 0.0, 0.48)], [0.06; 2], 6, red);
    mesh
}

/// Returns a grey cable cabinet.
pub(in super::super) fn cabinet() -> Mesh {
    let mut mesh = Mesh::default();
    mesh.block(at(-0.5, -0.16, 0.0), at(0.5, 0.16, 1.15), Skin::new([148, 152, 148], Surface::Plain));
    mesh.block(at(-0.53, -0.19, 1.15), at(0.53, 0.19, 1.2), STEEL);
    mesh
}

/// Returns an advertising column.
pub(in super::super) fn bill_column(rgb: [u8; 3], seed: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let stone = Skin::new([120, 122, 118], Surface::Concrete);
    bar(&mut mesh, [at(0.0, 0.0, 0.0), at(0.0, 0.0, 0.4)], [0.46; 2], 12, stone);
    bar(
        &mut mesh,
        [at(0.0, 0.0, 0.4), at(0.0, 0.0, 2.7)],
        [0.43; 2],
        12,
        Skin { rgb, surface: Surface::Sign, seed },
    );
    bar(&mut mesh, [at(0.0, 0.0, 2.7), at(0.0, 0.0, 2.85)], [0.52; 2], 12, DARK);
    bar(&mut mesh, [at(0.0, 0.0, 2.85), at(0.0, 0.0, 3.3)], [0.5, 0.0], 12, DARK);
    mesh
}

/// Returns a bus shelter, open to the road and shallow, so that walkers can pass behind it.
pub(in super::super) fn shelter(metal: Skin, rgb: [u8; 3], seed: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let glass = Skin { rgb: [120, 140, 146], surface: Surface::CarGlass, seed: 0 };
    for x in [-1.95, 1.95] {
        for y in [0.05, 0.76] {
            mesh.block(at(x - 0.04, y - 0.04, 0.0), at(x + 0.04, y + 0.04, 2.4), metal);
        }
    }
    mesh.block(at(-2.1, -0.1, 2.4), at(2.1, 0.88, 2.5), metal);
    mesh.block(at(-1.9, 0.75, 0.25), at(1.9, 0.77, 2.2), glass);
    mesh.block(at(-2.0, 0.1, 0.2), at(-1.9, 0.72, 2.2), Skin { rgb, surface: Surface::Sign, seed });
    mesh.block(at(-1.2, 0.42, 0.42), at(1.2, 0.7, 0.48), PLANKS);
    for x in [-1.0, 1.0] {
        mesh.block(at(x - 0.04, 0.52, 0.0), at(x + 0.04, 0.62, 0.42), metal);
    }
    mesh
}

/// Returns a bicycle stand.
pub(in super::super) fn bicycle_stand(metal: Skin) -> Mesh {
    let mut mesh = Mesh::default();
    for k in -1..=1 {
        let x = 0.8 * f64::from(k);
        for y in [-0.1, 0.35] {
            bar(&mut mesh, [at(x, y, 0.0), at(x, y, 0.8)], [0.03; 2], 5, metal);
        }
        bar(&mut mesh, [at(x, -0.1, 0.8), at(x, 0.35, 0.8)], [0.03; 2], 5, metal);
    }
    mesh
}

/// Returns a framed tree pit.
pub(in super::super) fn pit() -> Mesh {
    let mut mesh = Mesh::default();
    let square = crate::built::sketch::corners(DVec2::new(-0.6, -0.25), DVec2::new(0.6, 0.55));
    crate::built::ground::flat(&mut mesh, &square, 0.012, Skin::new([86, 70, 54], Surface::Plain));
    for (x, y) in [
        ([-0.65, 0.65], [-0.29, -0.25]),
        ([-0.65, 0.65], [0.55, 0.59]),
        ([-0.65, -0.6], [-0.25, 0.55]),
        ([0.6, 0.65], [-0.25, 0.55]),
    ] {
        let rail = crate::built::sketch::corners(DVec2::new(x[0], y[0]), DVec2::new(x[1], y[1]));
        crate::built::ground::flat(&mut mesh, &rail, 0.02, STEEL);
    }
    mesh
}
