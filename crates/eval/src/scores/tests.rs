use super::*;
use crate::WINDOW_FRAMES;

const WIDTH: u32 = 28;
const HEIGHT: u32 = 16;
const CAMERAS: u32 = 2;

/// Returns images of a car that drives to the right over a pattern, and its masks.
fn truth(step: u32) -> (Vec<RgbImage>, Vec<Vec<bool>>) {
    let inside = |x: u32, y: u32| (step..step + 8).contains(&x) && (4..12).contains(&y);
    let image = |camera: u32| {
        RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            let back = (20 * (x % 3) + 9 * (y % 4) + 40 * camera + step % 2) as u8;
            image::Rgb(if inside(x, y) { [220, 30, 60] } else { [back, back, 90] })
        })
    };
    let mask: Vec<bool> = (0..WIDTH * HEIGHT).map(|i| inside(i % WIDTH, i / WIDTH)).collect();
    ((0..CAMERAS).map(image).collect(), vec![mask; CAMERAS as usize])
}

/// Mixes images with `parts` tenths of gray.
fn faded(images: &[RgbImage], parts: u32) -> Vec<RgbImage> {
    let fade = |level: &mut u8| *level = ((u32::from(*level) * (10 - parts) + 128 * parts) / 10) as u8;
    let image = |image: &RgbImage| {
        let mut image = image.clone();
        image.iter_mut().for_each(fade);
        image
    };
    images.iter().map(image).collect()
}

fn score(steps: u32, generated: impl Fn(u32) -> Vec<RgbImage>) -> (Scores, CollectedFeatures) {
    let mut scores = RolloutScores::new(RandomConvNet::new(1));
    for step in 0..steps {
        let ((truth, moving), generated) = (truth(step), generated(step));
        let class: Vec<Vec<u8>> =
            moving.iter().map(|mask| mask.iter().map(|m| u8::from(*m)).collect()).collect();
        let nothing = vec![vec![false; (WIDTH * HEIGHT) as usize]; CAMERAS as usize];
        let segmented = [
            SegmentationMasks { name: "right", generated: &moving, truth: Some(&moving) },
            SegmentationMasks { name: "blind", generated: &nothing, truth: None },
        ];
        let frame = ScoredFrame {
            t_s: f64::from(step) * 0.5,
            generated: &generated,
            truth: Some(&truth),
            class: Some(&class),
            moving: Some(&moving),
            segmented: &segmented,
        };
        scores.push(&frame).unwrap();
    }
    scores.finish()
}

#[test]
fn ground_truth_copies_score_perfectly() {
    let (scores, features) = score(17, |step| truth(step).0);
    assert_eq!((scores.steps, scores.cameras, scores.steps_with_truth, scores.equal_images), (17, 2, 17, 34));
    assert_eq!(scores.psnr_db.mean, None);
    assert!((scores.ssim.mean.unwrap() - 1.0).abs() < 1e-12);
    assert_eq!(scores.sharpness_ratio.steps, [Some(1.0); 17]);
    assert_eq!(scores.sharpness_ratio.drift.unwrap().slope_per_s, 0.0);
    let motion = scores.motion.unwrap();
    assert_eq!((motion.slope, motion.flicker), (Some(1.0), Some(1.0)));
    // A closing leaves rectangles as they are.
    let right = &scores.iou["right"];
    assert_eq!((right.generated, right.truth, right.ratio), (Some(1.0), Some(1.0), Some(1.0)));
    assert_eq!(scores.iou["blind"].steps.steps, [Some(0.0); 17]);
    assert_eq!((scores.iou["blind"].truth, scores.iou["blind"].ratio), (None, None));
    let distances = features.distances().unwrap();
    let (images, videos) = (distances.images.unwrap(), distances.videos.unwrap());
    assert!(images.distance < 1e-6 && videos.distance < 1e-6, "{distances:?}");
    assert_eq!((images.generated, images.truth, images.features), (34, 34, RandomConvNet::FEATURES));
    assert_eq!(
        (videos.generated, videos.features),
        (2 * (17 - WINDOW_FRAMES + 1), 2 * RandomConvNet::FEATURES)
    );
    assert_eq!(distances.network, "RandomConvNet, seed 1");
}

