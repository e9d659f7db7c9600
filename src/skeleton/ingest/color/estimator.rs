//! Coloring: one color per point, on which the images that see it agree.
//!
//! # How it works
//! Every image whose frame lies within a window around a point's own frame is a candidate. The point is
//! projected into it at the image's own time (a point of an actor moves with its box) and tested against the
//! image's [`OcclusionMap`]. Each view that passes yields a [`ColorSample`]: the mean color over the pixels
//! that the point covers when splatted, and a weight that decreases with distance. The color is a robust
//! mean: a mean that gives less weight to views that differ more from it. The other views thus outvote an
//! error in one image: a wrong occlusion, a passing car, or the sky behind a twig.

use glam::{DVec2, DVec3};
use image::RgbImage;

use crate::geometry::View;
use crate::raster::DEFAULT_STEPS;
use crate::skeleton::ingest::occlusion::OcclusionMap;

/// Point to be colored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    /// Position, meters: global for the background, box frame for actors.
    pub position: DVec3,
    /// Color, once assigned.
    pub rgb: Option<[u8; 3]>,
}

/// Image with the data required to color points from it.
pub(crate) struct ColorView {
    /// Image pixels.
    pub image: RgbImage,
    /// Camera and pose of the image.
    pub view: View,
    /// Time of the image, absolute microseconds.
    pub t_us: i64,
    /// Occlusion in the image; `None` disables the test.
    pub occlusion: Option<OcclusionMap>,
}

/// Color of a point in one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ColorSample {
    /// Mean color.
    pub rgb: [u8; 3],
    /// Weight of the view: larger for nearer views.
    pub weight: f32,
}

/// Number of points whose colors are estimated at once.
pub(crate) const LANES: usize = 16;

/// A sample for each of some points. A sample without weight, as of a point with fewer samples than others,
/// changes nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LaneSamples {
    rgb: [[u8; LANES]; 3],
    weight: [f32; LANES],
}

impl LaneSamples {
    pub(crate) const NONE: Self = Self { rgb: [[0; LANES]; 3], weight: [0.0; LANES] };

    /// Sets the sample of a point.
    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, sample: ColorSample) {
        (0..3).for_each(|c| self.rgb[c][lane] = sample.rgb[c]);
        self.weight[lane] = sample.weight;
    }
}

/// Width of the images that the default schedule is for, pixels.
const SPLAT_WIDTH: f64 = 1600.0;

/// Difference from the mean color, summed over channels, at which a look counts half.
const TOLERANCE: f32 = 100.0;
/// Number of times that looks are weighted anew.
const ROUNDS: usize = 6;

impl ColorView {
    /// Returns the radii of points, in image pixels, within the depth ranges of [`DEFAULT_STEPS`].
    pub(crate) fn radii(&self) -> [usize; 3] {
        let scale = f64::from(self.image.width()) / SPLAT_WIDTH;
        DEFAULT_STEPS.map(|step| ((f64::from(step.radius) + 0.5) * scale).round() as usize)
    }

    /// Returns whether a point at a pixel and a camera depth in meters is occluded.
    #[inline(always)] // into loops that are compiled for wide vectors
    pub(crate) fn hides(&self, pixel: DVec2, depth_m: f64) -> bool {
        self.occlusion.as_ref().is_some_and(|map| map.hides(pixel, depth_m))
    }

    /// Returns this view's color of a point at a pixel and a camera depth in meters.
    #[inline(always)]
    pub(crate) fn sample(&self, radii: [usize; 3], pixel: DVec2, depth_m: f64) -> ColorSample {
        let [nearer @ .., _] = &DEFAULT_STEPS;
        let range = nearer.iter().position(|step| depth_m <= f64::from(step.z_max_m)).unwrap_or(nearer.len());
        ColorSample { rgb: self.mean_color(pixel, radii[range]), weight: (1.0 / depth_m) as f32 }
    }

    /// Returns the mean color over the pixels up to a radius around a pixel.
    #[inline(always)]
    fn mean_color(&self, pixel: DVec2, radius: usize) -> [u8; 3] {
        let [width, height] = [self.image.width(), self.image.height()].map(|side| side as usize);
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        let is_inside = x >= radius && y >= radius && x + radius < width && y + radius < height;
        let levels = self.image.as_raw();
        let first = || ((y - radius) * width + x - radius) * 3;
        let whole = match radius {
            1 if is_inside => square_mean::<3, 1>(levels, first(), width * 3),
            2 if is_inside => square_mean::<5, 1>(levels, first(), width * 3),
            3 if is_inside => square_mean::<7, 2>(levels, first(), width * 3),
            _ => None,
        };
        whole.unwrap_or_else(|| clipped_mean(levels, [width, height], [x, y], radius))
    }
}

