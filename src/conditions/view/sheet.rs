//! Contact sheet of a step: every map of every camera in one image.
//!
//! # How it works
//! Each map is a block with a title and a legend. In it, the cameras of a known surround rig are arranged by
//! direction (front left, front, front right above back left, back, back right); other cameras are in rows of
//! three. Classes and numbers are shown as colors over the depth in dark gray. Tiles are scaled down to at
//! most [`TILE_WIDTH_PX`], twice that if there is only one column: a sheet is an overview, and the maps
//! themselves are beside it.

use std::borrow::Cow;
use std::cell::OnceCell;
use std::path::Path;

use super::canvas::{Canvas, GLYPH, text_width};
use crate::conditions::layout::map_rgb;
use crate::conditions::write::png;
use crate::conditions::{CameraConditions, ConditionSet, DepthBins, ImageSize, MapKind, MapPixels, reduce};
use crate::error::FileError;
use crate::scene::MapLayer;

/// Maximum tile width, pixels.
pub const TILE_WIDTH_PX: u32 = 224;

/// Color between the tiles.
pub const BACKGROUND: [u8; 3] = [17, 19, 24];
const EMPTY: [u8; 3] = [8, 9, 11];
const TEXT: [u8; 3] = [232, 234, 237];
const DIM_TEXT: [u8; 3] = [148, 153, 163];
/// Margin around the sheet and between blocks, pixels.
const MARGIN: u32 = 16;
/// Gap between tiles, pixels.
const GAP: u32 = 4;
/// Height of a block's title, pixels.
const TITLE: u32 = 28;
/// Width of a title and its legend, pixels.
const MIN_WIDTH: u32 = 448;
/// Width of the depth legend, pixels.
const BAR: u32 = 160;

/// Camera layouts of known rigs: two rows each, forward and backward, from left to right. Those of nuScenes,
/// Lyft Level 5 and T4 (which have further cameras), nuPlan without and with side cameras, TruckScenes,
/// 123D, Argoverse 2.
const RIGS: [[&[&str]; 2]; 8] = [
    [&["CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT"], &["CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT"]],
    [&["CAM_L0", "CAM_F0", "CAM_R0"], &["CAM_L1", "CAM_B0", "CAM_R1"]],
    [&["CAM_L1", "CAM_L0", "CAM_F0", "CAM_R0", "CAM_R1"], &["CAM_L2", "CAM_B0", "CAM_R2"]],
    [&["CAMERA_LEFT_FRONT", "CAMERA_RIGHT_FRONT"], &["CAMERA_LEFT_BACK", "CAMERA_RIGHT_BACK"]],
    [&["PCAM_L0", "PCAM_F0", "PCAM_R0"], &["PCAM_L1", "PCAM_B0", "PCAM_R1"]],
    [&["PCAM_L1", "PCAM_L0", "PCAM_F0", "PCAM_R0", "PCAM_R1"], &["PCAM_L2", "PCAM_B0", "PCAM_R2"]],
    [&["FTCAM_L0", "FTCAM_F0", "FTCAM_TELE_F0", "FTCAM_R0"], &["FTCAM_L1", "FTCAM_TELE_B0", "FTCAM_R1"]],
    [
        &["ring_front_left", "ring_front_center", "ring_front_right"],
        &["ring_side_left", "ring_rear_left", "ring_rear_right", "ring_side_right"],
    ],
];

/// Colors and names of the classes, starting at class 1.
pub(in super::super) const CLASSES: [([u8; 3], &str); 4] = [
    ([79, 148, 255], "vehicle"),
    ([255, 92, 92], "pedestrian"),
    ([92, 214, 128], "cycle"),
    ([255, 201, 77], "object"),
];

/// Names of the HD map layers.
const LAYERS: [(MapLayer, &str); 3] =
    [(MapLayer::Lane, "lane"), (MapLayer::DrivableArea, "drivable area"), (MapLayer::Crossing, "crossing")];

