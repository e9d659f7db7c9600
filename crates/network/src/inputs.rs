//! Conditions as the network takes them.

use pskel_generate::{CAMERA_NUMBERS, FrameConditions, NO_ACTION, NO_COLOR};
use rayon::prelude::*;

use super::fill::fill;
use super::model::Images;
use super::{NetworkConfig, NetworkError};
use crate::weights::config::{CELL, LATENT_CHANNELS, TOKEN, WORK};

/// Numbers of a pixel: filled color (3), filled depth, how much of color and depth is known (2), layout (6),
/// direction of the ray in the ego frame (3), and a zero.
pub(super) const PLANES: usize = 16;
/// Value count of a token's ray: its direction in the ego frame, and sines and cosines of 1, 2, 4 and 8 times
/// it.
pub(super) const RAY: usize = 3 + 2 * 3 * OCTAVES;
const OCTAVES: usize = 4;
/// Value count of the ego motion: forward, left, turn, and whether it is known.
pub(super) const EGO: usize = 4;
/// Typical ego motion per frame, its divisor: meters forward, meters to the left, radians.
const EGO_SCALES: [f32; 3] = [2.0, 0.5, 0.1];
/// Center of colors and depths.
const CENTER: f32 = 0.5;
/// Filled colors and depths are shown as `GAIN (value - CENTER)`, about as large as the other numbers.
const GAIN: f32 = 4.0;

/// Conditions of a frame for encoder and denoiser.
#[derive(Clone, Debug)]
pub(crate) struct WorkInputs {
    /// Numbers of 4x4 pixels: means of what is known, with holes filled after that, `[V, H/4, W/4, 16]`.
    pub(crate) planes: Images,
    /// Means of the filled color over 16x16 pixels, 0 to 1, `[V h w, 3]`.
    pub(crate) cells: Vec<f32>,
    /// Rays of tokens, `[V h/2 w/2, 27]`.
    pub(crate) rays: Vec<f32>,
    /// Ego motion.
    pub(crate) ego: [f32; EGO],
}

/// Conditions of a frame for the decoder.
#[derive(Clone, Debug)]
pub(crate) struct FullInputs {
    /// Numbers of 2x2 pixels, `[V, H/2, W/2, 64]`: channel `4 c + 2 y + x`.
    pub(crate) planes: Images,
    /// Filled color, `[V H W]`.
    pub(crate) color: Vec<[f32; 3]>,
}

/// Condition maps of a camera, `[H W]`.
struct Maps<'a> {
    color: Vec<[f32; 3]>,
    depth: Vec<[f32; 1]>,
    has_color: Vec<bool>,
    has_depth: Vec<bool>,
    /// Boxes and HD map; `None` if dropped.
    layout: Option<[&'a [[u8; 3]]; 2]>,
    camera: &'a [f32; CAMERA_NUMBERS],
}

impl Maps<'_> {
    /// Returns the layout of a pixel, 0 to 1.
    fn layout(&self, pixel: usize) -> [f32; 6] {
        let Some([boxes, map]) = self.layout else { return [NO_COLOR; 6] };
        let ([r, g, b], [s, t, u]) = (boxes[pixel], map[pixel]);
        [r, g, b, s, t, u].map(|level| f32::from(level) / 255.0)
    }
}

/// Checks that the conditions of a frame fit the network.
///
/// # Errors
/// Returns an error if the frame has another size, or if its cameras are not 1 to 8.
pub(crate) fn check(config: &NetworkConfig, frame: &FrameConditions) -> Result<(), NetworkError> {
    let (views, size) = (frame.views(), config.recipe.size);
    NetworkConfig::check_cameras(views)?;
    if frame.size == size && frame.is_whole() {
        return Ok(());
    }
    let found = format!("{views} of {}", frame.size);
    Err(NetworkError::input(format!("conditions of {views} cameras of {size}"), found))
}

