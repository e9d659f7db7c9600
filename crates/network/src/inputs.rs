use candle_core::{Device, Result, Tensor};
use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use pskel_generate::NO_ACTION;
use pskel_generate::{CAMERA_NUMBERS, FrameConditions};

use super::config::MAPS;
use super::{NetworkConfig, NetworkError};

/// Number of values of a patch's ray: its direction in the ego frame, and sines and cosines of 1, 2, 4 and 8 times
/// it.
pub(super) const RAY: usize = 3 + 2 * 3 * OCTAVES;
const OCTAVES: usize = 4;
/// Number of values of the ego motion: forward, left, turn, and whether it is known.
pub(super) const EGO: usize = 4;
/// Typical ego motion per frame, by which it is divided: meters forward, meters to the left, radians.
const EGO_SCALES: [f32; 3] = [2.0, 0.5, 0.1];

/// Conditions of windows as R rows, for all patches of all cameras, frames and windows.
#[derive(Clone, Debug)]
pub(crate) struct Inputs {
    /// Maps of patches, `[R, 26 p^2]`.
    pub(super) maps: Tensor,
    /// Rays of patches, `[R, 27]`.
    pub(super) rays: Tensor,
    /// Ego motion of frames, `[B L, 4]`.
    pub(super) ego: Tensor,
}

impl Inputs {
    /// Maps of patches, `[R, 26 p^2]`.
    pub(crate) fn maps(&self) -> &Tensor {
        &self.maps
    }

    /// Converts the conditions of frames, in order.
    ///
    /// # Errors
    /// Returns an error if a frame differs from the configuration in size or number of cameras.
    pub(crate) fn new<'a>(
        config: &NetworkConfig,
        frames: impl Iterator<Item = &'a FrameConditions>,
    ) -> std::result::Result<Self, NetworkError> {
        let (mut maps, mut rays, mut ego) = (Vec::new(), Vec::new(), Vec::new());
        for frame in frames {
            maps.extend(frame_maps(config, frame)?);
            rays.extend(frame.cameras.iter().flat_map(|camera| camera_rays(config, camera)));
            ego.extend(ego_numbers(frame.action));
        }
        let rows = |values: Vec<f32>, width: usize| -> Result<Tensor> {
            let count = values.len() / width;
            Tensor::from_vec(values, (count, width), &Device::Cpu)
        };
        Ok(Self { maps: rows(maps, config.map_numbers())?, rays: rows(rays, RAY)?, ego: rows(ego, EGO)? })
    }
}

/// Returns the maps of a frame's patches, `[V h w, 26 p^2]`: layout, color, depth.
///
/// # Errors
/// Returns an error if the maps differ from the configuration in size or number of cameras.
fn frame_maps(
    config: &NetworkConfig,
    frame: &FrameConditions,
) -> std::result::Result<Vec<f32>, NetworkError> {
    let (size, views) = (config.recipe.size, config.cameras);
    let pixels = size.pixels();
    let fits = frame.points.len() == views * POINT_CHANNELS * pixels
        && frame.layout.len() == views * LAYOUT_CHANNELS * pixels;
    if frame.size != size || frame.views() != views || !fits {
        let found = format!("{} of {}", frame.views(), frame.size);
        return Err(NetworkError::input(format!("conditions of {views} cameras of {size}"), found));
    }
    let width = size.width as usize;
    let mut maps = Vec::with_capacity(views * MAPS * pixels);
    let cameras =
        frame.layout.chunks(LAYOUT_CHANNELS * pixels).zip(frame.points.chunks(POINT_CHANNELS * pixels));
    for (layout, points) in cameras {
        maps.extend(patches(&[layout, points], width, pixels, config.patch));
    }
    Ok(maps)
}

