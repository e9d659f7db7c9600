use image::RgbImage;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Uniform};
use rand_seeder::Seeder;
use serde::Serialize;
use smartcore::ensemble::random_forest_regressor::{RandomForestRegressor, RandomForestRegressorParameters};
use smartcore::linalg::basic::matrix::DenseMatrix;

/// Training options of a [`PatchClassifier`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PatchOptions {
    /// Seed of the pixel sampling and of the trees.
    pub seed: u64,
    /// Patch radius, pixels: patches have a side of `2·radius + 1`.
    pub radius: usize,
    /// Number of trees in the forest.
    pub trees: usize,
    /// Maximum depth of a tree.
    pub max_depth: u16,
    /// Maximum number of pixels sampled per image: half of them on vehicles, if there are enough.
    pub pixels_per_image: usize,
    /// Maximum number of training pixels.
    pub pixels: usize,
}

impl Default for PatchOptions {
    fn default() -> Self {
        Self { seed: 0, radius: 2, trees: 40, max_depth: 12, pixels_per_image: 256, pixels: 20_000 }
    }
}

/// Error of a [`PatchClassifier`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PatchClassifierError {
    /// Pixels of vehicles or of other things are missing.
    #[error(
        "expected true images with pixels of vehicles and of others to train on, found {vehicles} and \
            {others}"
    )]
    Pixels {
        /// Pixels of vehicles.
        vehicles: usize,
        /// All other pixels.
        others: usize,
    },
    /// Error of the random forest.
    #[error("the random forest cannot be trained: {0}")]
    Forest(String),
}

type Forest = RandomForestRegressor<f32, f64, DenseMatrix<f32>, Vec<f64>>;

/// Classifies pixels as vehicle or not, from the colors around them and from their position; a fallback if
/// there is no segmentation network.
///
/// A random forest on the RGB values of a small patch, and on row and column as fractions of the image's
/// sides. It recognizes vehicles of the scenes that it was trained on, at their size; it is not a general
/// segmentation model. Its IoU is only meaningful beside its IoU on ground-truth images. The forest returns a
/// share of votes. The threshold on that share is the one with the best IoU on the training pixels, each
/// classified by trees that were not trained on it.
#[derive(Debug)]
pub struct PatchClassifier {
    forest: Forest,
    radius: usize,
    threshold: f64,
}

/// Collects training pixels for a [`PatchClassifier`].
#[derive(Clone, Debug)]
pub struct PatchTrainer {
    options: PatchOptions,
    images: u64,
    samples: Vec<Sample>,
}

#[derive(Clone, Debug)]
struct Sample {
    features: Vec<f32>,
    vehicle: bool,
    /// Number of pixels that it represents: of the same class, in the same image.
    weight: f64,
}

impl PatchTrainer {
    /// Creates a trainer without images.
    pub fn new(options: PatchOptions) -> Self {
        Self { options, images: 0, samples: Vec::new() }
    }

    /// Samples pixels of a ground-truth image. `vehicles` is the mask of its vehicles, row by row, of the
    /// same size. The choice depends on the seed and the number of the image.
    pub fn add(&mut self, image: &RgbImage, vehicles: &[bool]) {
        let mut random: ChaCha8Rng = Seeder::from((self.options.seed, "patches", self.images)).into_rng();
        self.images += 1;
        let half = self.options.pixels_per_image / 2;
        let mut left = self.options.pixels_per_image;
        for vehicle in [true, false] {
            let mut of_kind: Vec<usize> = (0..vehicles.len()).filter(|i| vehicles[*i] == vehicle).collect();
            let all = of_kind.len();
            // If there are few vehicle pixels, more of the other pixels are taken.
            let taken = all.min(if vehicle { half } else { left });
            left -= taken;
            for place in 0..taken {
                let Ok(any) = Uniform::new(place, all) else { break };
                of_kind.swap(place, any.sample(&mut random));
                let features = features(image, of_kind[place], self.options.radius);
                self.samples.push(Sample { features, vehicle, weight: all as f64 / taken as f64 });
            }
        }
    }

    /// Number of images added so far.
    pub fn images(&self) -> u64 {
        self.images
    }

