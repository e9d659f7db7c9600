//! Random changes to the frames of a window: appearance, exposure, points, and reflection.

use point_skeleton::geometry::ImageSize;
use pskel_generate::DriveFrame;
use rand_chacha::ChaCha8Rng;
use rand_core::Rng;

/// Changes of a window.
pub(super) struct Augmentation {
    appearance: Option<Appearance>,
    /// Color factor of each camera.
    exposures: Vec<f32>,
    thinning: Thinning,
    is_mirrored: bool,
}

/// Color change of points and images alike.
struct Appearance {
    gamma: f32,
    gains: [f32; 3],
    offset: f32,
    saturation: f32,
}

/// Points that are removed.
#[derive(Default)]
struct Thinning {
    /// Share of single pixels.
    pixels: f32,
    /// Share of 8x8-pixel blocks.
    blocks: f32,
    /// Rows at the top, as a share of the height.
    top: f32,
}

/// Block side of [`Thinning`].
const BLOCK: usize = 8;

/// Samples a uniform number in [0, 1), of 24 bits.
pub(super) fn unit(random: &mut ChaCha8Rng) -> f32 {
    (random.next_u32() >> 8) as f32 / (1_u32 << 24) as f32
}

fn between(random: &mut ChaCha8Rng, low: f32, high: f32) -> f32 {
    low + (high - low) * unit(random)
}

impl Augmentation {
    /// Draws the changes for a window with `views` cameras, each with a probability of `share`.
    pub(super) fn draw(share: f32, views: usize, random: &mut ChaCha8Rng) -> Self {
        let mut chance = |of: f32| unit(random) < of * share;
        let [changed, exposed, thinned, cut, covered, mirrored] =
            [1.0, 1.0, 0.8, 0.4, 0.4, 0.5].map(&mut chance);
        let gain = between(random, -0.3, 0.3);
        let appearance = Appearance {
            gamma: between(random, -0.4, 0.4).exp(),
            gains: [0; 3].map(|_| (gain + between(random, -0.12, 0.12)).exp()),
            offset: between(random, -0.08, 0.08),
            saturation: between(random, 0.4, 1.5),
        };
        let exposures = (0..views).map(|_| between(random, -0.05, 0.05).exp());
        let exposures = if exposed { exposures.collect() } else { vec![1.0; views] };
        let mut part = |is: bool, most: f32| if is { between(random, 0.0, most) } else { 0.0 };
        let thinning =
            Thinning { pixels: part(thinned, 0.7), blocks: part(covered, 0.4), top: part(cut, 0.5) };
        Self { appearance: changed.then_some(appearance), exposures, thinning, is_mirrored: mirrored }
    }

    /// Changes a frame.
    pub(super) fn apply(&self, frame: &mut DriveFrame, size: ImageSize, random: &mut ChaCha8Rng) {
        let pixels = size.pixels();
        if let Some(appearance) = &self.appearance {
            let known = frame.color.iter().zip(&frame.bins).map(|(color, bin)| *color != [0; 3] || *bin > 0);
            let known: Vec<bool> = known.collect();
            frame.truth.iter_mut().for_each(|pixel| *pixel = appearance.of(*pixel));
            let colors = frame.color.iter_mut().zip(known).filter(|(_, known)| *known);
            colors.for_each(|(pixel, _)| *pixel = visible(appearance.of(*pixel)));
        }
        for (color, exposure) in frame.color.chunks_mut(pixels).zip(&self.exposures) {
            let scale = |level: u8| (f32::from(level) * exposure).round() as u8;
            color.iter_mut().filter(|c| **c != [0; 3]).for_each(|c| *c = visible(c.map(scale)));
        }
        self.thinning.apply(frame, size, random);
        if self.is_mirrored {
            mirror(frame, size);
        }
    }
}

/// Returns a color that is not taken for an empty pixel.
fn visible(color: [u8; 3]) -> [u8; 3] {
    if color == [0; 3] { [1; 3] } else { color }
}

impl Appearance {
    fn of(&self, pixel: [u8; 3]) -> [u8; 3] {
        let levels = pixel.map(|level| (f32::from(level) / 255.0).powf(self.gamma));
        let gray = levels.iter().sum::<f32>() / 3.0;
        std::array::from_fn(|c| {
            let level = (gray + (levels[c] - gray) * self.saturation) * self.gains[c] + self.offset;
            (level * 255.0).round() as u8 // saturates
        })
    }
}