/// Writes the sheet as PNG, with `caption` at its top.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(path: &Path, set: &ConditionSet, bins: &DepthBins, caption: &str) -> Result<(), FileError> {
    let (size, pixels) = draw(set, bins, caption);
    png::write_rgb(path, &pixels, size)
}

/// Draws the sheet and returns its size and RGB pixels.
pub fn draw(set: &ConditionSet, bins: &DepthBins, caption: &str) -> (ImageSize, Vec<[u8; 3]>) {
    let grid = Grid::of(set, TILE_WIDTH_PX);
    // Legends need some width.
    let grid = if grid.columns == 1 { Grid::of(set, 2 * TILE_WIDTH_PX) } else { grid };
    let kinds = kinds(set);
    let (block, width) = (TITLE + grid.height(), grid.width().max(MIN_WIDTH));
    let size = ImageSize {
        height: MARGIN + TITLE + kinds.len() as u32 * (block + MARGIN),
        width: 2 * MARGIN + width,
    };
    let mut canvas = Canvas::new(size, BACKGROUND);
    canvas.text([MARGIN, MARGIN], 2, TEXT, caption);
    let (shades, tiles) = (Shades::of(bins), grid.tiles(set));
    for (place, &kind) in (0..).zip(&kinds) {
        let top = MARGIN + TITLE + place * (block + MARGIN);
        canvas.text([MARGIN, top + 6], 2, TEXT, kind.name());
        legend(&mut canvas, MARGIN + width, top + 6, kind, bins);
        tiles.iter().for_each(|tile| tile.draw(&mut canvas, [MARGIN, top + TITLE], kind, &shades));
    }
    (canvas.size, canvas.pixels)
}

/// Draws one map of all cameras, with tiles at most `tile_width` pixels wide; returns its size and RGB
/// pixels.
pub fn draw_map(
    set: &ConditionSet,
    kind: MapKind,
    tile_width: u32,
    bins: &DepthBins,
) -> (ImageSize, Vec<[u8; 3]>) {
    let grid = Grid::of(set, tile_width);
    let size = ImageSize { height: grid.height(), width: grid.width() };
    let mut canvas = Canvas::new(size, BACKGROUND);
    let shades = Shades::of(bins);
    grid.tiles(set).iter().for_each(|tile| tile.draw(&mut canvas, [0, 0], kind, &shades));
    (size, canvas.pixels)
}

/// Returns one map of one camera in the colors of the sheet, at its own size; `None` if the camera does not
/// have it.
pub fn picture(camera: &CameraConditions, kind: MapKind, bins: &DepthBins) -> Option<Vec<[u8; 3]>> {
    let size = camera.size();
    let tile = Tile { camera, corner: [0, 0], size, to: size, bins: OnceCell::new() };
    Some(tile.picture(kind, &Shades::of(bins))?.into_owned())
}

/// Returns the size of the image that [`draw_map`] draws and each camera's rectangle in it: left, top, width,
/// height, pixels.
pub fn places(set: &ConditionSet, tile_width: u32) -> (ImageSize, Vec<[u32; 4]>) {
    let grid = Grid::of(set, tile_width);
    let size = ImageSize { height: grid.height(), width: grid.width() };
    let place = |tile: &Tile<'_>| {
        let ([left, top], ImageSize { height, width }) = (tile.centered(), tile.to);
        [left, top, width, height]
    };
    (size, grid.tiles(set).iter().map(place).collect())
}

/// Returns the maps of a set that can be displayed.
pub fn kinds(set: &ConditionSet) -> Vec<MapKind> {
    MapKind::ALL.into_iter().filter(|kind| shown(set, *kind)).collect()
}

fn shown(set: &ConditionSet, kind: MapKind) -> bool {
    kind.description().is_shown && set.cameras.iter().any(|camera| camera.pixels(kind).is_some())
}

/// Arrangement of tiles within a block.
struct Grid {
    tile: ImageSize,
    /// Upper left corner of each camera's tile, x and y.
    corners: Vec<[u32; 2]>,
    rows: u32,
    columns: u32,
}

