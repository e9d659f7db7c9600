use image::RgbImage;
use rayon::prelude::*;

/// Minimum speed of a moving actor, meters per second (exclusive).
pub const MOVING_MPS: f64 = 0.5;

/// Motion of generated images relative to the ground truth: how well moving actors move, and how much the
/// rest flickers.
///
/// The change dG of a generated image is regressed on the change dT of the ground truth, over all channels of
/// pixels that show a moving actor in a frame or in the previous one. Flicker that is independent of the
/// ground truth averages out.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Motion {
    /// `sum(dG·dT) / sum(dT·dT)` on moving actors: 1 moves like the ground truth, 0 does not move. `None` if
    /// the ground truth does not change.
    pub slope: Option<f64>,
    /// Number of compared pixels on moving actors.
    pub moving_pixels: u64,
    /// Root mean square of dG, relative to dT's, on all other pixels: 1 changes like the ground truth. `None`
    /// if the ground truth does not change, as with a stationary ego.
    pub flicker: Option<f64>,
    /// Root mean square of dG on all other pixels, levels; `None` if there are none.
    pub static_generated_rms: Option<f64>,
    /// Root mean square of dT on all other pixels, levels; `None` if there are none.
    pub static_truth_rms: Option<f64>,
    /// Number of other pixels that were compared.
    pub static_pixels: u64,
}

/// One camera's images of a frame.
#[derive(Clone, Copy, Debug)]
pub struct MovingFrame<'a> {
    /// The generated image.
    pub generated: &'a RgbImage,
    /// The ground-truth image, of the same size.
    pub truth: &'a RgbImage,
    /// Whether each pixel shows a moving actor, row by row.
    pub moving: &'a [bool],
}

/// Sums for [`Motion`], over frames and cameras. They are integers, so their order does not matter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionSums {
    moving: Sums,
    rest: Sums,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Sums {
    pixels: u64,
    both: i64,
    generated: i64,
    truth: i64,
}

impl Sums {
    fn add(&mut self, generated: i64, truth: i64) {
        self.both += generated * truth;
        self.generated += generated * generated;
        self.truth += truth * truth;
    }

    fn join(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.both += other.both;
        self.generated += other.generated;
        self.truth += other.truth;
    }

    fn rms(&self, sum: i64) -> Option<f64> {
        (self.pixels > 0).then(|| (sum as f64 / (3 * self.pixels) as f64).sqrt())
    }
}

impl MotionSums {
    /// Adds the change between two consecutive frames of one camera. All images and masks are of one size.
    pub fn add(&mut self, before: &MovingFrame<'_>, now: &MovingFrame<'_>) {
        let pixels = |image: &RgbImage| -> Vec<[u8; 3]> { image.as_raw().as_chunks::<3>().0.to_vec() };
        let generated = pixels(before.generated).into_iter().zip(pixels(now.generated));
        let truth = pixels(before.truth).into_iter().zip(pixels(now.truth));
        let moving = before.moving.iter().zip(now.moving);
        for (((g0, g1), (t0, t1)), (m0, m1)) in generated.zip(truth).zip(moving) {
            let sums = if *m0 || *m1 { &mut self.moving } else { &mut self.rest };
            sums.pixels += 1;
            for c in 0..3 {
                sums.add(i64::from(g1[c]) - i64::from(g0[c]), i64::from(t1[c]) - i64::from(t0[c]));
            }
        }
    }

    /// Adds other sums.
    pub fn join(&mut self, other: &Self) {
        self.moving.join(&other.moving);
        self.rest.join(&other.rest);
    }

    /// Computes the motion; `None` if no frames were compared.
    pub fn finish(&self) -> Option<Motion> {
        let ratio = |a: i64, b: i64| (b > 0).then(|| a as f64 / b as f64);
        let (moving, rest) = (&self.moving, &self.rest);
        (moving.pixels + rest.pixels > 0).then(|| Motion {
            slope: ratio(moving.both, moving.truth),
            moving_pixels: moving.pixels,
            flicker: ratio(rest.generated, rest.truth).map(f64::sqrt),
            static_generated_rms: rest.rms(rest.generated),
            static_truth_rms: rest.rms(rest.truth),
            static_pixels: rest.pixels,
        })
    }
}

