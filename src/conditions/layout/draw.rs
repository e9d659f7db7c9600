use rayon::prelude::*;

use super::super::ConditionOptions;
use super::{box_segments, map_segments};
use crate::conditions::reduce::pil::PilBilinear;
use crate::geometry::{ImageSize, View};
use crate::raster::LineRows;
use crate::scene::{ActorState, SceneMap};

/// Layouts of a step: one RGB image on black per view; `None` for a layout that was not requested.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Layouts {
    /// Outlines of boxes.
    pub boxes: Option<Vec<Vec<[u8; 3]>>>,
    /// Outlines of the HD map.
    pub map: Option<Vec<Vec<[u8; 3]>>>,
}

/// Content of a layout.
#[derive(Clone, Copy)]
enum LayoutContent<'a> {
    Boxes(&'a [ActorState]),
    Map(&'a SceneMap),
}

/// Draws the layouts of actors and map at render size ([`ConditionOptions::drawn_view`]) and reduces them to
/// the written size with Pillow's BILINEAR filter.
pub(crate) fn draw(
    actors: Option<&[ActorState]>,
    map: Option<&SceneMap>,
    views: &[View],
    options: &ConditionOptions,
) -> Layouts {
    let filters = filters(views, options);
    let shown = [actors.map(LayoutContent::Boxes), map.map(LayoutContent::Map)];
    let scale = |(place, view): (usize, &View)| {
        let given = options.line_scales.as_ref().and_then(|scales| scales.get(place).copied());
        given.unwrap_or_else(|| options.line_scale(view))
    };
    let scales: Vec<f32> = views.iter().enumerate().map(scale).collect();
    let tasks: Vec<(LayoutContent<'_>, &View, f32)> = (shown.iter().flatten())
        .flat_map(|shown| views.iter().zip(&scales).map(|(view, scale)| (*shown, view, *scale)))
        .collect();
    let layout = |(shown, view, scale): &(LayoutContent<'_>, &View, f32)| {
        let (drawn, to) = (options.drawn_view(view), options.written_size(view));
        let size = ImageSize::of(&drawn.camera);
        let width_px = options.layout.width_px(*scale);
        let segments = match shown {
            LayoutContent::Boxes(actors) => {
                box_segments(actors, &drawn).into_iter().map(|segment| (segment, 1.0)).collect()
            }
            LayoutContent::Map(map) => map_segments(map, options.layout.map_layers, &drawn),
        };
        let widths = segments.iter().map(|(segment, relative)| (segment, relative * width_px));
        image(LineRows::of_widths(widths, size), [size, to], &filters)
    };
    let mut images = tasks.par_iter().map(layout).collect::<Vec<_>>().into_iter();
    let mut of = |shown: bool| shown.then(|| images.by_ref().take(views.len()).collect());
    Layouts { boxes: of(actors.is_some()), map: of(map.is_some()) }
}

/// Returns one filter for each pair of sizes.
fn filters(views: &[View], options: &ConditionOptions) -> Vec<PilBilinear> {
    let mut filters: Vec<PilBilinear> = Vec::new();
    for view in views {
        let sizes = [ImageSize::of(&options.drawn_view(view).camera), options.written_size(view)];
        if sizes[0] != sizes[1] && !filters.iter().any(|filter| filter.sizes() == sizes) {
            filters.push(PilBilinear::new(sizes[0], sizes[1]));
        }
    }
    filters
}

fn image(mut rows: LineRows, sizes: [ImageSize; 2], filters: &[PilBilinear]) -> Vec<[u8; 3]> {
    let Some(filter) = filters.iter().find(|filter| filter.sizes() == sizes) else {
        return rows.image(sizes[0]);
    };
    filter.filter(|row, painted| rows.row(row, |columns, rgb| painted.fill(columns, rgb)))
}
