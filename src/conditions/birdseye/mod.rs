//! `FRAME/birdseye.png`: bird's-eye view (BEV) of a step, with the ego at the center, facing up.
//!
//! # How it works
//! All geometry is transformed into the ego frame in `f64`, then into pixels, and drawn antialiased by
//! tiny-skia on one thread. The layers are: the HD map if the state has one, the camera wedges, traces, the
//! boxes, the ego as an arrow, and a scale bar. Boxes have the class colors of the contact sheet and a line
//! from center to front. Geometry outside the image is clipped.

mod clip;

use std::path::Path;

use glam::{DMat2, DVec2, DVec3};
use tiny_skia::{Color, FillRule, Paint, PathBuilder, Pixmap, Stroke, Transform};

use self::clip::{clipped, clipped_line};
use super::ImageSize;
use super::view::canvas::{Canvas, GLYPH};
use super::view::sheet::CLASSES;
use super::write::png;
use crate::dataset::{Area, VectorMap};
use crate::error::FileError;
use crate::geometry::View;
use crate::scene::{ActorState, SceneState};

/// Size and range of the bird's-eye view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BirdseyeOptions {
    /// Height and width, pixels; clamped to 1 to 4096.
    pub side_px: u32,
    /// Distance from the ego to the middle of each side, meters, positive.
    pub reach_m: f64,
}

impl Default for BirdseyeOptions {
    fn default() -> Self {
        Self { side_px: 800, reach_m: 50.0 }
    }
}

/// Red, green, blue, opacity.
type Rgba = [u8; 4];

const BACKGROUND: Rgba = [17, 19, 24, 255];
const DRIVABLE: Rgba = [43, 48, 57, 255];
const DRIVABLE_EDGE: Rgba = [84, 92, 108, 255];
const LANE: Rgba = [92, 214, 128, 110];
const CROSSING: Rgba = [226, 229, 236, 52];
const CROSSING_EDGE: Rgba = [226, 229, 236, 130];
const STOP_LINE: Rgba = [255, 92, 92, 170];
const SIGHT: Rgba = [150, 200, 255, 22];
const SIGHT_EDGE: Rgba = [150, 200, 255, 80];
const CAMERA: Rgba = [176, 214, 255, 255];
const UNKNOWN: [u8; 3] = [148, 153, 163];
const EGO: Rgba = [255, 255, 255, 255];
const SCALE: [u8; 3] = [148, 153, 163];

/// Radius of the camera wedges, meters.
const SIGHT_M: f64 = 14.0;
/// Corners of the ego arrow: meters forward and to the left.
const ARROW: [[f64; 2]; 4] = [[2.6, 0.0], [-2.0, 1.5], [-1.1, 0.0], [-2.0, -1.5]];
/// Maximum side of the image, pixels.
const MAX_SIDE_PX: u32 = 4096;

/// Polyline on the ground, for instance the ego's path.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// Points in order, global x and y, meters.
    pub points: Vec<DVec2>,
    /// Red, green, blue, opacity.
    pub rgba: [u8; 4],
    /// Line width, pixels.
    pub width_px: f32,
}

/// Writes the bird's-eye view as PNG.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(path: &Path, state: &SceneState, options: &BirdseyeOptions) -> Result<(), FileError> {
    write_with(path, state, &[], options)
}

/// Same as [`write()`], with traces drawn between the map and the actors.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_with(
    path: &Path,
    state: &SceneState,
    traces: &[Trace],
    options: &BirdseyeOptions,
) -> Result<(), FileError> {
    let (size, pixels) = draw_with(state, traces, options);
    png::write_rgb(path, &pixels, size)
}

/// Draws the bird's-eye view and returns its size and RGB pixels.
pub fn draw(state: &SceneState, options: &BirdseyeOptions) -> (ImageSize, Vec<[u8; 3]>) {
    draw_with(state, &[], options)
}