#[test]
fn fading_images_drift() {
    let (scores, features) = score(9, |step| faded(&truth(step).0, step));
    let slope = |series: &Series| series.drift.unwrap().slope_per_s;
    assert!(slope(&scores.psnr_db) < 0.0 && slope(&scores.ssim) < 0.0 && slope(&scores.sharpness) < 0.0);
    let last = scores.sharpness_ratio.steps[8].unwrap();
    assert!((last - 0.2).abs() < 0.05, "{last}");
    let slope = scores.motion.unwrap().slope.unwrap();
    assert!(slope > 0.1 && slope < 0.9, "{slope}");
    // The rollout is too short for windows.
    let distances = features.distances().unwrap();
    assert!(distances.videos.is_none() && distances.images.unwrap().distance > 0.01, "{distances:?}");
}

#[test]
fn features_of_rollouts_are_pooled() {
    let ((_, one), (_, other)) = (score(4, |step| truth(step).0), score(3, |step| faded(&truth(step).0, 9)));
    let mut all = CollectedFeatures::default();
    assert!(all.append(&one) && all.append(&other));
    assert_eq!(all.distances().unwrap().images.map(|d| (d.generated, d.truth)), Some((14, 14)));
    let (_, foreign) = RolloutScores::new(RandomConvNet::new(2)).finish();
    assert!(!all.append(&foreign));
    assert_eq!(CollectedFeatures::default().distances().unwrap().images, None);
}

#[test]
fn metrics_are_missing_without_ground_truth() {
    let mut scores = RolloutScores::new(RandomConvNet::new(1));
    for step in 0..4 {
        let images = truth(step).0;
        let frame = ScoredFrame {
            t_s: f64::from(step),
            generated: &images,
            truth: (step == 1).then_some(images.as_slice()),
            class: None,
            moving: None,
            segmented: &[],
        };
        scores.push(&frame).unwrap();
    }
    let (scores, features) = scores.finish();
    assert_eq!((scores.steps_with_truth, scores.motion), (1, None));
    assert_eq!(
        scores.ssim.steps.iter().map(Option::is_some).collect::<Vec<_>>(),
        [false, true, false, false]
    );
    assert!(scores.sharpness.mean.is_some() && scores.iou.is_empty());
    assert_eq!(features.distances().unwrap().images.map(|d| (d.generated, d.truth)), Some((8, 2)));
    serde_json::to_string(&scores).unwrap();
}

#[test]
fn rejects_size_changes() {
    let mut scores = RolloutScores::new(RandomConvNet::new(1));
    let (images, masks) = truth(0);
    let frame =
        ScoredFrame { t_s: 0.0, generated: &images, truth: None, class: None, moving: None, segmented: &[] };
    scores.push(&frame).unwrap();
    let message = |frame: ScoredFrame<'_>| scores.clone().push(&frame).unwrap_err().to_string();
    assert_eq!(
        message(ScoredFrame { generated: &images[..1], ..frame }),
        "expected generated images of 2 cameras, found 1"
    );
    let small = [images[0].clone(), RgbImage::new(8, 4)];
    assert_eq!(
        message(ScoredFrame { truth: Some(&small), ..frame }),
        "expected true images of 16x28 pixels for camera 1, found 4x8"
    );
    let class = [vec![0; 448], vec![0; 447]];
    assert_eq!(
        message(ScoredFrame { class: Some(&class), ..frame }),
        "expected class maps of 448 pixels for camera 1, found 447"
    );
    let segmented = [SegmentationMasks { name: "a", generated: &masks[..1], truth: None }];
    assert_eq!(
        message(ScoredFrame { segmented: &segmented, ..frame }),
        "expected a segmentor's masks of 2 cameras, found 1"
    );
    assert_eq!(scores.finish().0.steps, 1);
}