/// Returns the inputs of encoder and denoiser of a frame that was [checked](check).
pub(crate) fn work_inputs(config: &NetworkConfig, frame: &FrameConditions) -> WorkInputs {
    let [height, width] = config.divided(WORK);
    let views = frame.views();
    let of = |view: usize| {
        let maps = maps(frame, view);
        let planes = work_planes(&maps, [height, width]);
        [cells(&planes, width), planes, token_rays(config, maps.camera)]
    };
    let all: Vec<[Vec<f32>; 3]> = (0..views).into_par_iter().map(of).collect();
    let joined = |part: usize| all.iter().map(|parts| parts[part].as_slice()).collect::<Vec<_>>().concat();
    let [cells, values, rays] = [0, 1, 2].map(joined);
    WorkInputs {
        planes: Images { count: views, height, width, channels: PLANES, values },
        cells,
        rays,
        ego: ego_numbers(frame.action),
    }
}

/// Returns the decoder's inputs for a frame that was [checked](check).
pub(crate) fn full_inputs(config: &NetworkConfig, frame: &FrameConditions) -> FullInputs {
    let ([height, width], views) = (config.divided(2), frame.views());
    let all: Vec<(Vec<f32>, Vec<[f32; 3]>)> =
        (0..views).into_par_iter().map(|view| full_planes(&maps(frame, view), config.divided(1))).collect();
    let values = all.iter().map(|(planes, _)| planes.as_slice()).collect::<Vec<_>>().concat();
    FullInputs {
        planes: Images { count: views, height, width, channels: 4 * PLANES, values },
        color: all.iter().map(|(_, color)| color.as_slice()).collect::<Vec<_>>().concat(),
    }
}

/// Returns the maps of a camera.
fn maps(frame: &FrameConditions, view: usize) -> Maps<'_> {
    let pixels = view * frame.size.pixels()..(view + 1) * frame.size.pixels();
    let (color, has_color) = known_color(frame, view);
    let last = f32::from(frame.depth_bins.count - 1);
    let bins = &frame.bins[pixels.clone()];
    // A depth as `TensorEncoder` has it.
    let depth = bins.iter().map(|bin| [f32::from((*bin).min(frame.depth_bins.count - 1)) / last]).collect();
    Maps {
        color,
        depth,
        has_color,
        has_depth: bins.iter().map(|bin| *bin > 0 && !frame.dropped.depth).collect(),
        layout: (!frame.dropped.layout).then(|| [&frame.boxes[pixels.clone()], &frame.map[pixels]]),
        camera: &frame.cameras[view],
    }
}

/// Returns the colors of a camera's points, and where they are known.
fn known_color(frame: &FrameConditions, view: usize) -> (Vec<[f32; 3]>, Vec<bool>) {
    let pixels = frame.size.pixels();
    let color = &frame.color[view * pixels..][..pixels];
    let known = color.iter().map(|color| *color != [0; 3] && !frame.dropped.color).collect();
    (color.iter().map(|color| color.map(|level| f32::from(level) / 255.0)).collect(), known)
}

/// Returns the colors of a camera's points with their holes filled.
pub(super) fn filled_color(frame: &FrameConditions, view: usize) -> Vec<[f32; 3]> {
    let (color, known) = known_color(frame, view);
    fill(color, &known, frame.size.width as usize)
}

/// Returns the numbers of 2x2 pixels, `[H/2 W/2, 64]`, and the filled color, `[H W]`.
fn full_planes(maps: &Maps<'_>, [height, width]: [usize; 2]) -> (Vec<f32>, Vec<[f32; 3]>) {
    let color = fill(maps.color.clone(), &maps.has_color, width);
    let depth = fill(maps.depth.clone(), &maps.has_depth, width);
    let pixels = height * width;
    let mut planes = vec![0.0; pixels * PLANES];
    for i in 0..pixels {
        let (y, x) = (i / width, i % width);
        let numbers = numbers(
            color[i],
            depth[i][0],
            [maps.has_color[i], maps.has_depth[i]].map(|known| if known { 1.0 } else { 0.0 }),
            maps.layout(i),
            direction(maps.camera, place([y, x], [height, width])),
        );
        let block = &mut planes[(y / 2 * (width / 2) + x / 2) * 4 * PLANES..][..4 * PLANES];
        let at = 2 * (y % 2) + x % 2;
        numbers.into_iter().enumerate().for_each(|(c, value)| block[4 * c + at] = value);
    }
    (planes, color)
}