/// Returns the mean color over a square of `SIDE` pixels, from the index of its first level and the number of
/// levels per row. Reads `16 PARTS` levels of each row and uses the first `3 SIDE`; `None` where there are
/// fewer.
#[inline(always)]
fn square_mean<const SIDE: usize, const PARTS: usize>(
    levels: &[u8],
    first: usize,
    row: usize,
) -> Option<[u8; 3]> {
    let mut sums = [[0; 16]; PARTS];
    for (part, sums) in sums.iter_mut().enumerate() {
        *sums = column_sums::<SIDE>(levels, first + 16 * part, row)?;
    }
    Some(mean_of_columns::<SIDE>(sums.as_flattened()))
}

/// Returns the sums of 16 columns over `ROWS` rows.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // a loop over lanes: this form vectorizes
fn column_sums<const ROWS: usize>(levels: &[u8], first: usize, row: usize) -> Option<[u16; 16]> {
    let mut sums = [0; 16];
    for line in 0..ROWS {
        let levels: &[u8; 16] = levels.get(first + line * row..)?.first_chunk()?;
        for i in 0..16 {
            sums[i] += u16::from(levels[i]);
        }
    }
    Some(sums)
}

/// Returns the mean color over a square of `SIDE` pixels from sums over its columns. Not inlined: the
/// compiler would otherwise sum up each channel level by level, without vectors, in twice the time.
#[inline(never)]
fn mean_of_columns<const SIDE: usize>(sums: &[u16]) -> [u8; 3] {
    let mut sum = [0_u32; 3];
    for column in sums.as_chunks::<3>().0.iter().take(SIDE) {
        (0..3).for_each(|c| sum[c] += u32::from(column[c]));
    }
    let count = (SIDE * SIDE) as u32;
    sum.map(|sum| ((sum + count / 2) / count) as u8)
}

/// Returns the mean color over the pixels up to a radius around a pixel, within the image.
fn clipped_mean(levels: &[u8], [width, height]: [usize; 2], [x, y]: [usize; 2], radius: usize) -> [u8; 3] {
    let range = |center: usize, side: usize| center.saturating_sub(radius)..(center + radius + 1).min(side);
    let columns = range(x, width);
    let (mut sum, mut count) = ([0_u32; 3], 0);
    for row in range(y, height) {
        let line = &levels[(row * width + columns.start) * 3..(row * width + columns.end) * 3];
        for rgb in line.chunks_exact(3) {
            (0..3).for_each(|c| sum[c] += u32::from(rgb[c]));
        }
        count += columns.len() as u32;
    }
    sum.map(|sum| ((sum + count / 2) / count.max(1)) as u8)
}

/// Returns the color on which the samples of each point agree: their mean, weighted by `1 / (1 + (d /
/// TOLERANCE)²)`, where `d` is the difference of a sample from the mean. Meaningless for points without
/// samples.
#[inline(always)] // into loops that are compiled for wide vectors
pub(crate) fn agreed_colors(samples: &[LaneSamples]) -> [[u8; 3]; LANES] {
    let mut color = weighted_means(samples, |_, _| 1.0);
    for _ in 0..ROUNDS {
        color = weighted_means(samples, |lane, rgb| {
            let differs = per_tolerance((0..3).map(|c| (rgb[c] - color[c][lane]).abs()).sum());
            1.0 / (1.0 + differs * differs)
        });
    }
    std::array::from_fn(|lane| color.map(|levels| (levels[lane] + 0.5) as u8))
}

/// Returns `difference / TOLERANCE` to the last bit, in a third of a division's time: the quotient is
/// corrected by its exact remainder.
#[inline(always)]
fn per_tolerance(difference: f32) -> f32 {
    const INVERSE: f32 = 1.0 / TOLERANCE;
    let quotient = difference * INVERSE;
    (-quotient).mul_add(TOLERANCE, difference).mul_add(INVERSE, quotient)
}