/// Same as [`draw`], with traces drawn between the map and the actors.
pub fn draw_with(
    state: &SceneState,
    traces: &[Trace],
    options: &BirdseyeOptions,
) -> (ImageSize, Vec<[u8; 3]>) {
    let side = options.side_px.clamp(1, MAX_SIDE_PX);
    let size = ImageSize { height: side, width: side };
    let mut canvas = Canvas::new(size, [BACKGROUND[0], BACKGROUND[1], BACKGROUND[2]]);
    if let Some(mut picture) = Picture::new(state, side, options.reach_m) {
        if let Some(map) = &state.map {
            picture.map(map.vector_map());
        }
        state.cameras.iter().for_each(|camera| picture.camera(&camera.view));
        traces.iter().for_each(|trace| picture.trace(trace));
        state.actors.iter().for_each(|actor| picture.actor(actor));
        picture.ego();
        let rgb = picture.pixmap.pixels().iter().map(|p| [p.red(), p.green(), p.blue()]);
        canvas.pixels = rgb.collect();
    }
    scale(&mut canvas, options.reach_m);
    (size, canvas.pixels)
}

/// Draws a scale bar of 20 m, or a shorter one if the image covers less.
fn scale(canvas: &mut Canvas, reach_m: f64) {
    let steps_m = [20.0, 10.0, 5.0, 2.0, 1.0];
    let Some(length_m) = steps_m.into_iter().find(|step| *step <= reach_m / 2.0) else { return };
    let side = canvas.size.width;
    let width = (length_m / (2.0 * reach_m) * f64::from(side)).round() as u32;
    let bottom = side.saturating_sub(16);
    canvas.map([16, bottom], ImageSize { height: 2, width }, |_, _| SCALE);
    canvas.text([16, bottom.saturating_sub(GLYPH + 4)], 1, SCALE, &format!("{length_m} m"));
}

/// Draw target with its transform from global coordinates.
struct Picture {
    pixmap: Pixmap,
    /// Position of the ego, global, meters.
    origin: DVec2,
    pixel_from_global: DMat2,
    center_px: f64,
    px_per_m: f64,
}

impl Picture {
    /// Returns `None` if the image cannot be created or the transform is not finite.
    fn new(state: &SceneState, side: u32, reach_m: f64) -> Option<Self> {
        let mut pixmap = Pixmap::new(side, side)?;
        pixmap.fill(color(BACKGROUND));
        let forward = (state.global_from_ego.rotation * DVec3::X).truncate().normalize_or(DVec2::X);
        let px_per_m = f64::from(side) / (2.0 * reach_m);
        // The rows are the image axes in global coordinates: right, and down, which is backward.
        let axes = DMat2::from_cols(DVec2::new(forward.y, -forward.x), -forward).transpose();
        let origin = state.global_from_ego.translation.truncate();
        let center_px = f64::from(side) / 2.0;
        let fits = px_per_m > 0.0 && px_per_m.is_finite() && origin.is_finite();
        fits.then(|| Self { pixmap, origin, pixel_from_global: axes * px_per_m, center_px, px_per_m })
    }

    fn pixel(&self, global: DVec2) -> DVec2 {
        self.pixel_from_global * (global - self.origin) + self.center_px
    }

    fn map(&mut self, map: &VectorMap) {
        for area in &map.drivable_area {
            self.area(area, Some(DRIVABLE), Some(DRIVABLE_EDGE));
        }
        for lane in &map.lanes {
            self.area(&lane.outline, None, Some(LANE));
        }
        for area in &map.crossings {
            self.area(area, Some(CROSSING), Some(CROSSING_EDGE));
        }
        for area in &map.stop_lines {
            self.area(area, Some(STOP_LINE), None);
        }
    }

    fn area(&mut self, area: &Area, fill: Option<Rgba>, edge: Option<Rgba>) {
        let rings: Vec<Vec<DVec2>> = std::iter::once(&area.exterior)
            .chain(&area.holes)
            .map(|ring| ring.iter().map(|corner| self.pixel(*corner)).collect())
            .collect();
        self.shape(&rings, fill, edge.map(|rgba| (rgba, 1.2)));
    }