impl Grid {
    fn of(set: &ConditionSet, tile_width: u32) -> Self {
        let widest = set.cameras.iter().map(|c| c.width).max().unwrap_or(1);
        let width = widest.min(tile_width).max(1);
        let height = set.cameras.iter().map(|c| fitted(c.size(), width).height).max().unwrap_or(1);
        let (tile, count) = (ImageSize { height, width }, set.cameras.len());
        let names: Vec<&str> = set.cameras.iter().map(|c| c.name.as_str()).collect();
        let rigs =
            || RIGS.iter().filter(|rig| rig.iter().copied().flatten().all(|name| names.contains(name)));
        let rig = rigs().max_by_key(|rig| rig[0].len() + rig[1].len());
        let places = rig.map(|rig| places_in_rig(rig, &names));
        let places = places.unwrap_or_else(|| (0..count as u32).map(|i| [i % 3, i / 3]).collect());
        let end = |axis: usize| places.iter().map(|place| place[axis] + 1).max().unwrap_or(0);
        let (columns, rows) = (end(0), end(1));
        let corner = |[column, row]: [u32; 2]| [column * (tile.width + GAP), row * (tile.height + GAP)];
        Self { tile, corners: places.into_iter().map(corner).collect(), rows, columns }
    }

    /// Returns the tile of each camera.
    fn tiles<'a>(&self, set: &'a ConditionSet) -> Vec<Tile<'a>> {
        let tile = |(camera, corner): (&'a CameraConditions, &[u32; 2])| {
            let to = fitted(camera.size(), self.tile.width);
            Tile { camera, corner: *corner, size: self.tile, to, bins: OnceCell::new() }
        };
        set.cameras.iter().zip(&self.corners).map(tile).collect()
    }

    fn width(&self) -> u32 {
        (self.columns * (self.tile.width + GAP)).saturating_sub(GAP)
    }

    fn height(&self) -> u32 {
        (self.rows * (self.tile.height + GAP)).saturating_sub(GAP)
    }
}

/// Returns column and row of each camera. Cameras that do not belong to the rig are in rows below, in list
/// order.
fn places_in_rig(rig: &[&[&str]; 2], names: &[&str]) -> Vec<[u32; 2]> {
    let columns = rig[0].len().max(rig[1].len()) as u32;
    let mut others = 0..;
    let mut place = |name: &&str| {
        let in_row = |row: usize| Some([rig[row].iter().position(|n| n == name)? as u32, row as u32]);
        in_row(0).or_else(|| in_row(1)).unwrap_or_else(|| {
            let other = others.next().unwrap_or_default();
            [other % columns, 2 + other / columns]
        })
    };
    names.iter().map(&mut place).collect()
}

/// Returns the size of an image scaled down to a width; smaller images keep their size.
fn fitted(size: ImageSize, width: u32) -> ImageSize {
    if size.width <= width {
        return size;
    }
    let height = (f64::from(size.height) * f64::from(width) / f64::from(size.width)).round() as u32;
    ImageSize { height: height.max(1), width }
}

/// Tile of a camera, the same in every block.
struct Tile<'a> {
    camera: &'a CameraConditions,
    /// Upper left corner in the block, x and y.
    corner: [u32; 2],
    size: ImageSize,
    /// Size of the image in it.
    to: ImageSize,
    /// Depth bins of the image, which several maps show; 0 without a depth map.
    bins: OnceCell<Vec<u16>>,
}

