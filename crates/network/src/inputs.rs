use candle_core::{Device, Result, Tensor};
use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use point_skeleton::geometry::ImageSize;
use pskel_generate::{CAMERA_NUMBERS, FrameConditions, NO_ACTION, NO_COLOR};
use rayon::prelude::*;

use super::fill::fill;
use super::{NetworkConfig, NetworkError};
use crate::weights::config::{CELL, LATENT_CHANNELS, TOKEN};

/// Numbers of a pixel: filled color (3), filled depth, whether color and depth are known (2), layout (6),
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

/// Conditions of frames; images cover all cameras and frames.
#[derive(Clone, Debug)]
pub(crate) struct Inputs {
    /// Number of cameras, V.
    pub(super) views: usize,
    /// Numbers of the pixels, `[F V H W, 16]`.
    pub(super) pixels: Tensor,
    /// Means of the filled color over 4x4 pixels, 0 to 1, `[F V h w, 3]`.
    pub(super) colors: Tensor,
    /// Rays of tokens, `[F V h/2 w/2, 27]`.
    pub(super) rays: Tensor,
    /// Ego motion of frames, `[F, 4]`.
    pub(super) ego: Tensor,
}

/// Numbers of a camera's image.
struct CameraInputs {
    pixels: Vec<f32>,
    colors: Vec<f32>,
    rays: Vec<f32>,
}

impl Inputs {
    /// Returns the means of the filled color over 4x4 pixels, 0 to 1, `[F V h w, 3]`.
    pub(crate) fn colors(&self) -> Result<Vec<f32>> {
        self.colors.flatten_all()?.to_vec1()
    }

    /// Converts the conditions of frames, in order.
    ///
    /// # Errors
    /// Returns an error if frames differ in their number of cameras, or from the configuration in size.
    pub(crate) fn new<'a>(
        config: &NetworkConfig,
        frames: impl Iterator<Item = &'a FrameConditions>,
    ) -> std::result::Result<Self, NetworkError> {
        let frames: Vec<&FrameConditions> = frames.collect();
        let views = frames.first().map_or(0, |frame| frame.views());
        NetworkConfig::check_cameras(views)?;
        let size = config.recipe.size;
        for frame in &frames {
            let fits = frame.points.len() == views * POINT_CHANNELS * size.pixels()
                && frame.layout.len() == views * LAYOUT_CHANNELS * size.pixels();
            if frame.size != size || frame.views() != views || !fits {
                let found = format!("{} of {}", frame.views(), frame.size);
                return Err(NetworkError::input(format!("conditions of {views} cameras of {size}"), found));
            }
        }
        let images: Vec<(&FrameConditions, usize)> =
            frames.iter().flat_map(|frame| (0..views).map(move |view| (*frame, view))).collect();
        let images: Vec<CameraInputs> =
            images.par_iter().map(|(frame, view)| camera_inputs(config, frame, *view)).collect();
        let rows = |of: fn(&CameraInputs) -> &Vec<f32>, width: usize| -> Result<Tensor> {
            let values = images.iter().map(|image| of(image).as_slice()).collect::<Vec<_>>().concat();
            let count = values.len() / width;
            Tensor::from_vec(values, (count, width), &Device::Cpu)
        };
        let ego: Vec<f32> = frames.iter().flat_map(|frame| ego_numbers(frame.action)).collect();
        Ok(Self {
            views,
            pixels: rows(|image| &image.pixels, PLANES)?,
            colors: rows(|image| &image.colors, LATENT_CHANNELS)?,
            rays: rows(|image| &image.rays, RAY)?,
            ego: Tensor::from_vec(ego, (frames.len(), EGO), &Device::Cpu)?,
        })
    }
}

fn camera_inputs(config: &NetworkConfig, frame: &FrameConditions, view: usize) -> CameraInputs {
    let [height, width] = config.divided(1);
    let pixels = height * width;
    let points = &frame.points[view * POINT_CHANNELS * pixels..][..4 * pixels];
    let layout = &frame.layout[view * LAYOUT_CHANNELS * pixels..][..LAYOUT_CHANNELS * pixels];
    let (color, has_color) = filled_color(points, config.recipe.size);
    let depth: Vec<[f32; 1]> = points[3 * pixels..].iter().map(|depth| [*depth]).collect();
    let has_depth: Vec<bool> = depth.iter().map(|[depth]| *depth >= 0.0).collect();
    let depth = fill(depth, &has_depth, width);
    let mut numbers = Vec::with_capacity(pixels * PLANES);
    let camera = &frame.cameras[view];
    for i in 0..pixels {
        let at = [i / width, i % width].map(|place| place as f64 + 0.5);
        numbers.extend(color[i].map(|c| c - CENTER));
        numbers.push(depth[i][0] - CENTER);
        numbers.extend([has_color[i], has_depth[i]].map(|known| if known { 1.0 } else { 0.0 }));
        numbers.extend((0..LAYOUT_CHANNELS).map(|c| layout[c * pixels + i]));
        numbers.extend(direction(camera, [at[0] / height as f64, at[1] / width as f64]).map(|d| d as f32));
        numbers.push(0.0);
    }
    CameraInputs { pixels: numbers, colors: means(&color, width), rays: camera_rays(config, camera) }
}

