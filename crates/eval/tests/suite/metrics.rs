//! Metrics compared with NumPy, SciPy and OpenCV (`tests/peers/quality.py`).

use std::collections::BTreeMap;

use image::RgbImage;
use point_skeleton::dataset::LogReader;
use point_skeleton::geometry::View;
use pskel_eval::{MaskRule, Overlap, VEHICLE_CLASS, mean_interval, psnr_db, sharpness, ssim, vehicle_mask};
use pskel_testing::synthetic_town::town;
use serde::Deserialize;

#[derive(Deserialize)]
struct Peers {
    images: Vec<Images>,
    masks: Vec<Masks>,
    student_t: BTreeMap<String, f64>,
}

#[derive(Deserialize)]
struct Images {
    size: [u32; 2],
    starts: [u64; 2],
    smooth: u64,
    psnr_db: f64,
    ssim: f64,
    sharpness: f64,
}

#[derive(Deserialize)]
struct Masks {
    size: [usize; 2],
    class: Vec<u8>,
    closed: Vec<u8>,
    blurred: Vec<u8>,
}

fn peers() -> Peers {
    serde_json::from_str(include_str!("../peers/quality.json")).unwrap()
}

/// Same numbers as in the script.
fn level(n: u64) -> u64 {
    (((n * 2_654_435_761 + 12_345) % (1 << 32)) >> 13) % 256
}

fn image([height, width]: [u32; 2], start: u64, smooth: u64) -> RgbImage {
    let channel = |x: u32, y: u32, c: u32| {
        let v = level(start + u64::from((y * width + x) * 3 + c));
        let ramp = u64::from((5 * y + 3 * x + 40 * c) % 256);
        ((v + smooth * ramp) / (1 + smooth)) as u8
    };
    RgbImage::from_fn(width, height, |x, y| image::Rgb([0, 1, 2].map(|c| channel(x, y, c))))
}

#[track_caller]
fn assert_close(what: &str, ours: f64, peer: f64, most: f64) {
    assert!((ours - peer).abs() <= most * (1.0 + peer.abs()), "{what}: {ours}, peer {peer}");
}

#[test]
fn image_metrics_match_numpy() {
    for case in peers().images {
        let [a, b] = case.starts.map(|start| image(case.size, start, case.smooth));
        assert_close("PSNR", psnr_db(&a, &b).unwrap(), case.psnr_db, 1e-12);
        assert_close("SSIM", ssim(&a, &b).unwrap(), case.ssim, 1e-9);
        assert_close("sharpness", sharpness(&a).unwrap(), case.sharpness, 1e-12);
    }
}

#[test]
fn vehicle_masks_match_opencv() {
    for Masks { size, class, closed, blurred } in peers().masks {
        for (rule, peer) in [(MaskRule::Closing, closed), (MaskRule::Paper, blurred)] {
            let mask: Vec<u8> = vehicle_mask(&class, size[1], rule).into_iter().map(u8::from).collect();
            assert_eq!(mask, peer, "{size:?}, {rule}");
        }
    }
}

/// Vehicles of a town: the projection hardly changes their dense masks, and restores most of the masks from
/// sparse points.
#[test]
fn vehicle_masks_match_the_town() {
    let [mut dense, mut sparse, mut points] = [Overlap::default(); 3];
    for frame in &town().recording().frames {
        let view = |image: &point_skeleton::dataset::ImageRecord| View {
            camera: image.camera.resized(64, 112),
            camera_from_world: image.camera_from_global().affine(),
        };
        let views: Vec<View> = frame.images.iter().map(view).collect();
        for seen in town().truth(frame.t_us, &views).unwrap() {
            let truth: Vec<bool> = seen.class.iter().map(|class| *class == VEHICLE_CLASS).collect();
            let is_kept = |i: usize| point_skeleton::hash::unit(1, &[i as i64]) < 0.4;
            let retained = |(i, class): (usize, &u8)| if is_kept(i) { *class } else { 0 };
            let few: Vec<u8> = seen.class.iter().enumerate().map(retained).collect();
            dense.add_masks(&vehicle_mask(&seen.class, 112, MaskRule::Closing), &truth);
            sparse.add_masks(&vehicle_mask(&few, 112, MaskRule::Closing), &truth);
            points.add_maps((&few, |class| *class == VEHICLE_CLASS), (&truth, |is| *is));
        }
    }
    let [dense, sparse, points] = [dense, sparse, points].map(|overlap| overlap.iou().unwrap());
    assert!(dense >= 0.9, "{dense}");
    assert!(sparse > 0.7 && points < 0.45, "{sparse} {points}");
}

#[test]
fn interval_quantiles_match_scipy() {
    for (degrees, t) in peers().student_t {
        let count = degrees.parse::<usize>().unwrap() + 1;
        let values: Vec<f64> = (0..count).map(|i| (i * i % 7) as f64 + i as f64).collect();
        let interval = mean_interval(&values).unwrap();
        let squares: f64 = values.iter().map(|v| (v - interval.mean).powi(2)).sum();
        let error = (squares / (count - 1) as f64 / count as f64).sqrt();
        assert_close(&format!("{degrees} degrees"), interval.half_width.unwrap() / error, t, 1e-6);
    }
}
