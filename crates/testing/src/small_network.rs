//! A small network and synthetic recordings to train it: textured patches pass two cameras.

use point_skeleton::geometry::ImageSize;
use pskel_generate::{DriveFrame, DriveInfo, Recipe, TrainingClip};
use pskel_network::train::measure;
use pskel_network::{Attend, NetworkConfig, Weights};

const SIZE: ImageSize = ImageSize { height: 16, width: 32 };

pub const VIEWS: usize = 2;

pub fn config() -> NetworkConfig {
    NetworkConfig {
        recipe: recipe(),
        frames: 4,
        channels: [16; 4],
        width: 32,
        head: 16,
        hidden: 48,
        blocks: vec![Attend::Space, Attend::Views, Attend::Time],
    }
}

fn recipe() -> Recipe {
    Recipe { size: SIZE, ..Recipe::default() }
}

/// Returns the texture of a patch, one of four; the map determines it.
fn kind(number: usize, view: usize, frame: usize, x: usize, y: usize) -> usize {
    (x / 4 + 3 * (y / 4) + 2 * view + frame + number) * 5 % 7 % 4
}

/// Returns a level of a texture.
fn shade(kind: usize, x: usize, y: usize, color: usize) -> u8 {
    let seed = (kind * 48 + (y % 4) * 12 + (x % 4) * 3 + color) as u32 + 1;
    (seed.wrapping_mul(2_654_435_761) >> 24) as u8
}

/// Returns a synthetic recording: two cameras pass textured patches; the color map has holes.
pub fn clip(number: usize, frames: usize) -> TrainingClip {
    clip_for(&config(), VIEWS, number, frames)
}

/// Returns a recording of some cameras in the format of a network.
pub fn clip_for(config: &NetworkConfig, views: usize, number: usize, frames: usize) -> TrainingClip {
    let cameras = (0..views).map(|view| format!("camera {view}")).collect();
    let source = String::new();
    let about =
        DriveInfo { log: format!("made {number}"), source, hz: 5.0, cameras, recipe: config.recipe.clone() };
    let frame = |frame: usize| {
        let mut made = DriveFrame { action: [1.0, 0.1 * frame as f32, 0.02], ..DriveFrame::default() };
        for (view, y, x) in places(views, config.recipe.size) {
            let kind = kind(number, view, frame, x, y);
            let truth = [0, 1, 2].map(|color| shade(kind, x, y, color));
            let is_hole = !(x * 7 + y * 3 + frame).is_multiple_of(5);
            made.truth.push(truth);
            made.color.push(if is_hole { [0; 3] } else { [truth[0] / 4; 3] });
            made.bins.push(if is_hole { 0 } else { 1 + ((y * 8 + x) % 256) as u16 });
            made.boxes.push(if x / 8 == frame % 4 { [255, 0, 0] } else { [0; 3] });
            // The kind's low bit determines whether two colors differ, so no linear guess can predict it.
            let [low, high, mask] = [kind & 1, kind >> 1, (x / 4 + y / 4) & 1];
            made.map.push([high, mask, mask ^ low].map(|bit| 255 * bit as u8));
        }
        #[rustfmt::skip]
        let camera = |yaw: f32| [
            yaw.sin(), 0.0, yaw.cos(), 1.0,
            -yaw.cos(), 0.0, yaw.sin(), 0.0,
            0.0, -1.0, 0.0, 1.5,
            0.8, 1.4, 0.5, 0.5,
        ];
        made.cameras = (0..views).map(|view| camera(0.5 - view as f32)).collect();
        made
    };
    TrainingClip { about, frames: (0..frames).map(frame).collect() }
}

/// Iterates over pixels: view, row, column.
fn places(views: usize, size: ImageSize) -> impl Iterator<Item = (usize, usize, usize)> {
    let (height, width) = (size.height as usize, size.width as usize);
    (0..views * height * width).map(move |i| (i / width / height, i / width % height, i % width))
}

pub fn weights(drives: &[TrainingClip]) -> Weights {
    let statistics = measure(&config(), drives).unwrap();
    Weights::fresh(&config(), &statistics, 5).unwrap()
}
