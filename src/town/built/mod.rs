//! What stands: roads and their paint, sidewalks, houses, trees, lamps, signs.
//!
//! # How it works
//! `ways` makes strips of the plan's roads and junctions; `ground` and `paint` cover them, and what is between them.
//! `lots` walks along both sides of every road and puts houses down where there is `room`; `house` builds each from the
//! town's `style`. `kerbside` puts `furniture` and trees next to the kerbs, `yards` trees behind the houses and hills
//! around. Things are made in frames of their own; `cells` turns them to their places and sorts them by place.

mod cells;
mod draw;
mod furniture;
mod ground;
mod house;
mod kerbside;
mod line;
mod lots;
mod paint;
mod plants;
mod room;
mod sketch;
mod style;
#[cfg(test)]
mod tests;
mod ways;
mod yards;

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
    kerbside::furnish(&plan.network, &frontages, &style, middle, &mut cells);
    yards::yards(&ways, middle, &style, &room, &mut cells);
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
