//! Ground-truth renderer of the town: color, depth, class and instance of any view, with triangles on the
//! device.
//!
//! # How it works
//! 1. [`Light`] gives the sun's position and the sky; three depth maps around the camera give their
//!    visibility (`maps`), once for all that stands, and for the actors of each view.
//! 2. A view is a grid of samples at half-pixel steps (`lens`). A first pass determines the surface of each
//!    sample (`surfaces`), later passes shade it once, and a last one resolves samples to pixels (`shade`).
//! 3. A pixel's depth, class and instance belong to the sample at its centre. The device reports the
//!    triangle (`corners`), the host computes its depth in `f64` (`truth`).
//!
//! The appearance of a surface follows from its kind, its color and a seed (`glsl/*.frag`); there are no
//! image files.

mod corners;
mod error;
mod lens;
mod light;
mod maps;
mod mesh_draw;
mod shade;
pub mod shaders;
mod surfaces;
mod truth;

pub use error::MeshRenderError;
pub use light::Light;
pub use mesh_draw::MeshDraw;
pub use truth::GroundTruthView;

use std::sync::Arc;

use point_skeleton::geometry::{ImageSize, View};
use point_skeleton::gpu::{Commands, Device};
use point_skeleton::memory::{Need, reserve};
use point_skeleton::raster::StageTimes;
use point_skeleton::raster::tiles::{Tile, TileLimits, grown, tiles};

use self::corners::Corners;
use self::lens::Lens;
use self::maps::{Casters, Frames, Maps, Triangles};
use self::shade::{Samples, ShadePass};
use self::surfaces::SurfacePass;
use self::truth::{Read, Scene};
use super::mesh::Mesh;

/// Memory of a [`GroundTruthView`] per pixel: color, depth, class and instance.
const VIEW_PIXEL_BYTES: u64 = 3 + 4 + 1 + 4;

/// Renderer of resident meshes.
pub struct MeshRenderer {
    device: Arc<Device>,
    commands: Commands,
    corners: Corners,
    triangles: Triangles,
    maps: Maps,
    /// What the maps of standing casters show, if they are whole.
    mapped: Option<Casters>,
    surfaces: SurfacePass,
    shade: ShadePass,
    samples: Option<Samples>,
    limits: TileLimits,
    stages: StageTimes,
}

impl MeshRenderer {
    /// Uploads all meshes; they may be dropped afterwards.
    ///
    /// # Errors
    /// Returns an error if a triangle has a corner that its mesh does not have, if memory is insufficient, or
    /// if the device lacks a required feature.
    pub fn new(device: &Arc<Device>, meshes: &[&Mesh]) -> Result<Self, MeshRenderError> {
        let corners = Corners::new(meshes)?;
        let triangles = Triangles::new(device, &corners)?;
        let (maps, surfaces) = (Maps::new(device)?, SurfacePass::new(device)?);
        let shade = ShadePass::new(device)?;
        let commands = Commands::new(device)?;
        device.check_validation()?;
        Ok(Self {
            device: device.clone(),
            commands,
            corners,
            triangles,
            maps,
            mapped: None,
            surfaces,
            shade,
            samples: None,
            limits: tile_limits(device, None),
            stages: StageTimes::default(),
        })
    }

    /// Limits tiles to `side` pixels per side. Results do not depend on it, except for rounding.
    pub fn with_tile_side(mut self, side: u32) -> Self {
        self.limits = tile_limits(&self.device, Some(side));
        self
    }

    /// Renders draws in views whose world is the town's frame. The views are independent of each other.
    ///
    /// # Errors
    /// Returns an error if a draw has an unknown mesh or if the device fails.
    pub fn render(
        &mut self,
        draws: &[MeshDraw],
        views: &[View],
        light: &Light,
    ) -> Result<Vec<GroundTruthView>, MeshRenderError> {
        let meshes = self.corners.parts.len();
        if let Some((draw, mesh)) = truth::unknown_mesh(draws, meshes) {
            return Err(MeshRenderError::UnknownMesh { draw, mesh, meshes });
        }
        let pixels: u64 = views.iter().map(|view| ImageSize::of(&view.camera).pixels() as u64).sum();
        let bytes = VIEW_PIXEL_BYTES * pixels;
        let _images = reserve(bytes, || Need {
            what: format!("rendering {} images of {pixels} pixels in total", views.len()),
            bytes,
            advice: "fewer or smaller images need less",
        })?;
        let mut mapped: Option<Frames> = None;
        let mut render = |view: &View| {
            let frames = Frames::new(light, view.camera_from_world.inverse().translation);
            if mapped != Some(frames) {
                self.map(draws, light, &frames)?;
                mapped = Some(frames);
            }
            self.render_view(draws, view, (light, &frames))
        };
        views.iter().map(&mut render).collect()
    }

