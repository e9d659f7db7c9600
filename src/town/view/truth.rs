//! From what the device tells to what a view shows.

use glam::{DAffine3, DMat3, DVec3};
use image::RgbImage;
use rayon::prelude::*;

use super::corners::Corners;
use super::lens::NEAR_M;
use super::{MeshDraw, TrueView};
use crate::geometry::View;
use crate::raster::tiles::Tile;

/// What is read back for a tile, row by row without gaps.
pub(super) struct Read<'a> {
    /// Corner that begins the triangle; draw and one, 0 where nothing is.
    pub(super) shown: &'a [[u32; 2]],
    /// sRGB.
    pub(super) pixels: &'a [[u8; 4]],
}

impl TrueView {
    /// Of a view that shows nothing yet.
    pub(super) fn empty(view: &View) -> Self {
        let pixels = view.camera.width as usize * view.camera.height as usize;
        Self {
            image: RgbImage::new(view.camera.width, view.camera.height),
            depth_m: vec![f32::INFINITY; pixels],
            class: vec![0; pixels],
            instance: vec![0; pixels],
        }
    }

    /// Takes a tile over.
    pub(super) fn fill(&mut self, tile: &Tile, read: &Read<'_>, scene: &Scene<'_>) {
        let (left, width) = (tile.origin[0] as usize, self.image.width() as usize);
        let (columns, rows) = (tile.size[0] as usize, tile.size[1] as usize);
        let first = tile.origin[1] as usize * width;
        let part = first..first + rows * width;
        let image: &mut [u8] = &mut self.image;
        let lines = self.depth_m[part.clone()]
            .par_chunks_mut(width)
            .zip(self.class[part.clone()].par_chunks_mut(width))
            .zip(self.instance[part.clone()].par_chunks_mut(width))
            .zip(image[3 * first..].par_chunks_mut(3 * width));
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

/// What rays meet in one view.
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

    /// With camera z 1.
    fn ray(&self, x: f64, y: f64) -> DVec3 {
        self.camera_from_image * DVec3::new(x, y, 1.0)
    }

    /// Whose triangle is met, and at which camera z, metres.
    fn hit(&self, [corner, draw]: [u32; 2], ray: DVec3) -> Option<(&'a MeshDraw, f64)> {
        let number = (draw as usize).checked_sub(1)?;
        let (draw, camera_from_mesh) = (self.draws.get(number)?, self.camera_from_mesh.get(number)?);
        let [a, b, c] = self.corners.triangle(corner)?.map(|p| camera_from_mesh.transform_point3(p));
        let normal = (b - a).cross(c - a);
        let z = normal.dot(a) / normal.dot(ray);
        // A ray along the triangle meets its plane anywhere: the depth stays among those of its corners.
        let (low, high) = (a.z.min(b.z).min(c.z), a.z.max(b.z).max(c.z));
        let z = if z.is_finite() { z.clamp(low, high) } else { low };
        Some((draw, z.max(NEAR_M)))
    }
}

/// Draws that name no mesh.
pub(super) fn unknown_mesh(draws: &[MeshDraw], meshes: usize) -> Option<(usize, usize)> {
    draws.iter().enumerate().find(|(_, draw)| draw.mesh >= meshes).map(|(i, draw)| (i, draw.mesh))
}
