//! Tiles: rectangular parts of an image that fit the device's limits.

/// Rectangular part of an image, rendered in one pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Top left corner: x and y, pixels.
    pub origin: [u32; 2],
    /// Width and height, pixels.
    pub size: [u32; 2],
}

/// Size limits of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileLimits {
    /// Maximum side length, pixels.
    pub side: u32,
    /// Maximum area, pixels.
    pub area: u32,
}

impl Tile {
    /// Returns the number of pixels.
    pub fn area(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }

    /// Copies the tile's pixels (tightly packed rows) to their position in an image `width` pixels wide.
    pub(crate) fn copy_into<T: Copy>(&self, pixels: &[T], image: &mut [T], width: u32) {
        let (from, to) = (self.size[0] as usize, width as usize);
        for (row, line) in pixels.chunks_exact(from).take(self.size[1] as usize).enumerate() {
            let start = (self.origin[1] as usize + row) * to + self.origin[0] as usize;
            image[start..start + from].copy_from_slice(line);
        }
    }
}

/// Returns the tiles that cover a `width × height` image; the first is the largest.
pub fn tiles(width: u32, height: u32, limits: TileLimits) -> Vec<Tile> {
    let columns = width.min(limits.side).min(limits.area).max(1);
    let rows = height.min(limits.side).min(limits.area / columns).max(1);
    let mut tiles = Vec::new();
    for y in (0..height).step_by(rows as usize) {
        for x in (0..width).step_by(columns as usize) {
            tiles.push(Tile { origin: [x, y], size: [columns.min(width - x), rows.min(height - y)] });
        }
    }
    tiles
}

/// Returns the size of images that replace images of size `current` and hold `needed` pixels per side. No
/// side shrinks, so that views of different sizes share them, unless the area would exceed the limit.
pub fn grown(current: [u32; 2], needed: [u32; 2], limits: TileLimits) -> [u32; 2] {
    let both = [current[0].max(needed[0]), current[1].max(needed[1])];
    let fits = u64::from(both[0]) * u64::from(both[1]) <= u64::from(limits.area);
    if fits { both } else { needed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_each_pixel_once() {
        for (side, area) in [(100, 10_000), (7, 49), (7, 20), (3, 3), (1, 1)] {
            let limits = TileLimits { side, area };
            let mut image = vec![0; 17 * 11];
            let mut counts = vec![0; 17 * 11];
            for tile in tiles(17, 11, limits) {
                assert!(tile.area() <= area as usize && tile.size.iter().all(|s| *s <= side));
                let mut part = vec![0; tile.area()];
                for (i, pixel) in part.iter_mut().enumerate() {
                    let (x, y) = (i as u32 % tile.size[0], i as u32 / tile.size[0]);
                    *pixel = (tile.origin[1] + y) * 17 + tile.origin[0] + x;
                    counts[*pixel as usize] += 1;
                }
                tile.copy_into(&part, &mut image, 17);
            }
            assert!(image.iter().enumerate().all(|(i, v)| i as u32 == *v), "{limits:?}");
            assert!(counts.iter().all(|c| *c == 1), "{limits:?}");
        }
    }

    #[test]
    fn images_grow_until_they_are_too_large() {
        let limits = TileLimits { side: 100, area: 5000 };
        assert_eq!(grown([60, 40], [50, 70], limits), [60, 70]);
        assert_eq!(grown([90, 40], [50, 70], limits), [50, 70]);
    }
}
