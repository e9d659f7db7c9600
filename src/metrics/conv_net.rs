use image::RgbImage;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::Seeder;

/// Channels from the image to the last layer.
const CHANNELS: [usize; 4] = [3, 16, 32, 32];
/// Slope of the leaky ReLU below 0.
const LEAK: f32 = 0.2;

/// A convolutional network with fixed random weights, which turns images into features for Fréchet distances.
///
/// It is not Inception, and distances by it are none of the published FID or FVD: they order what this project generates.
/// Random convolutions do tell blur, noise, wrong colors and missing structure apart, need no download, and are the
/// same everywhere. Three layers of 3x3 with stride 2, padded by zeros, without biases, each with a leaky ReLU; mean and standard
/// deviation over the last layer's places are the features. Weights are normal with He's variance (K. He et al., *Delving
/// deep into rectifiers*, 2015) and follow from the seed alone; sums run in one order, so threads change nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomConvNet {
    seed: u64,
    /// Per layer `[3, 3, in, out]`.
    weights: Vec<Vec<f32>>,
}

impl RandomConvNet {
    /// Numbers per image: means of the last layer's channels, then standard deviations.
    pub const FEATURES: usize = 2 * CHANNELS[3];

    /// The network of a seed.
    pub fn new(seed: u64) -> Self {
        let layer = |(index, pair): (usize, &[usize])| {
            let mut random: ChaCha8Rng = Seeder::from((seed, "random convolutions", index as u64)).into_rng();
            let inputs = 9 * pair[0];
            let deviation = (2.0 / ((1.0 + LEAK * LEAK) * inputs as f32)).sqrt();
            let weight = |_| -> f32 {
                let normal: f32 = StandardNormal.sample(&mut random);
                deviation * normal
            };
            (0..inputs * pair[1]).map(weight).collect()
        };
        Self { seed, weights: CHANNELS.windows(2).enumerate().map(layer).collect() }
    }

    /// What its weights follow from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// `[FEATURES]` of an image of any size (levels are scaled to -1 to 1); `None` for one without pixels.
    pub fn features(&self, image: &RgbImage) -> Option<Vec<f64>> {
        let values = image.as_raw().iter().map(|level| f32::from(*level) / 127.5 - 1.0).collect();
        let input = Plane { height: image.height() as usize, width: image.width() as usize, values };
        if input.values.is_empty() {
            return None;
        }
        let last = self
            .weights
            .iter()
            .zip(CHANNELS.windows(2))
            .fold(input, |plane, (weights, pair)| layer(&plane, weights, pair[0], pair[1]));
        Some(pooled(&last))
    }
}

/// `[H, W, C]`
struct Plane {
    height: usize,
    width: usize,
    values: Vec<f32>,
}

/// 3x3, stride 2, one pixel of zeros around: `[ceil(H/2), ceil(W/2), outputs]`.
fn layer(input: &Plane, weights: &[f32], inputs: usize, outputs: usize) -> Plane {
    let (height, width) = (input.height.div_ceil(2), input.width.div_ceil(2));
    let mut values = vec![0.0; height * width * outputs];
    for (at, sums) in values.chunks_exact_mut(outputs).enumerate() {
        let (row, column) = (2 * (at / width), 2 * (at % width));
        for (tap, weights) in weights.chunks_exact(inputs * outputs).enumerate() {
            // The middle of the 3x3 is at tap 4.
            let (y, x) = (row + tap / 3, column + tap % 3);
            if (1..=input.height).contains(&y) && (1..=input.width).contains(&x) {
                let pixel = &input.values[((y - 1) * input.width + x - 1) * inputs..][..inputs];
                add(sums, pixel, weights);
            }
        }
        sums.iter_mut().for_each(|sum| *sum = if *sum < 0.0 { LEAK * *sum } else { *sum });
    }
    Plane { height, width, values }
}

fn add(sums: &mut [f32], pixel: &[f32], weights: &[f32]) {
    for (value, weights) in pixel.iter().zip(weights.chunks_exact(sums.len())) {
        sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
    }
}