    /// Trains on the pixels added so far, or on an evenly spaced subset if there are more than
    /// [`PatchOptions::pixels`].
    ///
    /// # Errors
    /// Returns an error if there are no pixels of vehicles or no other pixels, or if the forest cannot be
    /// trained.
    pub fn train(&self) -> Result<PatchClassifier, PatchClassifierError> {
        let (options, all) = (&self.options, self.samples.len());
        let kept = all.min(options.pixels);
        let samples: Vec<&Sample> = (0..kept).map(|i| &self.samples[i * all / kept]).collect();
        let vehicles = samples.iter().filter(|sample| sample.vehicle).count();
        if vehicles == 0 || vehicles == kept {
            return Err(PatchClassifierError::Pixels { vehicles, others: kept - vehicles });
        }
        let failed = |error: smartcore::error::Failed| PatchClassifierError::Forest(error.to_string());
        let x = matrix(samples.iter().map(|sample| sample.features.as_slice())).map_err(failed)?;
        let y: Vec<f64> = samples.iter().map(|sample| f64::from(u8::from(sample.vehicle))).collect();
        let parameters = RandomForestRegressorParameters {
            max_depth: Some(options.max_depth),
            min_samples_leaf: 2,
            min_samples_split: 4,
            n_trees: options.trees,
            m: None,
            keep_samples: true,
            seed: options.seed,
        };
        let forest = Forest::fit(&x, &y, parameters).map_err(failed)?;
        let votes = forest.predict_oob(&x).map_err(failed)?;
        let judged = samples.iter().zip(votes).map(|(sample, vote)| (vote, sample.vehicle, sample.weight));
        Ok(PatchClassifier { forest, radius: options.radius, threshold: best_threshold(judged.collect()) })
    }
}

impl PatchClassifier {
    /// Minimum share of votes for a pixel to count as vehicle.
    pub fn threshold(&self) -> f64 {
        self.threshold
    }

    /// Returns the mask of vehicles, row by row.
    ///
    /// # Errors
    /// Returns any error of the forest.
    pub fn segment(&self, image: &RgbImage) -> Result<Vec<bool>, PatchClassifierError> {
        let pixels = image.width() as usize * image.height() as usize;
        if pixels == 0 {
            return Ok(Vec::new());
        }
        let failed = |error: smartcore::error::Failed| PatchClassifierError::Forest(error.to_string());
        let rows: Vec<Vec<f32>> = (0..pixels).map(|at| features(image, at, self.radius)).collect();
        let x = matrix(rows.iter().map(Vec::as_slice)).map_err(failed)?;
        let votes = self.forest.predict(&x).map_err(failed)?;
        Ok(votes.iter().map(|vote| *vote >= self.threshold).collect())
    }
}

/// Returns the RGB values of the patch around a pixel, 0 to 1, then row and column, 0 to 1. Border pixels are
/// replicated beyond the image.
fn features(image: &RgbImage, at: usize, radius: usize) -> Vec<f32> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (row, column) = (at / width, at % width);
    let mut features = Vec::with_capacity(3 * (2 * radius + 1).pow(2) + 2);
    for y in row..=row + 2 * radius {
        for x in column..=column + 2 * radius {
            let (y, x) = (y.saturating_sub(radius).min(height - 1), x.saturating_sub(radius).min(width - 1));
            features.extend(image.get_pixel(x as u32, y as u32).0.map(|level| f32::from(level) / 255.0));
        }
    }
    let share = |at: usize, length: usize| (at as f32 + 0.5) / length as f32;
    features.extend([share(row, height), share(column, width)]);
    features
}

fn matrix<'a>(
    rows: impl ExactSizeIterator<Item = &'a [f32]>,
) -> Result<DenseMatrix<f32>, smartcore::error::Failed> {
    let count = rows.len();
    let values: Vec<f32> = rows.flatten().copied().collect();
    DenseMatrix::new(count, values.len() / count.max(1), values, false)
}