/// Returns the pixels of an instance map that show an actor with one of the given numbers.
pub fn moving_mask(instance: &[u32], moving: &[u32]) -> Vec<bool> {
    instance.par_iter().map(|number| moving.contains(number)).collect()
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Uniform};
    use rand_seeder::Seeder;

    use super::*;

    const WIDTH: u32 = 40;
    const HEIGHT: u32 = 20;
    const FRAMES: u32 = 12;

    fn noise(seed: u32) -> Vec<u8> {
        let mut random: ChaCha8Rng = Seeder::from(seed).into_rng();
        let levels = Uniform::new(0, 60).unwrap();
        (0..WIDTH * HEIGHT * 3).map(|_| levels.sample(&mut random)).collect()
    }

    /// A bright square of 6x6 pixels that moves by 2 per frame over a background that gets brighter.
    fn truth(frame: u32) -> (RgbImage, Vec<bool>) {
        let inside = |x: u32, y: u32| (2 * frame..2 * frame + 6).contains(&x) && (5..11).contains(&y);
        let image = RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            image::Rgb(if inside(x, y) { [200, 150, 220] } else { [(40 + frame + x % 3) as u8; 3] })
        });
        let mask = (0..WIDTH * HEIGHT).map(|i| inside(i % WIDTH, i / WIDTH)).collect();
        (image, mask)
    }

    fn motion(generated: impl Fn(u32) -> RgbImage) -> Motion {
        let mut sums = MotionSums::default();
        for frame in 1..FRAMES {
            let (images, truths) =
                ([generated(frame - 1), generated(frame)], [truth(frame - 1), truth(frame)]);
            let at =
                |i: usize| MovingFrame { generated: &images[i], truth: &truths[i].0, moving: &truths[i].1 };
            sums.add(&at(0), &at(1));
        }
        sums.finish().unwrap()
    }

    #[test]
    fn separates_motion_from_flicker() {
        let copy = motion(|frame| truth(frame).0);
        assert_eq!((copy.slope, copy.flicker), (Some(1.0), Some(1.0)));
        // Two of six columns are newly covered, two are uncovered, four remain: eight in all.
        assert_eq!(copy.moving_pixels, u64::from(8 * 6 * (FRAMES - 1)));
        assert_eq!((copy.static_truth_rms, copy.static_generated_rms), (Some(1.0), Some(1.0)));
        let frozen = motion(|_| truth(0).0);
        assert_eq!((frozen.slope, frozen.flicker), (Some(0.0), Some(0.0)));
        let noisy = motion(|frame| RgbImage::from_raw(WIDTH, HEIGHT, noise(frame)).unwrap());
        assert!(noisy.slope.unwrap().abs() < 0.05, "{noisy:?}");
        assert!(noisy.flicker.unwrap() > 10.0 && noisy.static_generated_rms.unwrap() > 10.0, "{noisy:?}");
        // Half the contrast has half the slope, with or without added noise.
        let half = motion(|frame| {
            let mut image = truth(frame).0;
            image.iter_mut().zip(noise(frame)).for_each(|(v, n)| *v = *v / 2 + n);
            image
        });
        assert!((half.slope.unwrap() - 0.5).abs() < 0.05, "{half:?}");
    }

    #[test]
    fn static_ground_truth_has_no_ratios() {
        assert_eq!(MotionSums::default().finish(), None);
        let still = RgbImage::new(2, 1);
        let frame = MovingFrame { generated: &still, truth: &still, moving: &[false, true] };
        let mut sums = MotionSums::default();
        sums.add(&frame, &frame);
        let motion = sums.finish().unwrap();
        assert_eq!((motion.slope, motion.flicker, motion.moving_pixels), (None, None, 1));
        assert_eq!(motion.static_generated_rms, Some(0.0));
        assert_eq!(moving_mask(&[0, 1, 2, 3, 2], &[2, 3]), [false, false, true, true, true]);
    }
}