fn pooled(plane: &Plane) -> Vec<f64> {
    let (channels, places) = (CHANNELS[3], (plane.height * plane.width) as f64);
    let mut means = vec![0.0_f64; channels];
    let mut deviations = means.clone();
    for pixel in plane.values.chunks_exact(channels) {
        means.iter_mut().zip(pixel).for_each(|(sum, v)| *sum += f64::from(*v));
    }
    means.iter_mut().for_each(|sum| *sum /= places);
    for pixel in plane.values.chunks_exact(channels) {
        let parts = deviations.iter_mut().zip(pixel).zip(&means);
        parts.for_each(|((sum, v), mean)| *sum += (f64::from(*v) - mean).powi(2));
    }
    deviations.iter_mut().for_each(|sum| *sum = (*sum / places).sqrt());
    [means, deviations].concat()
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Tensor};

    use super::*;

    fn image(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([(37 * x + 11 * y) as u8, (x * y) as u8, (255 - 4 * x) as u8])
        })
    }

    /// The same network by another library's convolutions.
    fn peer(net: &RandomConvNet, image: &RgbImage) -> candle_core::Result<Vec<f64>> {
        let (height, width) = (image.height() as usize, image.width() as usize);
        let levels: Vec<f32> = image.as_raw().iter().map(|v| f32::from(*v)).collect();
        let levels = Tensor::from_vec(levels, (height, width, 3), &Device::Cpu)?;
        let mut plane = ((levels / 127.5)? - 1.0)?.permute((2, 0, 1))?.unsqueeze(0)?.contiguous()?;
        for (weights, pair) in net.weights.iter().zip(CHANNELS.windows(2)) {
            let kernel = Tensor::from_vec(weights.clone(), (3, 3, pair[0], pair[1]), &Device::Cpu)?;
            let kernel = kernel.permute((3, 2, 0, 1))?.contiguous()?;
            let sums = plane.conv2d(&kernel, 1, 2, 1, 1)?;
            plane = sums.maximum(&(&sums * f64::from(LEAK))?)?;
        }
        let rows: Vec<Vec<f32>> = plane.squeeze(0)?.flatten_from(1)?.to_vec2()?;
        let mean = |row: &Vec<f32>| row.iter().map(|v| f64::from(*v)).sum::<f64>() / row.len() as f64;
        let deviation = |row: &Vec<f32>| {
            let squares: f64 = row.iter().map(|v| (f64::from(*v) - mean(row)).powi(2)).sum();
            (squares / row.len() as f64).sqrt()
        };
        Ok(rows.iter().map(mean).chain(rows.iter().map(deviation)).collect())
    }

    #[test]
    fn features_are_those_of_another_librarys_convolutions() {
        let net = RandomConvNet::new(3);
        for (width, height) in [(56, 32), (17, 9), (1, 1)] {
            let image = image(width, height);
            let (ours, theirs) = (net.features(&image).unwrap(), peer(&net, &image).unwrap());
            assert_eq!((ours.len(), theirs.len()), (RandomConvNet::FEATURES, RandomConvNet::FEATURES));
            for (a, b) in ours.iter().zip(&theirs) {
                assert!((a - b).abs() < 1e-4, "{width}x{height}: {a} {b}");
            }
        }
    }

    #[test]
    fn features_follow_from_seed_and_image() {
        let (image, other) = (image(56, 32), RgbImage::from_pixel(56, 32, image::Rgb([9; 3])));
        let net = RandomConvNet::new(1);
        let features = net.features(&image).unwrap();
        assert_eq!(net, RandomConvNet::new(1));
        assert_ne!(Some(&features), RandomConvNet::new(2).features(&image).as_ref());
        assert_ne!(Some(&features), net.features(&other).as_ref());
        assert_eq!(net.features(&RgbImage::new(0, 5)), None);
        let in_threads = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| net.features(&image)).unwrap()
        };
        assert_eq!([in_threads(1), in_threads(3)], [features.clone(), features]);
    }
}