/// Returns the mean color of each point's samples; `trust` is a weight factor for a sample of a point with a
/// given color.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
fn weighted_means(samples: &[LaneSamples], trust: impl Fn(usize, [f32; 3]) -> f32) -> [[f32; LANES]; 3] {
    let (mut sums, mut totals) = ([[0.0_f32; LANES]; 3], [0.0_f32; LANES]);
    for sample in samples {
        for lane in 0..LANES {
            let rgb = [0, 1, 2].map(|c| f32::from(sample.rgb[c][lane]));
            let weight = sample.weight[lane] * trust(lane, rgb);
            (0..3).for_each(|c| sums[c][lane] += weight * rgb[c]);
            totals[lane] += weight;
        }
    }
    sums.map(|sum| std::array::from_fn(|lane| sum[lane] / totals[lane]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All bits of the fraction for one exponent, which holds for others too, and some of each exponent.
    #[test]
    fn differences_are_divided_exactly() {
        let check = |bits: u32| {
            let difference = f32::from_bits(bits);
            let [found, expected] = [per_tolerance(difference), difference / TOLERANCE].map(f32::to_bits);
            assert_eq!(found, expected, "{difference}");
        };
        let of = |value: f32| value.to_bits();
        (of(64.0)..of(128.0)).for_each(check);
        (of(f32::EPSILON / 2.0)..of(765.0)).step_by(997).chain([of(0.0), of(765.0)]).for_each(check);
    }
    use crate::geometry::{Camera, LensModel};
    use crate::skeleton::Projector;
    use glam::DAffine3;

    fn sample_at(view: &ColorView, project: &Projector, point: DVec3) -> Option<ColorSample> {
        let (pixel, depth_m) = project.pixel(point)?;
        (!view.hides(pixel, depth_m)).then(|| view.sample(view.radii(), pixel, depth_m))
    }

    fn sample(grey: u8, weight: f32) -> ColorSample {
        ColorSample { rgb: [grey; 3], weight }
    }

    /// Returns the color of a point among others with other samples.
    fn agreed_color(samples: &[ColorSample]) -> [u8; 3] {
        let mut lanes = vec![LaneSamples::NONE; samples.len() + 1];
        for (all, sample) in lanes.iter_mut().zip(samples) {
            all.set(5, *sample);
            all.set(6, ColorSample { rgb: [99; 3], weight: 7.0 });
        }
        lanes[samples.len()].set(4, ColorSample { rgb: [7; 3], weight: 0.5 });
        let colors = agreed_colors(&lanes);
        assert_eq!((colors[4], colors[6]), ([7; 3], [99; 3]));
        colors[5]
    }

    #[test]
    fn the_majority_outvotes_a_nearer_view() {
        assert_eq!(agreed_color(&[sample(9, 0.1)]), [9; 3]);
        let agreed = |samples: &[ColorSample]| agreed_color(samples)[0];
        // The plain mean is 92.
        assert!((10..20).contains(&agreed(&[sample(200, 0.3), sample(10, 0.2), sample(12, 0.2)])));
        // The plain mean is 191; at 254, black counts 1/59 as much as white.
        assert_eq!(agreed(&[sample(0, 0.1), sample(255, 0.1), sample(255, 0.1), sample(255, 0.1)]), 254);
    }

    /// Without outliers, it is the weighted mean; its order and scale do not matter.
    #[test]
    fn similar_samples_are_averaged() {
        let samples = [sample(100, 0.1), sample(104, 0.3), sample(103, 0.1)];
        assert_eq!(agreed_color(&samples), [103; 3]);
        let other =
            [samples[2], samples[0], samples[1]].map(|l| ColorSample { weight: l.weight * 50.0, ..l });
        assert_eq!(agreed_color(&other), [103; 3]);
        let every = |rgb| ColorSample { rgb, weight: 0.01 };
        for level in 0..=255 {
            let rgb = [level, 255 - level, 7];
            assert_eq!(agreed_color(&[every(rgb); 5]), rgb);
        }
    }

    /// Sums in double precision, with the weights of the definition, differ by rounding alone, whatever the
    /// order of looks.
    #[test]
    fn agreed_colors_match_the_definition() {
        let number = |i: i64, axis: i64| crate::hash::between(11, &[i, axis], 0.0, 1.0);
        let naive = |samples: &[ColorSample]| {
            let mut color = [f64::NAN; 3];
            for round in 0..=ROUNDS {
                let weight = |sample: &ColorSample| {
                    let d: f64 = (0..3).map(|c| (f64::from(sample.rgb[c]) - color[c]).abs()).sum();
                    let trust =
                        if round == 0 { 1.0 } else { 1.0 / (1.0 + (d / f64::from(TOLERANCE)).powi(2)) };
                    f64::from(sample.weight) * trust
                };
                let total: f64 = samples.iter().map(weight).sum();
                let mean =
                    |c: usize| samples.iter().map(|l| weight(l) * f64::from(l.rgb[c])).sum::<f64>() / total;
                color = [0, 1, 2].map(mean);
            }
            color
        };
        for count in (1..70).chain([200]) {
            let sample = |i: i64| ColorSample {
                rgb: [0, 1, 2].map(|c| (number(count * 1000 + i, c) * 256.0) as u8),
                weight: number(count * 1000 + i, 3) as f32 + 0.01,
            };
            let mut samples: Vec<ColorSample> = (0..count).map(sample).collect();
            let expected = naive(&samples);
            for _ in 0..2 {
                let found = agreed_color(&samples);
                let off = |c: usize| (f64::from(found[c]) - expected[c]).abs();
                assert!((0..3).all(|c| off(c) < 0.501), "{found:?} {expected:?}");
                samples.reverse();
            }
        }
    }

    /// Means over whole squares equal means over clipped ones, at every pixel of an image up to its last
    /// byte.
    #[test]
    fn square_means_equal_clipped_means() {
        let rows = [[100.0, 0.0, 20.0], [0.0, 100.0, 20.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 23, 17, rows).unwrap();
        let level = |x: u32, y: u32, c: i64| {
            crate::hash::between(3, &[i64::from(x), i64::from(y), c], 0.0, 256.0) as u8
        };
        let image = RgbImage::from_fn(23, 17, |x, y| image::Rgb([0, 1, 2].map(|c| level(x, y, c))));
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        let view = ColorView { image, view, t_us: 0, occlusion: None };
        for (x, y) in (0..17).flat_map(|y| (0..23).map(move |x| (x, y))) {
            for radius in 0..5 {
                let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let clipped = clipped_mean(view.image.as_raw(), [23, 17], [x, y], radius);
                assert_eq!(view.mean_color(pixel, radius), clipped, "radius {radius} at {x}, {y}");
            }
        }
    }

    #[test]
    fn recorded_images_are_sampled_through_their_lens() {
        let rows = [[700.0, 0.0, 800.0], [0.0, 705.0, 450.0], [0.0, 0.0, 1.0]];
        let pinhole = Camera::new("c", 1600, 900, rows).unwrap();
        let lens = LensModel::from_opencv([-0.28, 0.071, 0.0011, -0.0007, -0.0079]);
        let camera = Camera { lens, ..pinhole.clone() };
        let place = DAffine3::from_rotation_y(0.2) * DAffine3::from_translation(DVec3::new(3.0, 1.0, 2.0));
        let [bent, straight] =
            [camera, pinhole].map(|camera| View { camera, camera_from_world: place.inverse() });
        let project = [&bent, &straight].map(|view| Projector::new(view, &place));
        // At the edge of the image the lens moves a point inward by 100 pixels.
        let point = DVec3::new(6.0, 2.0, 5.5);
        let [(seen, depth_m), (ideal, _)] = [0, 1].map(|i| project[i].pixel(point).unwrap());
        assert!(seen.distance(ideal) > 100.0 && seen.x < ideal.x, "{seen} {ideal}");
        let (expected, z) = bent.project_recorded(place.transform_point3(point)).unwrap();
        assert!(seen.distance(expected) < 1e-9 && (depth_m - z).abs() < 1e-12);
        assert_eq!(straight.project_recorded(DVec3::ONE), straight.project(DVec3::ONE));
        // The image is colored by columns, so the color identifies the sampled column.
        let image = RgbImage::from_fn(1600, 900, |x, _| image::Rgb([(x / 10) as u8, 0, 0]));
        let view = ColorView { image, view: bent, t_us: 0, occlusion: None };
        let sample = sample_at(&view, &project[0], point).unwrap();
        assert!((f64::from(sample.rgb[0]) - seen.x / 10.0).abs() < 1.0, "{sample:?} {seen}");
        // Beyond the range where its distortion is monotonic, the lens yields no pixel, thus no ghost image.
        assert_eq!(project[0].pixel(DVec3::new(40.0, 0.0, 5.0)), None);
    }

    #[test]
    fn a_color_is_the_mean_over_the_footprint() {
        let rows = [[100.0, 0.0, 20.0], [0.0, 100.0, 20.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 1600, 40, rows).unwrap();
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        let image = RgbImage::from_fn(1600, 40, |x, _| image::Rgb([if x < 20 { 0 } else { 70 }, 8, 9]));
        let color_view = ColorView { image, view, t_us: 0, occlusion: None };
        let project = Projector::new(&color_view.view, &DAffine3::IDENTITY);
        let at = |x: f64, z: f64| sample_at(&color_view, &project, DVec3::new(x, 0.0, z)).map(|l| l.rgb);
        // Pixel column 20: of 7 columns 17..=23 four are bright; far away, of 3 columns two.
        assert_eq!(at(0.0, 10.0), Some([40, 8, 9]));
        assert_eq!(at(0.0, 50.0), Some([47, 8, 9]));
        // Clipped at the border: columns 0..=5.
        assert_eq!(at(-1.75, 10.0), Some([0, 8, 9]));
        assert_eq!([at(-2.1, 10.0), at(158.1, 10.0), at(0.0, 0.05), at(0.0, -5.0)], [None; 4]);
    }
}