/// Cuts the planes of arrays `[channels, H, W]` into patches: rows `[h w, channels p^2]`, each in the order
/// (channel, y, x).
fn patches(arrays: &[&[f32]], width: usize, pixels: usize, patch: usize) -> Vec<f32> {
    let (down, across) = (pixels / width / patch, width / patch);
    let channels: usize = arrays.iter().map(|array| array.len() / pixels).sum();
    let mut rows = Vec::with_capacity(channels * pixels);
    for (y, x) in (0..down).flat_map(|y| (0..across).map(move |x| (y * patch, x * patch))) {
        for plane in arrays.iter().flat_map(|array| array.chunks(pixels)) {
            for line in y..y + patch {
                rows.extend_from_slice(&plane[line * width + x..][..patch]);
            }
        }
    }
    rows
}

/// Returns the rays through the centers of a camera's patches, `[h w, 27]`.
fn camera_rays(config: &NetworkConfig, camera: &[f32; CAMERA_NUMBERS]) -> Vec<f32> {
    let numbers = camera.map(f64::from);
    let [fx, fy, cx, cy] = [12, 13, 14, 15].map(|i| numbers[i]);
    let (down, across) = (config.shape().height, config.shape().width);
    let mut rays = Vec::with_capacity(down * across * RAY);
    for (y, x) in (0..down).flat_map(|y| (0..across).map(move |x| (y, x))) {
        // In fractions of the image's width and height, like the camera parameters.
        let right = ((x as f64 + 0.5) / across as f64 - cx) / fx;
        let low = ((y as f64 + 0.5) / down as f64 - cy) / fy;
        let length = (right * right + low * low + 1.0).sqrt();
        let direction: [f64; 3] = std::array::from_fn(|i| {
            (numbers[4 * i] * right + numbers[4 * i + 1] * low + numbers[4 * i + 2]) / length
        });
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

    #[test]
    fn patches_are_rows() {
        let planes: Vec<f32> = (0..2 * 2 * 4).map(|i| i as f32).collect();
        let rows = patches(&[&planes[..8], &planes[8..]], 4, 8, 2);
        assert_eq!(rows[..8], [0.0, 1.0, 4.0, 5.0, 8.0, 9.0, 12.0, 13.0]);
        assert_eq!(rows[8..], [2.0, 3.0, 6.0, 7.0, 10.0, 11.0, 14.0, 15.0]);
    }

    #[test]
    fn dropped_motion_is_unknown() {
        assert_eq!(ego_numbers([2.0, -0.5, 0.1]), [1.0, -1.0, 1.0, 1.0]);
        assert_eq!(ego_numbers([0.0; 3]), [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(ego_numbers([-1000.0; 3]), [0.0; 4]);
    }

    /// The camera looks along the ego's x axis: right is -y, down is -z.
    #[test]
    fn rays_look_where_the_camera_looks() {
        let mut config = NetworkConfig { patch: 4, ..NetworkConfig::default() };
        config.recipe.size = ImageSize { height: 12, width: 12 };
        #[rustfmt::skip]
        let camera = [
            0.0, 0.0, 1.0, 1.5,
            -1.0, 0.0, 0.0, 0.0,
            0.0, -1.0, 0.0, 1.6,
            1.0, 0.5, 0.5, 0.5,
        ];
        let rays = camera_rays(&config, &camera);
        assert_eq!(rays.len(), 9 * RAY);
        let ray = |patch: usize| &rays[patch * RAY..][..RAY];
        assert_eq!(ray(4)[..9], [1.0, 0.0, 0.0, 1.0_f32.sin(), 0.0, 0.0, 1.0_f32.cos(), 1.0, 1.0]);
        // Right by a third of the width, with a focal length of the width; up by a third of the height, with half
        // of it.
        let (right, up) = (1.0 / 3.0, 2.0 / 3.0);
        let length = (1.0_f32 + right * right + up * up).sqrt();
        let expected = [1.0, -right, up].map(|d| d / length);
        assert!(ray(2).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", &ray(2)[..3]);
        assert!((ray(2)[RAY - 1] - (8.0 * expected[2]).cos()).abs() < 1e-5);
    }
}
