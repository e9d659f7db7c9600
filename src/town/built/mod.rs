//! What stands: roads and their paint, sidewalks, houses, trees, lamps, signs.

mod cells;
mod draw;
mod ground;
mod house;
mod line;
mod lots;
mod paint;
mod room;
mod sketch;
mod style;
mod ways;

use glam::DVec2;

use super::mesh::Mesh;
use super::plan::{Network, Plan};
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
    let mut room = room::Room::new(ways.areas(0.0));
    let frontages = lots::frontages(&ways);
    let middle = middle(&plan.network);
    let lots = lots::lots(&frontages, middle, &style, &mut room);
    for lot in &lots {
        cells.stand(&house::house(lot, &style), lot.place);
    }
    cells.into_meshes()
}

/// The mean of the junctions, or of the roads' starts where there are none.
fn middle(network: &Network) -> DVec2 {
    let mut places: Vec<DVec2> = network.junctions.iter().map(|junction| junction.centre).collect();
    if places.is_empty() {
        places.extend(network.roads.iter().filter_map(|road| road.centerline.first()));
    }
    places.iter().sum::<DVec2>() / places.len().max(1) as f64
}