impl Tile<'_> {
    /// Returns the upper left corner of the image in the block.
    fn centered(&self) -> [u32; 2] {
        let [left, top] = self.corner;
        [left + (self.size.width - self.to.width) / 2, top + (self.size.height - self.to.height) / 2]
    }

    /// Draws a map into a block with a given upper left corner.
    fn draw(&self, canvas: &mut Canvas, block: [u32; 2], kind: MapKind, shades: &Shades<'_>) {
        let in_block = |[left, top]: [u32; 2]| [block[0] + left, block[1] + top];
        let (at, picture) = (in_block(self.corner), self.picture(kind, shades));
        if picture.is_none() || self.to != self.size {
            canvas.fill(at, self.size, EMPTY);
        }
        if let Some(picture) = picture {
            canvas.blit(in_block(self.centered()), self.to, &picture);
        }
        let name = &self.camera.name;
        let label = ImageSize { height: GLYPH + 6, width: text_width(name, 1) + 8 };
        if label.width < self.size.width && label.height < self.size.height {
            canvas.map(at, label, |under, _| under.map(|level| (u16::from(level) * 3 / 10) as u8));
            canvas.text([at[0] + 4, at[1] + 3], 1, TEXT, name);
        }
    }

    /// Returns a map as RGB image; `None` if the camera has no such map.
    fn picture(&self, kind: MapKind, shades: &Shades<'_>) -> Option<Cow<'_, [[u8; 3]]>> {
        Some(match self.camera.pixels(kind)? {
            MapPixels::Rgb(map) => self.resized(map, reduce::pil_bilinear),
            MapPixels::Channels(tensor) => {
                Cow::Owned(reduce::pil_bilinear(&tensor.preview(), self.camera.size(), self.to))
            }
            MapPixels::Depth(_) => {
                let color = |bin: &u16| shades.colors[usize::from(*bin)];
                Cow::Owned(self.bins(shades.bins).iter().map(color).collect())
            }
            MapPixels::Class(map) => Cow::Owned(self.painted(map, class_color, shades)),
            MapPixels::Number(map) => Cow::Owned(self.painted(map, number_color, shades)),
        })
    }

    /// Returns a map in the size of the image.
    fn resized<'m, T: Clone>(
        &self,
        map: &'m [T],
        resize: impl Fn(&[T], ImageSize, ImageSize) -> Vec<T>,
    ) -> Cow<'m, [T]> {
        let from = self.camera.size();
        if from == self.to { Cow::Borrowed(map) } else { Cow::Owned(resize(map, from, self.to)) }
    }

    fn bins(&self, bins: &DepthBins) -> &[u16] {
        self.bins.get_or_init(|| match &self.camera.depth_m {
            Some(depth_m) => bins.bins(&self.resized(depth_m, reduce::nearest)),
            None => vec![0; self.to.pixels()],
        })
    }

    /// Returns the colors of the numbers other than 0 over the depth in dark gray.
    fn painted<N: Copy + Default + PartialEq + Send + Sync>(
        &self,
        numbers: &[N],
        color: impl Fn(N) -> [u8; 3],
        shades: &Shades<'_>,
    ) -> Vec<[u8; 3]> {
        let (mut last, mut rgb) = (N::default(), EMPTY);
        let mut pixel = |(bin, number): (&u16, &N)| {
            if *number == N::default() {
                return shades.grays[usize::from(*bin)];
            }
            if *number != last {
                (last, rgb) = (*number, color(*number));
            }
            rgb
        };
        let numbers = self.resized(numbers, reduce::nearest);
        self.bins(shades.bins).iter().zip(numbers.iter()).map(&mut pixel).collect()
    }
}

/// Colors of the depth bins.
struct Shades<'b> {
    bins: &'b DepthBins,
    colors: Vec<[u8; 3]>,
    /// Dark gray, lighter where it is nearer.
    grays: Vec<[u8; 3]>,
}

impl<'b> Shades<'b> {
    fn of(bins: &'b DepthBins) -> Self {
        let gray = |bin: u16| {
            let near = 1.0 - f32::from(bin) / f32::from(bins.count);
            [26.0, 28.0, 33.0].map(|base: f32| (base + 52.0 * near * near) as u8)
        };
        let grays = std::iter::once(EMPTY).chain((1..=bins.count).map(gray)).collect();
        Self { bins, colors: bins.colors(), grays }
    }
}

fn class_color(class: u8) -> [u8; 3] {
    let known = CLASSES.get(usize::from(class) - 1);
    known.map_or_else(|| number_color(class.into()), |(rgb, _)| *rgb)
}