    /// Draws rings in pixel coordinates: fills them by the even-odd rule, then strokes outlines of a width in
    /// pixels.
    fn shape(&mut self, rings: &[Vec<DVec2>], fill: Option<Rgba>, edge: Option<(Rgba, f32)>) {
        let side = 2.0 * self.center_px;
        let rings: Vec<Vec<DVec2>> = rings.iter().map(|ring| clipped(ring, side)).collect();
        let mut builder = PathBuilder::new();
        for ring in rings.iter().filter(|ring| !ring.is_empty()) {
            for (i, corner) in ring.iter().enumerate() {
                let to = if i == 0 { PathBuilder::move_to } else { PathBuilder::line_to };
                to(&mut builder, corner.x as f32, corner.y as f32);
            }
            builder.close();
        }
        let Some(path) = builder.finish() else { return };
        if let Some(rgba) = fill {
            self.pixmap.fill_path(&path, &paint(rgba), FillRule::EvenOdd, Transform::identity(), None);
        }
        if let Some((rgba, width)) = edge {
            let stroke = Stroke { width, ..Stroke::default() };
            self.pixmap.stroke_path(&path, &paint(rgba), &stroke, Transform::identity(), None);
        }
    }

    /// Draws an open polyline, split where it leaves the image.
    fn trace(&mut self, trace: &Trace) {
        let pixels: Vec<DVec2> = trace.points.iter().map(|point| self.pixel(*point)).collect();
        let mut builder = PathBuilder::new();
        for pair in pixels.windows(2) {
            let Some([from, to]) = clipped_line([pair[0], pair[1]], 2.0 * self.center_px) else { continue };
            // A single path, so that overlapping joints of a translucent line are not drawn twice.
            if builder.last_point().is_none_or(|p| (p.x, p.y) != (from.x as f32, from.y as f32)) {
                builder.move_to(from.x as f32, from.y as f32);
            }
            builder.line_to(to.x as f32, to.y as f32);
        }
        let Some(path) = builder.finish() else { return };
        let (width, round) = (trace.width_px, tiny_skia::LineCap::Round);
        let stroke =
            Stroke { width, line_cap: round, line_join: tiny_skia::LineJoin::Round, ..Stroke::default() };
        self.pixmap.stroke_path(&path, &paint(trace.rgba), &stroke, Transform::identity(), None);
    }

    /// Draws a camera as a dot with a wedge over its horizontal field of view.
    fn camera(&mut self, view: &View) {
        let world_from_camera = view.camera_from_world.inverse();
        let camera_from_image = view.camera.intrinsics.inverse();
        let (width, middle) = (f64::from(view.camera.width), f64::from(view.camera.height) / 2.0);
        let at = self.pixel(world_from_camera.translation.truncate());
        let steps = 12;
        let ray = |i: u32| {
            let column = width * f64::from(i) / f64::from(steps);
            let ray = camera_from_image * DVec3::new(column, middle, 1.0);
            let ray = world_from_camera.transform_vector3(ray).truncate().normalize_or_zero();
            at + self.pixel_from_global * ray * SIGHT_M
        };
        let wedge: Vec<DVec2> = std::iter::once(at).chain((0..=steps).map(ray)).collect();
        self.shape(&[wedge], Some(SIGHT), Some((SIGHT_EDGE, 1.0)));
        let dot = (0..16).map(|i| at + 2.5 * DVec2::from_angle(f64::from(i) * std::f64::consts::PI / 8.0));
        self.shape(&[dot.collect()], Some(CAMERA), None);
    }