/// Returns the numbers of 4x4 pixels, `[H/4 W/4, 16]`.
fn work_planes(maps: &Maps<'_>, [height, width]: [usize; 2]) -> Vec<f32> {
    let (color, color_share) = reduced(&maps.color, &maps.has_color, width);
    let (depth, depth_share) = reduced(&maps.depth, &maps.has_depth, width);
    let mut planes = Vec::with_capacity(height * width * PLANES);
    for i in 0..height * width {
        let (y, x) = (i / width, i % width);
        let mut layout = [0.0_f32; 6];
        for (down, across) in (0..WORK).flat_map(|down| (0..WORK).map(move |across| (down, across))) {
            let pixel = (y * WORK + down) * width * WORK + x * WORK + across;
            layout.iter_mut().zip(maps.layout(pixel)).for_each(|(sum, level)| *sum += level);
        }
        planes.extend(numbers(
            color[i],
            depth[i][0],
            [color_share[i], depth_share[i]],
            layout.map(|sum| sum / (WORK * WORK) as f32),
            direction(maps.camera, place([y, x], [height, width])),
        ));
    }
    planes
}

/// Returns the means of known pixels over 4x4 pixels, with holes filled after that, and the share of pixels
/// that are known; the reduced image has this `width`.
fn reduced<const C: usize>(values: &[[f32; C]], known: &[bool], width: usize) -> (Vec<[f32; C]>, Vec<f32>) {
    let count = values.len() / (WORK * WORK);
    let (mut means, mut counts) = (vec![[0.0_f32; C]; count], vec![0_u8; count]);
    for (i, (value, known)) in values.iter().zip(known).enumerate() {
        if *known {
            let (y, x) = (i / (width * WORK), i % (width * WORK));
            let at = y / WORK * width + x / WORK;
            counts[at] += 1;
            means[at].iter_mut().zip(value).for_each(|(sum, value)| *sum += value);
        }
    }
    let mean = |(sums, count): (&[f32; C], &u8)| sums.map(|sum| sum / f32::from((*count).max(1)));
    let means = means.iter().zip(&counts).map(mean).collect();
    let known: Vec<bool> = counts.iter().map(|count| *count > 0).collect();
    let shares = counts.iter().map(|count| f32::from(*count) / (WORK * WORK) as f32).collect();
    (fill(means, &known, width), shares)
}

fn numbers(color: [f32; 3], depth: f32, known: [f32; 2], layout: [f32; 6], ray: [f64; 3]) -> [f32; PLANES] {
    let [r, g, b, depth] = [color[0], color[1], color[2], depth].map(|value| GAIN * (value - CENTER));
    let [x, y, z] = ray.map(|d| d as f32);
    let [l0, l1, l2, l3, l4, l5] = layout;
    [r, g, b, depth, known[0], known[1], l0, l1, l2, l3, l4, l5, x, y, z, 0.0]
}

/// Returns the mean colors of 4x4 places of planes `[H/4 W/4, 16]`, 0 to 1, `[h w, 3]`.
fn cells(planes: &[f32], width: usize) -> Vec<f32> {
    let colors: Vec<[f32; 3]> =
        planes.chunks(PLANES).map(|numbers| [0, 1, 2].map(|c| numbers[c] / GAIN + CENTER)).collect();
    means(&colors, width, CELL / WORK)
}

