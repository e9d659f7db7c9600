use super::*;

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

fn score(steps: u32, generated: impl Fn(u32) -> Vec<RgbImage>) -> Scores {
    let mut scores = RolloutScores::default();
    for step in 0..steps {
        let ((truth, moving), generated) = (truth(step), generated(step));
        let class: Vec<Vec<u8>> =
            moving.iter().map(|mask| mask.iter().map(|m| u8::from(*m)).collect()).collect();
        let nothing = vec![vec![false; (WIDTH * HEIGHT) as usize]; CAMERAS as usize];
        let frame = ScoredFrame {
            t_s: f64::from(step) * 0.5,
            generated: &generated,
            truth: Some(&truth),
            class: Some(&class),
            moving: Some(&moving),
            masks: match step {
                0 => None,
                1 => Some(&nothing),
                _ => Some(&moving),
            },
        };
        scores.push(&frame).unwrap();
    }
    scores.finish()
}

#[test]
fn ground_truth_copies_score_perfectly() {
    let scores = score(17, |step| truth(step).0);
    assert_eq!((scores.steps, scores.cameras, scores.steps_with_truth, scores.equal_images), (17, 2, 17, 34));
    assert_eq!(scores.psnr_db.mean, None);
    assert!((scores.ssim.mean.unwrap() - 1.0).abs() < 1e-12);
    assert_eq!(scores.sharpness_ratio.steps, [Some(1.0); 17]);
    assert_eq!(scores.sharpness_ratio.drift.unwrap().slope_per_s, 0.0);
    let motion = scores.motion.unwrap();
    assert_eq!((motion.slope, motion.flicker), (Some(1.0), Some(1.0)));
    // A closing leaves rectangles as they are. One of 16 steps has empty masks.
    let iou = &scores.iou["masks"];
    assert_eq!(iou.generated, Some(15.0 / 16.0));
    assert_eq!(iou.steps.steps[..3], [None, Some(0.0), Some(1.0)]);
    assert_eq!(scores.numbers()["iou_masks"], iou.generated);
}

#[test]
fn fading_images_drift() {
    let scores = score(9, |step| faded(&truth(step).0, step));
    let slope = |series: &Series| series.drift.unwrap().slope_per_s;
    assert!(slope(&scores.psnr_db) < 0.0 && slope(&scores.ssim) < 0.0 && slope(&scores.sharpness) < 0.0);
    let last = scores.sharpness_ratio.steps[8].unwrap();
    assert!((last - 0.2).abs() < 0.05, "{last}");
    let slope = scores.motion.unwrap().slope.unwrap();
    assert!(slope > 0.1 && slope < 0.9, "{slope}");
}

#[test]
fn metrics_are_missing_without_ground_truth() {
    let mut scores = RolloutScores::default();
    for step in 0..4 {
        let images = truth(step).0;
        let frame = ScoredFrame {
            t_s: f64::from(step),
            generated: &images,
            truth: (step == 1).then_some(images.as_slice()),
            class: None,
            moving: None,
            masks: None,
        };
        scores.push(&frame).unwrap();
    }
    let scores = scores.finish();
    assert_eq!((scores.steps_with_truth, scores.motion), (1, None));
    assert_eq!(
        scores.ssim.steps.iter().map(Option::is_some).collect::<Vec<_>>(),
        [false, true, false, false]
    );
    assert!(scores.sharpness.mean.is_some() && scores.iou.is_empty());
    serde_json::to_string(&scores).unwrap();
}

#[test]
fn rejects_size_changes() {
    let mut scores = RolloutScores::default();
    let (images, masks) = truth(0);
    let frame =
        ScoredFrame { t_s: 0.0, generated: &images, truth: None, class: None, moving: None, masks: None };
    scores.push(&frame).unwrap();
    let message = |frame: ScoredFrame<'_>| scores.clone().push(&frame).unwrap_err().to_string();
    assert_eq!(
        message(ScoredFrame { generated: &images[..1], ..frame }),
        "expected generated images of 2 cameras, found 1"
    );
    let small = [images[0].clone(), RgbImage::new(8, 4)];
    assert_eq!(
        message(ScoredFrame { truth: Some(&small), ..frame }),
        "expected ground-truth images of 16x28 pixels for camera 1, found 4x8"
    );
    let class = [vec![0; 448], vec![0; 447]];
    assert_eq!(
        message(ScoredFrame { class: Some(&class), ..frame }),
        "expected class maps of 448 pixels for camera 1, found 447"
    );
    assert_eq!(
        message(ScoredFrame { masks: Some(&masks[..1]), ..frame }),
        "expected external vehicle masks of 2 cameras, found 1"
    );
    assert_eq!(scores.finish().steps, 1);
}
