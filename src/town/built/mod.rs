//! What stands: roads and their paint, sidewalks, houses, trees, lamps, signs.

mod cells;
mod draw;
mod ground;
mod line;
mod paint;
mod sketch;
mod style;
mod ways;

use super::mesh::Mesh;
use super::plan::Plan;
use cells::Cells;
use style::Style;
use ways::Ways;

/// The standing town in meshes of neighbouring things (each at most about 60 m wide, so that they can be culled), town frame.
pub fn standing(plan: &Plan, seed: u64) -> Vec<Mesh> {
    let style = Style::new(seed);
    let ways = Ways::new(&plan.network);
    let mut cells = Cells::default();
    ground::ground(&ways, &style, &mut cells);
    paint::paint(&ways, &style, &mut cells);
    cells.into_meshes()
}