/// Returns a bright color for a number. Hues are a golden angle apart, so consecutive numbers differ clearly.
fn number_color(number: u32) -> [u8; 3] {
    let hue = (f64::from(number) * 0.618_033_988_749_895).fract() * 6.0;
    let value = if number.is_multiple_of(2) { 0.82 } else { 1.0 };
    // Distance of the hue from the channel's own hue, as in the usual HSV formula.
    let channel = |offset: f64| {
        let distance = (hue + offset) % 6.0;
        let level = distance.min(4.0 - distance).clamp(0.0, 1.0);
        (255.0 * value * (1.0 - 0.68 * level)).round() as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// Draws the legend of a block, ending at `right`.
fn legend(canvas: &mut Canvas, right: u32, top: u32, kind: MapKind, bins: &DepthBins) {
    let text_top = top + 4;
    match kind {
        MapKind::Depth => {
            let far = format!("{} m", bins.far_m);
            let left = right.saturating_sub(BAR + text_width(&far, 1) + text_width("0 m", 1) + 16);
            let bar = left + canvas.text([left, text_top], 1, DIM_TEXT, "0 m") + 8;
            let colors = bins.colors();
            let color = |x: u32| {
                let depth_m = (x as f32 + 0.5) / BAR as f32 * bins.far_m;
                colors[usize::from(bins.bin(depth_m))]
            };
            canvas.map([bar, top + 2], ImageSize { height: 12, width: BAR }, |_, [x, _]| color(x));
            canvas.text([bar + BAR + 8, text_top], 1, DIM_TEXT, &far);
        }
        MapKind::Class => named_colors(canvas, right, top, &CLASSES),
        MapKind::Map => named_colors(canvas, right, top, &LAYERS.map(|(layer, name)| (map_rgb(layer), name))),
        _ => {}
    }
}

/// Draws color swatches with names in a row that ends at `right`.
fn named_colors(canvas: &mut Canvas, right: u32, top: u32, colors: &[([u8; 3], &str)]) {
    let width = |name: &str| 14 + text_width(name, 1) + 14;
    let total: u32 = colors.iter().map(|(_, name)| width(name)).sum();
    let mut left = right.saturating_sub(total.saturating_sub(14));
    for (rgb, name) in colors {
        canvas.map([left, top + 3], ImageSize { height: 10, width: 10 }, |_, _| *rgb);
        canvas.text([left + 14, top + 4], 1, DIM_TEXT, name);
        left += width(name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::write::test_set::test_set;

    fn named(names: &[&str]) -> ConditionSet {
        let camera = |name: &&str| CameraConditions {
            name: name.parse().unwrap(),
            ..test_set().cameras.swap_remove(0)
        };
        ConditionSet { cameras: names.iter().map(camera).collect() }
    }

    #[test]
    fn surround_cameras_are_arranged_by_direction() {
        let order =
            ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"];
        let [column, row] = [6 + GAP, 4 + GAP];
        let expected = [[column, 0], [2 * column, 0], [2 * column, row], [column, row], [0, row], [0, 0]];
        assert_eq!(Grid::of(&named(&order), 448).corners, expected);
        let ring = ["CAM_F0", "CAM_R0", "CAM_R1", "CAM_R2", "CAM_B0", "CAM_L2", "CAM_L1", "CAM_L0"];
        let grid = Grid::of(&named(&ring), 448);
        assert_eq!((grid.columns, grid.rows), (5, 2));
        assert_eq!((grid.corners[0], grid.corners[4]), ([2 * column, 0], [column, row]));
        assert_eq!((grid.corners[7], grid.corners[2]), ([column, 0], [4 * column, 0]));
        let trucks = ["CAMERA_LEFT_FRONT", "CAMERA_RIGHT_FRONT", "CAMERA_RIGHT_BACK", "CAMERA_LEFT_BACK"];
        let expected = [[0, 0], [column, 0], [column, row], [0, row]];
        assert_eq!(Grid::of(&named(&trucks), 448).corners, expected);
        // Further cameras of a known rig are below it.
        let more = [&order[..], &["CAM_FRONT_ZOOMED"], &["a", "b", "c"]].concat();
        let grid = Grid::of(&named(&more), 448);
        assert_eq!((grid.columns, grid.rows, grid.corners[0]), (3, 4, [column, 0]));
        let below = [[0, 2 * row], [column, 2 * row], [2 * column, 2 * row], [0, 3 * row]];
        assert_eq!(grid.corners[6..], below);
        // Cameras of an unknown rig are in list order.
        assert_eq!(Grid::of(&named(&["a", "b", "c", "d"]), 448).corners[3], [0, row]);
        assert_eq!(Grid::of(&named(&["CAM_BACK"]), 448).corners, [[0, 0]]);
    }

    #[test]
    fn a_sheet_holds_every_map() {
        let set = test_set();
        let (size, pixels) = draw(&set, &DepthBins::default(), "frame");
        assert_eq!(size.height, MARGIN + TITLE + 6 * (TITLE + 4 + MARGIN));
        assert_eq!(pixels.len(), size.pixels());
        let first_tile = (MARGIN + TITLE + TITLE) as usize * size.width as usize + MARGIN as usize;
        assert_eq!(&pixels[first_tile..first_tile + 6], &set.cameras[0].color.as_ref().unwrap()[..6]);
        assert!(!draw(&ConditionSet::default(), &DepthBins::default(), "").1.is_empty());
        // A single map is drawn as in the sheet, and cameras are at the reported positions.
        let (size, color) = draw_map(&set, MapKind::Color, TILE_WIDTH_PX, &DepthBins::default());
        let (same, places) = places(&set, TILE_WIDTH_PX);
        assert_eq!(same, size);
        for (camera, [left, top, width, height]) in set.cameras.iter().zip(places) {
            assert_eq!((width, height), (camera.width, camera.height));
            for (y, row) in camera.color.as_ref().unwrap().chunks(width as usize).enumerate() {
                let at = (top as usize + y) * size.width as usize + left as usize;
                assert_eq!(&color[at..at + row.len()], row, "{}", camera.name);
            }
        }
        assert_eq!(kinds(&set).len(), 6);
    }

    #[test]
    fn numbers_are_colored_over_the_depth() {
        let (mut set, bins) = (test_set(), DepthBins::default());
        let grays = Shades::of(&bins).grays;
        for has_depth in [true, false] {
            set.cameras[0].depth_m.take_if(|_| !has_depth);
            let (size, picture) = draw_map(&set, MapKind::Class, TILE_WIDTH_PX, &bins);
            let (camera, [left, top, width, _]) = (&set.cameras[0], places(&set, TILE_WIDTH_PX).1[0]);
            for (pixel, &class) in (0..).zip(camera.class.iter().flatten()) {
                let depth_m = camera.depth_m.as_ref().map(|depth_m| depth_m[pixel as usize]);
                let ground = depth_m.map_or(EMPTY, |depth_m| grays[usize::from(bins.bin(depth_m))]);
                let at = (top + pixel / width) * size.width + left + pixel % width;
                let expected = if class == 0 { ground } else { class_color(class) };
                assert_eq!(picture[at as usize], expected, "{pixel} {class}");
            }
        }
    }

    #[test]
    fn smaller_images_are_centered_in_their_tiles() {
        let mut set = test_set();
        let small = &mut set.cameras[0];
        (small.width, small.height, small.color) = (2, 2, Some(vec![[200; 3]; 4]));
        let (size, picture) = draw_map(&set, MapKind::Color, TILE_WIDTH_PX, &DepthBins::default());
        let tile = (0..4).flat_map(|y| picture[y * size.width as usize..][..6].to_vec());
        let bright: Vec<usize> =
            tile.enumerate().filter(|(_, rgb)| *rgb != EMPTY).map(|(at, _)| at).collect();
        assert_eq!(bright, [8, 9, 14, 15]);
    }

    #[test]
    fn colors_of_numbers_differ() {
        let colors: std::collections::BTreeSet<[u8; 3]> = (1..200).map(number_color).collect();
        assert!(colors.len() > 190);
        assert!(colors.iter().all(|rgb| rgb.iter().max() > Some(&180)));
    }
}
