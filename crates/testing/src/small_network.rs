//! A small network with random weights, and synthetic recordings for it: textured patches pass two cameras.

use image::{Rgb, RgbImage};
use point_skeleton::geometry::ImageSize;
use pskel_generate::{DroppedConditions, FrameConditions, Recipe};
use pskel_network::{Attend, NetworkConfig, Statistics, Weights};

const SIZE: ImageSize = ImageSize { height: 32, width: 64 };

pub const VIEWS: usize = 2;

/// A synthetic recording.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Conditions of the frames.
    pub conditions: Vec<FrameConditions>,
    /// Images of each frame, one per camera.
    pub images: Vec<Vec<RgbImage>>,
}

pub fn config() -> NetworkConfig {
    NetworkConfig {
        recipe: recipe(),
        frames: 4,
        encoder: [16; 4],
        decoder: [16; 4],
        width: 32,
        head: 16,
        hidden: 48,
        blocks: vec![Attend::Space, Attend::Views, Attend::Time],
    }
}

fn recipe() -> Recipe {
    Recipe { drawn: SIZE, size: SIZE, ..Recipe::default() }
}

/// Returns the texture of a patch, one of four.
fn kind(number: usize, view: usize, frame: usize, x: usize, y: usize) -> usize {
    (x / 16 + 3 * (y / 16) + 2 * view + frame + number) * 5 % 7 % 4
}

/// Returns a level of a texture.
fn shade(kind: usize, x: usize, y: usize, color: usize) -> u8 {
    let seed = (kind * 48 + (y % 4) * 12 + (x % 4) * 3 + color) as u32 + 1;
    (seed.wrapping_mul(2_654_435_761) >> 24) as u8
}

/// Returns a synthetic recording: two cameras pass textured patches; the color map has holes.
pub fn clip(number: usize, frames: usize) -> Clip {
    clip_for(&recipe(), VIEWS, number, frames)
}

/// Returns a recording of some cameras as a network's recipe renders it.
pub fn clip_for(recipe: &Recipe, views: usize, number: usize, frames: usize) -> Clip {
    let all = (0..frames).map(|frame| made(recipe, views, number, frame));
    let (conditions, images) = all.unzip();
    Clip { conditions, images }
}

fn made(recipe: &Recipe, views: usize, number: usize, frame: usize) -> (FrameConditions, Vec<RgbImage>) {
    #[rustfmt::skip]
    let camera = |yaw: f32| [
        yaw.sin(), 0.0, yaw.cos(), 1.0,
        -yaw.cos(), 0.0, yaw.sin(), 0.0,
        0.0, -1.0, 0.0, 1.5,
        0.8, 1.4, 0.5, 0.5,
    ];
    let size = recipe.size;
    let mut made = FrameConditions {
        size,
        color: Vec::new(),
        bins: Vec::new(),
        depth_bins: recipe.bins,
        boxes: Vec::new(),
        map: Vec::new(),
        dropped: DroppedConditions::default(),
        action: [1.0, 0.1 * frame as f32, 0.02],
        cameras: (0..views).map(|view| camera(0.5 - view as f32)).collect(),
        prompts: Default::default(),
    };
    let truth = |view, y, x| [0, 1, 2].map(|color| shade(kind(number, view, frame, x, y), x, y, color));
    for (view, y, x) in places(views, size) {
        let is_hole = !(x * 7 + y * 3 + frame).is_multiple_of(5);
        made.color.push(if is_hole { [0; 3] } else { truth(view, y, x).map(|level| level.max(1)) });
        made.bins.push(if is_hole { 0 } else { 1 + ((y * 8 + x) % 256) as u16 });
        made.boxes.push(if x / 16 == frame % 4 { [255, 0, 0] } else { [0; 3] });
        made.map
            .push([kind(number, view, frame, x, y) & 1, (x / 16 + y / 16) & 1, 0].map(|bit| 255 * bit as u8));
    }
    let image = |view: usize| {
        RgbImage::from_fn(size.width, size.height, |x, y| Rgb(truth(view, y as usize, x as usize)))
    };
    (made, (0..views).map(image).collect())
}

/// Iterates over pixels: view, row, column.
fn places(views: usize, size: ImageSize) -> impl Iterator<Item = (usize, usize, usize)> {
    let (height, width) = (size.height as usize, size.width as usize);
    (0..views * height * width).map(move |i| (i / width / height, i / width % height, i % width))
}

pub fn statistics() -> Statistics {
    Statistics { means: vec![0.4, 0.45, 0.5], scales: vec![0.2, 0.25, 0.3], priors: vec![0.3, 0.4, 0.5] }
}

/// Returns random weights.
pub fn weights() -> Weights {
    Weights::random(&config(), &statistics(), 5).unwrap()
}