/// Returns the mean colors of `side`x`side` pixels, row by row, `[h w, 3]`.
pub(super) fn means(pixels: &[[f32; 3]], width: usize, side: usize) -> Vec<f32> {
    let (down, across) = (pixels.len() / width / side, width / side);
    let mut means = vec![0.0; down * across * LATENT_CHANNELS];
    for (i, pixel) in pixels.iter().enumerate() {
        let (y, x) = (i / width / side, i % width / side);
        let mean = &mut means[(y * across + x) * 3..][..3];
        mean.iter_mut().zip(pixel).for_each(|(mean, color)| *mean += color);
    }
    means.iter_mut().for_each(|mean| *mean /= (side * side) as f32);
    means
}

/// Returns the center of a pixel (row, column), in fractions of the image.
fn place([y, x]: [usize; 2], [height, width]: [usize; 2]) -> [f64; 2] {
    [(y as f64 + 0.5) / height as f64, (x as f64 + 0.5) / width as f64]
}

/// Returns the direction in the ego frame of the ray through a place (y, x), in fractions of the image.
fn direction(camera: &[f32; CAMERA_NUMBERS], [y, x]: [f64; 2]) -> [f64; 3] {
    let numbers = camera.map(f64::from);
    let [fx, fy, cx, cy] = [12, 13, 14, 15].map(|i| numbers[i]);
    let (right, low) = ((x - cx) / fx, (y - cy) / fy);
    let length = (right * right + low * low + 1.0).sqrt();
    std::array::from_fn(|i| (numbers[4 * i] * right + numbers[4 * i + 1] * low + numbers[4 * i + 2]) / length)
}

/// Returns the rays through the centers of a camera's tokens, `[R, 27]`.
fn token_rays(config: &NetworkConfig, camera: &[f32; CAMERA_NUMBERS]) -> Vec<f32> {
    let [down, across] = config.divided(TOKEN);
    let mut rays = Vec::with_capacity(down * across * RAY);
    for (y, x) in (0..down).flat_map(|y| (0..across).map(move |x| (y, x))) {
        let direction = direction(camera, place([y, x], [down, across]));
        rays.extend(direction.map(|d| d as f32));
        for octave in 0..OCTAVES {
            let factor = f64::from(1_u32 << octave);
            rays.extend(direction.map(|d| (factor * d).sin() as f32));
            rays.extend(direction.map(|d| (factor * d).cos() as f32));
        }
    }
    rays
}