    /// Draws a box with a line from its center to the middle of its front.
    fn actor(&mut self, actor: &ActorState) {
        let [r, g, b] = (actor.class as usize).checked_sub(1).map_or(UNKNOWN, |class| CLASSES[class].0);
        let corners = actor.cuboid.corners().map(|corner| self.pixel(corner.truncate()));
        // Corner order around the floor: back right, front right, front left, back left.
        let [a, b_, c, d] = [0, 1, 3, 2].map(|i: usize| corners[i]);
        self.shape(&[vec![a, b_, c, d]], Some([r, g, b, 96]), Some(([r, g, b, 255], 1.5)));
        let center = self.pixel(actor.cuboid.pose.translation.truncate());
        self.shape(&[vec![center, (b_ + c) / 2.0]], None, Some(([r, g, b, 255], 1.5)));
    }

    fn ego(&mut self) {
        let corner = |[forward, left]: [f64; 2]| DVec2::new(-left, -forward) * self.px_per_m + self.center_px;
        let arrow = ARROW.map(corner).to_vec();
        self.shape(&[arrow], Some(EGO), Some((BACKGROUND, 1.0)));
    }
}

fn color([r, g, b, a]: Rgba) -> Color {
    Color::from_rgba8(r, g, b, a)
}

fn paint(rgba: Rgba) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color(color(rgba));
    paint
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::dataset::{Class, Frame, Recording};
    use crate::geometry::{Cuboid, Pose};
    use crate::scene::SceneMap;

    /// Scene at 8 px/m, all rotated about the ego by `yaw_rad`: a drivable square of 60 m around the ego with
    /// a hole of 10 m that starts 10 m ahead, and a car 20 m to the left.
    fn state(yaw_rad: f64) -> SceneState {
        let ego = Pose::from_yaw(yaw_rad, DVec3::new(600_000.0, 4_000_000.0, 3.0));
        let global = |x: f64, y: f64| ego.transform_point(DVec3::new(x, y, 0.0)).truncate();
        let ring = |[left, right]: [f64; 2], [back, front]: [f64; 2]| {
            vec![global(back, left), global(back, right), global(front, right), global(front, left)]
        };
        let area = Area {
            exterior: ring([30.0, -30.0], [-30.0, 30.0]),
            holes: vec![ring([5.0, -5.0], [10.0, 20.0])],
        };
        let map = VectorMap { drivable_area: vec![area], ..VectorMap::default() };
        let (sweeps, images, between_images, boxes) = Default::default();
        let frame = Frame { t_us: 0, global_from_ego: ego, sweeps, images, between_images, boxes };
        let map = SceneMap::new(map, &Recording { frames: vec![frame], ..Recording::default() });
        let place = ego * Pose::from_yaw(0.0, DVec3::new(0.0, 20.0, 0.8));
        let actor = ActorState {
            track: "car".into(),
            category: "vehicle.car".into(),
            class: Class::MotorVehicle,
            cuboid: Cuboid::new(place, DVec3::new(4.0, 2.0, 1.6)).unwrap(),
            appearance: None,
        };
        SceneState {
            name: "000000".into(),
            t_us: 0,
            global_from_ego: ego,
            cameras: Vec::new(),
            actors: vec![actor],
            map: Some(Arc::new(map)),
        }
    }

    #[test]
    fn ego_faces_up_and_left_stays_left() {
        for yaw in [0.0, 0.7, 2.0, -1.9] {
            let (size, pixels) = draw(&state(yaw), &BirdseyeOptions::default());
            assert_eq!((size.height, size.width, pixels.len()), (800, 800, 640_000));
            // Pixel at a position in meters forward and to the left.
            let at = |x: f64, y: f64| pixels[(400.0 - 8.0 * x) as usize * 800 + (400.0 - 8.0 * y) as usize];
            let [background, drivable] = [BACKGROUND, DRIVABLE].map(|c| [c[0], c[1], c[2]]);
            assert_eq!(at(0.5, 0.0), [255; 3], "the arrow");
            assert_eq!((at(15.0, 0.0), at(-15.0, 0.0), at(15.0, 7.0)), (background, drivable, drivable));
            assert_eq!((at(29.0, 29.0), at(31.0, 0.0), at(0.0, -31.0)), (drivable, background, background));
            // The car is blue; its heading line, from center to front, is brighter than its back.
            let [front, back] = [at(1.0, 20.0), at(-1.0, 20.0)];
            assert!(back[2] > drivable[2] + 40 && front[2] > back[2] + 40, "{front:?} {back:?}");
            assert_eq!((at(2.5, 20.0), at(0.0, 18.5), at(0.0, -20.0)), (drivable, drivable, drivable));
        }
    }

    #[test]
    fn invalid_input_does_not_panic() {
        let mut state = state(0.0);
        state.actors[0].cuboid.pose.translation.x = f64::NAN;
        for (side_px, reach_m) in
            [(0, 50.0), (9, 0.0), (9, f64::NAN), (9, -1.0), (9, 1e300), (9, 1e-300), (u32::MAX, 1e-9)]
        {
            let (size, pixels) = draw(&state, &BirdseyeOptions { side_px, reach_m });
            assert_eq!(size.width, side_px.clamp(1, MAX_SIDE_PX));
            assert_eq!(pixels.len(), size.pixels());
        }
        state.global_from_ego.translation.x = f64::INFINITY;
        let (_, pixels) = draw(&state, &BirdseyeOptions { side_px: 9, reach_m: 1.0 });
        assert!(pixels.iter().all(|p| *p == [17, 19, 24]));
    }

    #[test]
    fn traces_are_drawn_and_clipped() {
        let mut state = state(0.0);
        (state.map, state.actors) = (None, Vec::new());
        let global = |x: f64, y: f64| state.global_from_ego.transform_point(DVec3::new(x, y, 0.0)).truncate();
        let line = |points: Vec<DVec2>| Trace { points, rgba: [0, 200, 0, 255], width_px: 4.0 };
        // One line runs along x, 10 m to the left, from far behind to far ahead; the other has a NaN.
        let long = line(vec![global(-1e6, 10.0), global(20.0, 10.0), global(1e6, 10.0)]);
        let bad = line(vec![global(0.0, -10.0), DVec2::NAN, global(5.0, -10.0)]);
        let (_, pixels) = draw_with(&state, &[long, bad, line(Vec::new())], &BirdseyeOptions::default());
        let at = |x: f64, y: f64| pixels[(400.0 - 8.0 * x) as usize * 800 + (400.0 - 8.0 * y) as usize];
        for x in [-49.0, -20.0, 0.0, 20.0, 49.0] {
            assert_eq!((at(x, 10.0), at(x, 11.0), at(x, -10.0)), ([0, 200, 0], [17, 19, 24], [17, 19, 24]));
        }
    }

    #[test]
    fn cameras_are_drawn_as_wedges() {
        let mut state = state(0.0);
        state.map = None;
        state.actors.clear();
        let camera = crate::geometry::Camera::new(
            "c",
            200,
            100,
            [[100.0, 0.0, 100.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]],
        );
        let axes = glam::DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let ego_from_camera =
            Pose { rotation: glam::DQuat::from_mat3(&axes), translation: DVec3::new(4.0, 0.0, 1.5) };
        let camera_from_world = (state.global_from_ego * ego_from_camera).inverse().affine();
        let view = View { camera: camera.unwrap(), camera_from_world };
        state = crate::scene::with_cameras(state, &[view]);
        let (_, pixels) = draw(&state, &BirdseyeOptions::default());
        let at = |x: f64, y: f64| pixels[(400.0 - 8.0 * x) as usize * 800 + (400.0 - 8.0 * y) as usize];
        let background = [17, 19, 24];
        // 90 degrees wide and 14 m long, starting 4 m ahead of the ego.
        for inside in [at(17.5, 0.0), at(10.0, 5.5), at(10.0, -5.5)] {
            assert!(inside[2] > background[2] + 10, "{inside:?}");
        }
        assert_eq!([at(18.7, 0.0), at(10.0, 6.7), at(10.0, -6.7)], [background; 3]);
        assert_eq!(at(4.0, 0.0), [CAMERA[0], CAMERA[1], CAMERA[2]]);
    }
}
