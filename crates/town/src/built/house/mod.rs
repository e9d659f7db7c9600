//! Houses, derived from their lot's seed and the town's palette.
//!
//! In a house's frame x runs along its front, to the right as seen from the street, y away from the street, z
//! up.

mod church;
mod extras;
mod facade;
mod garden;
mod office;
mod openings;
mod properties;
mod roof;

use self::properties::House;
use super::lots::{Lot, Side, Use};
use super::style::Style;
use crate::mesh::Mesh;

/// Returns the mesh of the building on a lot, in its frame.
pub(super) fn house(lot: &Lot, style: &Style) -> Mesh {
    let mut mesh = Mesh::default();
    let mut house = House::new(lot, style);
    match lot.kind {
        Use::Office => office::office(&mut mesh, &mut house),
        Use::Church => church::church(&mut mesh, &mut house),
        Use::House => {
            for (i, wall) in house.walls().into_iter().enumerate() {
                match house.sides[i] {
                    Side::Street => facade::street(&mut mesh, &wall, &mut house, i == 0),
                    Side::Open => facade::yard(&mut mesh, &wall, &mut house),
                    Side::Party => facade::blank(&mut mesh, &wall, &house),
                }
            }
            roof::roof(&mut mesh, &mut house);
        }
    }
    garden::front(&mut mesh, lot, style, &mut house);
    mesh
}