    /// Returns the stages' times on the device, summed since the last call.
    pub fn take_stages(&mut self) -> StageTimes {
        std::mem::take(&mut self.stages)
    }

    fn map(&mut self, draws: &[MeshDraw], light: &Light, frames: &Frames) -> Result<(), MeshRenderError> {
        let [standing, moving] = Casters::of(draws, light, frames);
        let differ = standing.differ(self.mapped.take().as_ref());
        let mut recorder = self.commands.begin()?;
        let (maps, scene) = (&self.maps, (&self.triangles, &self.corners.parts[..]));
        maps.record(&mut recorder, scene, (&maps.standing, differ), &standing)?;
        maps.record(&mut recorder, scene, (&maps.moving, [true; 3]), &moving)?;
        let times = recorder.submit()?;
        times.into_iter().for_each(|(stage, time)| self.stages.add(stage, time));
        self.mapped = Some(standing);
        Ok(())
    }

    fn render_view(
        &mut self,
        draws: &[MeshDraw],
        view: &View,
        lit: (&Light, &Frames),
    ) -> Result<GroundTruthView, MeshRenderError> {
        let mut shown = GroundTruthView::empty(view);
        let tiles = tiles(view.camera.width, view.camera.height, self.limits);
        let Some(largest) = tiles.first() else { return Ok(shown) };
        self.prepare(largest.size)?;
        for tile in &tiles {
            self.render_tile(draws, view, tile, lit, &mut shown)?;
        }
        Ok(shown)
    }

    /// Allocates images and buffers if the current ones are too small.
    fn prepare(&mut self, size: [u32; 2]) -> Result<(), MeshRenderError> {
        let current = self.samples.as_ref().map_or([0; 2], |samples| samples.pixels);
        if size[0] > current[0] || size[1] > current[1] {
            self.samples = None; // free before allocating
            let wanted = grown(current, size, self.limits);
            let scene = (&self.surfaces, &self.maps);
            self.samples = Some(self.shade.samples(&self.device, scene, wanted)?);
        }
        Ok(())
    }

    fn render_tile(
        &mut self,
        draws: &[MeshDraw],
        view: &View,
        tile: &Tile,
        lit: (&Light, &Frames),
        shown: &mut GroundTruthView,
    ) -> Result<(), MeshRenderError> {
        let Some(samples) = &mut self.samples else { return Ok(()) };
        let lens = Lens::new(view, tile);
        let mut recorder = self.commands.begin()?;
        self.shade.update(&mut recorder, &lens, lit)?;
        let triangles = (&self.triangles, &self.corners.parts[..]);
        self.surfaces.record(&mut recorder, &samples.surfaces, &lens, triangles, draws)?;
        self.shade.record(&mut recorder, samples, tile.size)?;
        let times = recorder.submit()?;
        times.into_iter().for_each(|(stage, time)| self.stages.add(stage, time));
        let area = tile.area();
        // Casts to byte arrays, which need no alignment, and converts those to integers.
        let owners: &[[u8; 8]] = bytemuck::cast_slice(&samples.shown_back.bytes_mut()?[..8 * area]);
        let number = |bytes: &[u8; 8], at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let owners: Vec<[u32; 2]> = owners.iter().map(|b| [number(b, 0), number(b, 4)]).collect();
        let pixels: &[[u8; 4]] = bytemuck::cast_slice(&samples.pixel_back.bytes_mut()?[..4 * area]);
        let scene = Scene::new(&self.corners, draws, view);
        shown.fill(tile, &Read { shown: &owners, pixels }, &scene);
        Ok(())
    }
}

/// Returns tile limits that let the samples of a tile fit the device's images.
fn tile_limits(device: &Device, side: Option<u32>) -> TileLimits {
    let limits = device.limits();
    let [viewport_width, viewport_height] = limits.max_viewport_dimensions;
    let largest = [
        limits.max_image_dimension2_d,
        limits.max_framebuffer_width,
        limits.max_framebuffer_height,
        viewport_width,
        viewport_height,
    ];
    let largest = largest.into_iter().min().map_or(1, |samples| (samples - 1) / 2);
    let side = largest.min(side.unwrap_or(largest)).max(1);
    TileLimits { side, area: ShadePass::max_area(device).max(1) }
}