/// Returns the color of a camera's points `[20, H, W]` with its holes filled, and where it is known.
pub(super) fn filled_color(points: &[f32], size: ImageSize) -> (Vec<[f32; 3]>, Vec<bool>) {
    let pixels = size.pixels();
    let color: Vec<[f32; 3]> = (0..pixels).map(|i| [0, 1, 2].map(|c| points[c * pixels + i])).collect();
    let known: Vec<bool> = color.iter().map(|c| *c != [0.0; 3] && *c != [NO_COLOR; 3]).collect();
    (fill(color, &known, size.width as usize), known)
}

/// Returns the mean colors of 4x4 pixels, `[h w, 3]`.
pub(super) fn means(pixels: &[[f32; 3]], width: usize) -> Vec<f32> {
    let (down, across) = (pixels.len() / width / CELL, width / CELL);
    let mut means = vec![0.0; down * across * 3];
    for (i, pixel) in pixels.iter().enumerate() {
        let (y, x) = (i / width / CELL, i % width / CELL);
        let mean = &mut means[(y * across + x) * 3..][..3];
        mean.iter_mut().zip(pixel).for_each(|(mean, color)| *mean += color);
    }
    means.iter_mut().for_each(|mean| *mean /= (CELL * CELL) as f32);
    means
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
fn camera_rays(config: &NetworkConfig, camera: &[f32; CAMERA_NUMBERS]) -> Vec<f32> {
    let [down, across] = config.divided(TOKEN);
    let mut rays = Vec::with_capacity(down * across * RAY);
    for (y, x) in (0..down).flat_map(|y| (0..across).map(move |x| (y, x))) {
        let direction = direction(camera, [(y as f64 + 0.5) / down as f64, (x as f64 + 0.5) / across as f64]);
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
    use pskel_generate::{Condition, DroppedConditions};

    /// The camera looks along the ego's x axis: right is -y, down is -z.
    #[rustfmt::skip]
    const CAMERA: [f32; 16] = [
        0.0, 0.0, 1.0, 1.5,
        -1.0, 0.0, 0.0, 0.0,
        0.0, -1.0, 0.0, 1.6,
        1.0, 0.5, 0.5, 0.5,
    ];

    fn config(height: u32, width: u32) -> NetworkConfig {
        let mut config = NetworkConfig::default();
        config.recipe.size = ImageSize { height, width };
        config
    }

    #[test]
    fn dropped_motion_is_unknown() {
        assert_eq!(ego_numbers([2.0, -0.5, 0.1]), [1.0, -1.0, 1.0, 1.0]);
        assert_eq!(ego_numbers([0.0; 3]), [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(ego_numbers([-1000.0; 3]), [0.0; 4]);
    }

    #[test]
    fn rays_follow_the_camera_direction() {
        let config = config(24, 24);
        let rays = camera_rays(&config, &CAMERA);
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
    fn pixel_inputs_have_filled_color_and_masks() {
        let config = config(8, 16);
        let pixels = 128;
        let mut points = vec![0.0; POINT_CHANNELS * pixels];
        points[3 * pixels..4 * pixels].fill(-1.0);
        for (channel, value) in [0.25, 0.5, 0.75, 0.125].into_iter().enumerate() {
            points[channel * pixels + 37] = value;
        }
        let layout = (0..LAYOUT_CHANNELS).flat_map(|c| vec![c as f32; pixels]).collect();
        let size = config.recipe.size;
        let frame = FrameConditions {
            size,
            points,
            layout,
            action: [0.0; 3],
            cameras: vec![CAMERA],
            prompt: String::new(),
        };
        let numbers = |frame: &FrameConditions| {
            let inputs = Inputs::new(&config, std::iter::once(frame)).unwrap();
            (inputs.pixels.to_vec2::<f32>().unwrap(), inputs.colors.to_vec2::<f32>().unwrap())
        };
        let (found, colors) = numbers(&frame);
        for (i, row) in found.iter().enumerate() {
            let known = if i == 37 { 1.0 } else { 0.0 };
            assert_eq!(row[..12], [-0.25, 0.0, 0.25, -0.375, known, known, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
            assert!((row[12..15].iter().map(|d| d * d).sum::<f32>() - 1.0).abs() < 1e-5 && row[15] == 0.0);
        }
        assert_eq!(colors, vec![vec![0.25, 0.5, 0.75]; 8]);
        let (found, colors) = numbers(&frame.without(DroppedConditions::ALL));
        assert!(found.iter().all(|row| row[..6] == [0.0; 6]) && colors == vec![vec![0.5; 3]; 8]);
        let other = FrameConditions { size: ImageSize { height: 8, width: 8 }, ..frame };
        assert!(Inputs::new(&config, std::iter::once(&other)).is_err());
    }
}
