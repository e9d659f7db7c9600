//! The nearest points of a sector by pixel, and of blocks of pixels at several levels.

use glam::DMat3;
use rayon::prelude::*;

/// Levels; blocks of the last one have 16 pixels a side.
pub(super) const LEVELS: usize = 5;

/// A visible point in the frame of the sector's camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Hit {
    /// Tangents to the right and down: x / z and y / z.
    pub(super) at: [f32; 2],
    /// 1 / z, per meter; 0 where there is none.
    pub(super) inverse_z: f32,
    /// Actor number above the class in the lowest byte.
    pub(super) label: u32,
}

/// Nearest point of each block of pixels.
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    hits: Vec<Hit>,
}

/// Nearest points of a sector.
pub(super) struct SectorImage {
    /// Pixels per tangent.
    pub(super) focal: f64,
    /// Pixel of the axis.
    center: [f64; 2],
    /// From single pixels to blocks of 16.
    pub(super) levels: Vec<Level>,
}

impl SectorImage {
    /// Creates an image of hits, row by row; `size` is its width and height.
    pub(super) fn new(intrinsics: &DMat3, [width, height]: [usize; 2], hits: Vec<Hit>) -> Self {
        let mut levels = vec![Level { width, height, hits }];
        while let (Some(last), true) = (levels.last(), levels.len() < LEVELS) {
            levels.push(last.halved());
        }
        let center = [intrinsics.z_axis.x, intrinsics.z_axis.y];
        Self { focal: intrinsics.x_axis.x, center, levels }
    }

    /// Returns the pixel coordinates of tangents.
    pub(super) fn pixel(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x * self.focal + self.center[0], y * self.focal + self.center[1]]
    }
}

impl Level {
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut hits = vec![Hit::default(); width * height];
        hits.par_chunks_mut(width).enumerate().for_each(|(row, hits)| {
            for (column, hit) in hits.iter_mut().enumerate() {
                // The first of equally near ones stays.
                for of in [[0, 0], [0, 1], [1, 0], [1, 1]] {
                    let other = self.hit(2 * column + of[1], 2 * row + of[0]);
                    if other.inverse_z > hit.inverse_z {
                        *hit = other;
                    }
                }
            }
        });
        Self { width, height, hits }
    }

    /// Returns the hit of a block, without a point outside of the image.
    #[inline(always)]
    pub(super) fn hit(&self, column: usize, row: usize) -> Hit {
        if column < self.width && row < self.height {
            self.hits[row * self.width + column]
        } else {
            Hit::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_their_nearest_hits() {
        let rows = [[10.0, 0.0, 2.5], [0.0, 10.0, 1.0], [0.0, 0.0, 1.0]];
        let intrinsics = DMat3::from_cols_array_2d(&rows).transpose();
        let hits: Vec<Hit> =
            (0..15).map(|i| Hit { inverse_z: [0.0, 0.2, 0.1][i % 3], ..Hit::default() }).collect();
        let image = SectorImage::new(&intrinsics, [5, 3], hits);
        let sizes: Vec<_> = image.levels.iter().map(|level| (level.width, level.height)).collect();
        assert_eq!(sizes, [(5, 3), (3, 2), (2, 1), (1, 1), (1, 1)]);
        // The rows have 0, 2, 1, 0, 2 tenths, then 1, 0, 2, 1, 0, then 2, 1, 0, 2, 1.
        let second = &image.levels[1];
        assert_eq!([0, 1, 2].map(|column| second.hit(column, 1).inverse_z), [0.2, 0.2, 0.1]);
        assert_eq!(image.levels[4].hit(0, 0).inverse_z, 0.2);
        assert_eq!(second.hit(3, 0), Hit::default());
        assert_eq!(image.pixel([0.1, -0.1]), [3.5, 0.0]);
    }
}
