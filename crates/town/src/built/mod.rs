//! Static town: roads with markings, sidewalks, houses, trees, lamps and signs.
//!
//! # How it works
//! `street_strips` converts the plan's roads and junctions to strips; `ground` and `paint` cover them and the
//! areas between. `lots` walks along both sides of every road and places houses where `occupancy` is free;
//! `house` builds each in the town's `style`. `kerbside` places `furniture` and trees along the kerbs,
//! `yards` adds trees behind the houses and hills around the town. Objects are built in their own frames;
//! `cells` transforms and groups them by position.

mod cells;
mod draw;
mod ground;
mod house;
mod kerbside;
mod line;
mod lots;
mod occupancy;
mod paint;
mod plants;
mod sketch;
mod street_strips;
mod style;
#[cfg(test)]
mod tests;
mod yards;

use glam::DVec2;

use super::mesh::Mesh;
use super::plan::{Network, Plan};
use cells::Cells;
use street_strips::StreetStrips;
use style::Style;

/// Returns the static town as meshes of neighbouring objects, town frame. Each is at most about 60 m wide,
/// which allows culling.
pub fn static_meshes(plan: &Plan, seed: u64) -> Vec<Mesh> {
    let style = Style::new(seed);
    let strips = StreetStrips::new(&plan.network);
    let mut cells = Cells::default();
    ground::ground(&strips, &style, &mut cells);
    paint::paint(&strips, &style, &mut cells);
    let mut occupancy = occupancy::Occupancy::new(strips.areas(0.0));
    let frontages = lots::frontages(&strips);
    let middle = middle(&plan.network);
    let lots = lots::lots(&frontages, middle, &style, &mut occupancy);
    for lot in &lots {
        cells.stand(&house::house(lot, &style), lot.place);
    }
    kerbside::furnish(&plan.network, &frontages, &style, middle, &mut cells);
    yards::yards(&strips, middle, &style, &occupancy, &mut cells);
    cells.into_meshes()
}

/// Returns the mean of the junctions, or of the roads' starts if there are no junctions.
fn middle(network: &Network) -> DVec2 {
    let mut places: Vec<DVec2> = network.junctions.iter().map(|junction| junction.centre).collect();
    if places.is_empty() {
        places.extend(network.roads.iter().filter_map(|road| road.centerline.first()));
    }
    places.iter().sum::<DVec2>() / places.len().max(1) as f64
}