/// Returns the threshold on votes with the best IoU over (votes, is a vehicle, weight). Votes that are NaN or
/// infinite are ignored.
fn best_threshold(mut judged: Vec<(f64, bool, f64)>) -> f64 {
    judged.retain(|(vote, ..)| vote.is_finite());
    judged.sort_by(|a, b| b.0.total_cmp(&a.0));
    let vehicles: f64 = judged.iter().filter(|j| j.1).map(|j| j.2).sum();
    let (mut hit, mut wrong) = (0.0, 0.0);
    let mut best = (0.0, 0.5);
    for (index, (vote, vehicle, weight)) in judged.iter().enumerate() {
        *(if *vehicle { &mut hit } else { &mut wrong }) += weight;
        // The threshold is halfway between two different votes, so that rounding does not matter.
        let next = judged.get(index + 1).map_or(0.0, |next| next.0);
        let iou = hit / (vehicles + wrong);
        if next < *vote && iou > best.0 {
            best = (iou, f64::midpoint(*vote, next));
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Overlap;

    const WIDTH: u32 = 40;
    const HEIGHT: u32 = 24;

    /// A gray street under a blue sky with a reddish car, whose position differs from image to image.
    fn scene(number: u32) -> (RgbImage, Vec<bool>) {
        let (left, top) = (3 + 7 * number % 25, 10 + number % 5);
        let inside = |x: u32, y: u32| (left..left + 9).contains(&x) && (top..top + 6).contains(&y);
        let image = RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            let grain = ((x * 31 + y * 17 + number * 13) % 23) as u8;
            image::Rgb(match (inside(x, y), y < 8) {
                (true, _) => [150 + grain, 40 + grain, 60],
                (_, true) => [100, 120 + grain, 220],
                _ => [90 + grain, 90 + grain, 88 + grain],
            })
        });
        let mask = (0..WIDTH * HEIGHT).map(|i| inside(i % WIDTH, i / WIDTH)).collect();
        (image, mask)
    }

    fn iou(classifier: &PatchClassifier, image: &RgbImage, mask: &[bool]) -> f64 {
        let mut overlap = Overlap::default();
        overlap.add_masks(&classifier.segment(image).unwrap(), mask);
        overlap.iou().unwrap()
    }

    #[test]
    fn finds_cars_in_unseen_images() {
        let options = PatchOptions { trees: 20, ..PatchOptions::default() };
        let mut trainer = PatchTrainer::new(options);
        (0..6).map(scene).for_each(|(image, mask)| trainer.add(&image, &mask));
        let classifier = trainer.train().unwrap();
        assert!((0.0..=1.0).contains(&classifier.threshold()) && trainer.images() == 6);
        for number in 7..9 {
            let (image, mask) = scene(number);
            let found = iou(&classifier, &image, &mask);
            assert!(found > 0.8, "{number}: {found}");
            // In a scene with the car elsewhere, its old position is not classified as vehicle.
            let (empty, _) = scene(number + 3);
            assert!(iou(&classifier, &empty, &mask) < 0.5);
        }
        // The same seed gives the same masks.
        let (image, _) = scene(9);
        assert_eq!(trainer.train().unwrap().segment(&image), classifier.segment(&image));
        assert_eq!(classifier.segment(&RgbImage::new(0, 3)), Ok(Vec::new()));
    }

    #[test]
    fn training_needs_both_classes() {
        let mut trainer = PatchTrainer::new(PatchOptions::default());
        let none = PatchClassifierError::Pixels { vehicles: 0, others: 0 };
        assert_eq!(trainer.train().unwrap_err(), none);
        trainer.add(&scene(0).0, &[false; (WIDTH * HEIGHT) as usize]);
        let message = trainer.train().unwrap_err().to_string();
        assert!(message.ends_with("found 0 and 256"), "{message}");
    }

    #[test]
    fn picks_threshold_with_best_iou() {
        // Threshold between 0.8 and 0.4: two of three vehicles and nothing else. A third would cost pixels of
        // weight 4.
        let judged = vec![
            (0.9, true, 1.0),
            (0.4, false, 4.0),
            (0.8, true, 1.0),
            (0.3, true, 1.0),
            (f64::NAN, true, 9.0),
        ];
        assert!((best_threshold(judged) - 0.6).abs() < 1e-12);
        // Equal votes cannot be separated.
        assert!(
            (best_threshold(vec![(0.5, true, 1.0), (0.5, false, 1.0), (0.1, false, 9.0)]) - 0.3).abs()
                < 1e-12
        );
        assert_eq!(best_threshold(Vec::new()), 0.5);
    }
}
