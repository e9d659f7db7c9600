//! Ground truth of a view, converted from device results.

use glam::{DAffine3, DMat3, DVec3};
use image::RgbImage;
use point_skeleton::geometry::View;
use point_skeleton::raster::tiles::Tile;

use super::corners::Corners;
use super::lens::NEAR_M;
use super::mesh_draw::MeshDraw;

/// Ground truth of a view, row-major `height * width`.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruthView {
    /// sRGB image.
    pub image: RgbImage,
    /// Camera z at the pixel's centre, meters; `f32::INFINITY` for the sky.
    pub depth_m: Vec<f32>,
    /// [`MeshDraw::class`] at the pixel's centre, 0 for the sky.
    pub class: Vec<u8>,
    /// [`MeshDraw::instance`] at the pixel's centre, 0 for the sky.
    pub instance: Vec<u32>,
}

/// Data read back for a tile, rows without padding.
pub(super) struct Read<'a> {
    /// Provoking vertex of the triangle; draw index plus 1, or 0 for the sky.
    pub(super) shown: &'a [[u32; 2]],
    /// sRGB color.
    pub(super) pixels: &'a [[u8; 4]],
}

impl GroundTruthView {
    /// Creates a view that shows only sky.
    pub(super) fn empty(view: &View) -> Self {
        let pixels = view.camera.width as usize * view.camera.height as usize;
        Self {
            image: RgbImage::new(view.camera.width, view.camera.height),
            depth_m: vec![f32::INFINITY; pixels],
            class: vec![0; pixels],
            instance: vec![0; pixels],
        }
    }

    /// Writes the data of a tile into the view. In one thread: it is called with the renderer locked, and a
    /// thread of the pool that waits for others may take over a job that waits for this renderer.
    pub(super) fn fill(&mut self, tile: &Tile, read: &Read<'_>, scene: &Scene<'_>) {
        let (left, width) = (tile.origin[0] as usize, self.image.width() as usize);
        let (columns, rows) = (tile.size[0] as usize, tile.size[1] as usize);
        let first = tile.origin[1] as usize * width;
        let part = first..first + rows * width;
        let image: &mut [u8] = &mut self.image;
        let lines = self.depth_m[part.clone()]
            .chunks_mut(width)
            .zip(self.class[part.clone()].chunks_mut(width))
            .zip(self.instance[part.clone()].chunks_mut(width))
            .zip(image[3 * first..].chunks_mut(3 * width));
        lines.enumerate().for_each(|(row, (((depth_m, class), instance), rgb))| {
            let y = f64::from(tile.origin[1]) + row as f64 + 0.5;
            let from = row * columns..(row + 1) * columns;
            for (i, (shown, pixel)) in read.shown[from.clone()].iter().zip(&read.pixels[from]).enumerate() {
                let at = left + i;
                rgb[3 * at..3 * at + 3].copy_from_slice(&pixel[..3]);
                let ray = scene.ray(at as f64 + 0.5, y);
                let Some((draw, z)) = scene.hit(*shown, ray) else { continue };
                (depth_m[at], class[at], instance[at]) = (z as f32, draw.class, draw.instance);
            }
        });
    }
}

/// Geometry of all draws for the rays of one view.
pub(super) struct Scene<'a> {
    corners: &'a Corners,
    draws: &'a [MeshDraw],
    camera_from_image: DMat3,
    camera_from_mesh: Vec<DAffine3>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(corners: &'a Corners, draws: &'a [MeshDraw], view: &View) -> Self {
        let camera_from_mesh = draws.iter().map(|d| view.camera_from_world * d.town_from_mesh).collect();
        Self { corners, draws, camera_from_image: view.camera.intrinsics.inverse(), camera_from_mesh }
    }

    /// Returns the ray through an image position, with camera z 1.
    fn ray(&self, x: f64, y: f64) -> DVec3 {
        self.camera_from_image * DVec3::new(x, y, 1.0)
    }

    /// Returns the draw of a triangle and the camera z where the ray meets it, meters; `None` for the sky.
    fn hit(&self, [corner, draw]: [u32; 2], ray: DVec3) -> Option<(&'a MeshDraw, f64)> {
        let number = (draw as usize).checked_sub(1)?;
        let (draw, camera_from_mesh) = (self.draws.get(number)?, self.camera_from_mesh.get(number)?);
        let [a, b, c] = self.corners.triangle(corner)?.map(|p| camera_from_mesh.transform_point3(p));
        let normal = (b - a).cross(c - a);
        let z = normal.dot(a) / normal.dot(ray);
        // A ray almost parallel to the triangle may meet its plane anywhere, so z is clamped to the range of
        // its corners.
        let (low, high) = (a.z.min(b.z).min(c.z), a.z.max(b.z).max(c.z));
        let z = if z.is_finite() { z.clamp(low, high) } else { low };
        Some((draw, z.max(NEAR_M)))
    }
}

/// Returns the first draw whose mesh does not exist, as indices of draw and mesh.
pub(super) fn unknown_mesh(draws: &[MeshDraw], meshes: usize) -> Option<(usize, usize)> {
    draws.iter().enumerate().find(|(_, draw)| draw.mesh >= meshes).map(|(i, draw)| (i, draw.mesh))
}