impl Thinning {
    fn apply(&self, frame: &mut DriveFrame, size: ImageSize, random: &mut ChaCha8Rng) {
        let (height, width) = (size.height as usize, size.width as usize);
        let across = width.div_ceil(BLOCK);
        let top = (self.top * height as f32) as usize;
        let mut share = |of: f32| of > 0.0 && unit(random) < of;
        let images = frame.color.chunks_mut(height * width).zip(frame.bins.chunks_mut(height * width));
        for (color, bins) in images {
            let covered: Vec<bool> =
                (0..across * height.div_ceil(BLOCK)).map(|_| share(self.blocks)).collect();
            for (i, (color, bin)) in color.iter_mut().zip(bins).enumerate() {
                let (y, x) = (i / width, i % width);
                if share(self.pixels) || y < top || covered[y / BLOCK * across + x / BLOCK] {
                    (*color, *bin) = ([0; 3], 0);
                }
            }
        }
    }
}

/// Mirrors the world at the ego's vertical plane: images from left to right, cameras from the other side.
fn mirror(frame: &mut DriveFrame, size: ImageSize) {
    let (pixels, width) = (size.pixels(), size.width as usize);
    for image in [&mut frame.color, &mut frame.boxes, &mut frame.map, &mut frame.truth] {
        image.chunks_mut(width).for_each(<[_]>::reverse);
        reverse_images(image, pixels);
    }
    frame.bins.chunks_mut(width).for_each(<[_]>::reverse);
    reverse_images(&mut frame.bins, pixels);
    frame.cameras.reverse();
    for camera in &mut frame.cameras {
        // The ego's y axis and the camera's x axis change their directions.
        for (i, value) in camera.iter_mut().enumerate().take(12) {
            if (i / 4 == 1) != (i % 4 == 0) {
                *value = -*value;
            }
        }
        camera[14] = 1.0 - camera[14];
    }
    let [_, left, turn] = &mut frame.action;
    (*left, *turn) = (-*left, -*turn);
}

fn reverse_images<T: Copy>(images: &mut [T], pixels: usize) {
    let reversed: Vec<T> = images.chunks(pixels).rev().flatten().copied().collect();
    images.copy_from_slice(&reversed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_seeder::Seeder;

    const SIZE: ImageSize = ImageSize { height: 8, width: 16 };

    fn frame() -> DriveFrame {
        let level = |i: usize, c: usize| ((i * 7 + c * 50) % 250 + 3) as u8;
        let image: Vec<[u8; 3]> = (0..256).map(|i| [0, 1, 2].map(|c| level(i, c))).collect();
        let mut camera = [0.0; 16];
        camera.iter_mut().enumerate().for_each(|(i, value)| *value = 0.1 * i as f32);
        DriveFrame {
            color: image.clone(),
            bins: (0..256).map(|i| i as u16 + 1).collect(),
            boxes: image.clone(),
            map: image.clone(),
            truth: image,
            action: [1.0, 0.5, 0.1],
            cameras: vec![camera, [0.25; 16]],
        }
    }

    #[test]
    fn mirroring_twice_is_identity() {
        let mut changed = frame();
        mirror(&mut changed, SIZE);
        assert_eq!(changed.action, [1.0, -0.5, -0.1]);
        // The second camera comes first; its left pixel is on the right.
        assert_eq!((changed.truth[15], changed.bins[15]), (frame().truth[128], 129));
        let numbers = changed.cameras[1];
        assert_eq!(numbers[..8], [-0.0, 0.1, 0.2, 0.3, 0.4, -0.5, -0.6, -0.7]);
        assert!((numbers[8] + 0.8).abs() < 1e-6 && (numbers[14] + 0.4).abs() < 1e-6);
        mirror(&mut changed, SIZE);
        assert!(changed.cameras[0].iter().zip(frame().cameras[0]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(DriveFrame { cameras: frame().cameras, ..changed }, frame());
    }

    #[test]
    fn thinning_only_removes_points() {
        let mut random: ChaCha8Rng = Seeder::from(3_u64).into_rng();
        let mut removed = 0;
        for _ in 0..50 {
            let augmentation = Augmentation::draw(1.0, 2, &mut random);
            let mut sparse = frame();
            (sparse.color[5], sparse.bins[5]) = ([0; 3], 0);
            augmentation.apply(&mut sparse, SIZE, &mut random);
            let at = if augmentation.is_mirrored { 128 + 10 } else { 5 };
            assert_eq!((sparse.color[at], sparse.bins[at]), ([0; 3], 0));
            assert!(sparse.color.iter().zip(&sparse.bins).all(|(c, bin)| (*c == [0; 3]) == (*bin == 0)));
            removed += sparse.bins.iter().filter(|bin| **bin == 0).count();
        }
        assert!((1500..9000).contains(&removed), "{removed}");
        let mut same = frame();
        Augmentation::draw(0.0, 2, &mut random).apply(&mut same, SIZE, &mut random);
        assert_eq!(same, frame());
    }
}