/// Returns the ego motion as network input; zeros, including the known flag, if it was dropped.
fn ego_numbers(action: [f32; 3]) -> [f32; EGO] {
    if action == [NO_ACTION; 3] {
        return [0.0; EGO];
    }
    let [forward, left, turn] = EGO_SCALES;
    [action[0] / forward, action[1] / left, action[2] / turn, 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::geometry::ImageSize;
    use pskel_generate::{Condition, DroppedConditions, Recipe};

    /// The camera looks along the ego's x axis: right is -y, down is -z.
    #[rustfmt::skip]
    const CAMERA: [f32; 16] = [
        0.0, 0.0, 1.0, 1.5,
        -1.0, 0.0, 0.0, 0.0,
        0.0, -1.0, 0.0, 1.6,
        1.0, 0.5, 0.5, 0.5,
    ];

    fn config(height: u32, width: u32) -> NetworkConfig {
        let size = ImageSize { height, width };
        NetworkConfig {
            recipe: Recipe { drawn: size, size, ..Recipe::default() },
            frames: 4,
            encoder: [16; 4],
            decoder: [16; 4],
            width: 16,
            head: 16,
            hidden: 16,
            blocks: Vec::new(),
        }
    }

    #[test]
    fn dropped_motion_is_unknown() {
        assert_eq!(ego_numbers([2.0, -0.5, 0.1]), [1.0, -1.0, 1.0, 1.0]);
        assert_eq!(ego_numbers([0.0; 3]), [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(ego_numbers([-1000.0; 3]), [0.0; 4]);
    }

    #[test]
    fn rays_follow_the_camera_direction() {
        let rays = token_rays(&config(96, 96), &CAMERA);
        assert_eq!(rays.len(), 9 * RAY);
        let ray = |token: usize| &rays[token * RAY..][..RAY];
        assert_eq!(ray(4)[..9], [1.0, 0.0, 0.0, 1.0_f32.sin(), 0.0, 0.0, 1.0_f32.cos(), 1.0, 1.0]);
        // Right by a third of the width, with a focal length of the width; up by a third of the height, with
        // half of it.
        let (right, up) = (1.0 / 3.0, 2.0 / 3.0);
        let length = (1.0_f32 + right * right + up * up).sqrt();
        let expected = [1.0, -right, up].map(|d| d / length);
        assert!(ray(2).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", &ray(2)[..3]);
    }

    /// A point in one pixel: its color fills the image, and the masks show where it is.
    #[test]
    fn inputs_have_filled_color_and_masks() {
        let config = config(32, 64);
        let size = config.recipe.size;
        let (pixels, at) = (size.pixels(), 5 * 64 + 11);
        let mut frame = FrameConditions {
            size,
            color: vec![[0; 3]; pixels],
            bins: vec![0; pixels],
            depth_bins: config.recipe.bins,
            boxes: vec![[255, 0, 0]; pixels],
            map: vec![[0, 0, 51]; pixels],
            dropped: DroppedConditions::default(),
            action: [0.0; 3],
            cameras: vec![CAMERA],
            prompts: Default::default(),
        };
        (frame.color[at], frame.bins[at]) = ([51, 102, 204], 51);
        check(&config, &frame).unwrap();
        let layout = [1.0, 0.0, 0.0, 0.0, 0.0, 0.2];
        let of = |frame: &FrameConditions| (full_inputs(&config, frame), work_inputs(&config, frame));
        let (full, work) = of(&frame);
        assert_eq!((full.planes.height, full.planes.width, full.planes.channels), (16, 32, 64));
        for pixel in 0..pixels {
            let (y, x) = (pixel / 64, pixel % 64);
            let block = &full.planes.values[(y / 2 * 32 + x / 2) * 64..][..64];
            let row: [f32; 16] = std::array::from_fn(|c| block[4 * c + 2 * (y % 2) + x % 2]);
            let known = if pixel == at { 1.0 } else { 0.0 };
            let expected = [&[-1.2, -0.4, 1.2, -1.2, known, known][..], &layout].concat();
            assert!(row[..12].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{pixel} {row:?}");
            assert!((row[12..15].iter().map(|d| d * d).sum::<f32>() - 1.0).abs() < 1e-5 && row[15] == 0.0);
        }
        for (place, row) in work.planes.values.chunks(16).enumerate() {
            let share = if place == 16 + 2 { 1.0 / 16.0 } else { 0.0 };
            let expected = [&[-1.2, -0.4, 1.2, -1.2, share, share][..], &layout].concat();
            assert!(row[..12].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{place} {row:?}");
        }
        assert!(work.cells.chunks(3).all(|c| (c[0] - 0.2).abs() < 1e-6 && (c[2] - 0.8).abs() < 1e-6));
        let (full, work) = of(&frame.without(DroppedConditions::ALL));
        let is_dropped = |row: &[f32]| row[..6] == [0.0; 6] && (row[6] - NO_COLOR).abs() < 1e-6;
        assert!(work.planes.values.chunks(16).all(is_dropped));
        assert!(full.color.iter().all(|color| *color == [0.5; 3]) && work.cells.iter().all(|c| *c == 0.5));
        let other = FrameConditions { size: ImageSize { height: 64, width: 32 }, ..frame };
        let error = check(&config, &other).unwrap_err().to_string();
        assert!(error.contains("conditions of 1 cameras of 32x64, found 1 of 64x32"), "{error}");
    }
}
