//! Metrics compared with NumPy, SciPy and OpenCV (`tests/peers/quality.py`).

use std::collections::BTreeMap;

use image::RgbImage;
use pskel_eval::{FeatureSet, frechet_distance, mean_interval, psnr_db, sharpness, ssim, vehicle_mask};
use serde::Deserialize;

#[derive(Deserialize)]
struct Peers {
    images: Vec<Images>,
    sets: Vec<Sets>,
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
struct Sets {
    rows: [usize; 2],
    columns: usize,
    distance: f64,
}

#[derive(Deserialize)]
struct Masks {
    size: [usize; 2],
    class: Vec<u8>,
    mask: Vec<u8>,
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

fn features(rows: usize, columns: usize, start: u64) -> FeatureSet {
    let mut values: Vec<f64> = (0..rows * columns)
        .map(|i| level(start + i as u64) as f64 / 255.0 * (1 + i % columns % 4) as f64)
        .collect();
    for row in values.chunks_exact_mut(columns) {
        let before = row.to_vec();
        (1..columns).for_each(|c| row[c] += 0.5 * before[c - 1]);
    }
    FeatureSet::new(columns, values).unwrap()
}

#[track_caller]
fn assert_close(what: &str, ours: f64, peer: f64, most: f64) {
    assert!((ours - peer).abs() <= most * (1.0 + peer.abs()), "{what}: {ours}, peer {peer}");
}

#[test]
fn images_are_compared_as_numpy_does() {
    for case in peers().images {
        let [a, b] = case.starts.map(|start| image(case.size, start, case.smooth));
        assert_close("PSNR", psnr_db(&a, &b).unwrap(), case.psnr_db, 1e-12);
        assert_close("SSIM", ssim(&a, &b).unwrap(), case.ssim, 1e-9);
        assert_close("sharpness", sharpness(&a).unwrap(), case.sharpness, 1e-12);
    }
}

#[test]
fn distances_are_those_of_scipy() {
    for case in peers().sets {
        let (a, b) = (features(case.rows[0], case.columns, 0), features(case.rows[1], case.columns, 50_000));
        // With fewer rows than features the rank is deficient: square roots amplify rounding errors.
        let most = if case.rows.iter().all(|rows| *rows > case.columns) { 1e-9 } else { 1e-6 };
        let ours = frechet_distance(&a, &b).unwrap();
        assert_close(&format!("{:?} rows", case.rows), ours, case.distance, most);
    }
}

#[test]
fn vehicle_masks_are_those_of_opencv() {
    for case in peers().masks {
        let mask: Vec<u8> = vehicle_mask(&case.class, case.size[1]).into_iter().map(u8::from).collect();
        assert_eq!(mask, case.mask, "{:?}", case.size);
    }
}

#[test]
fn intervals_have_the_quantiles_of_scipy() {
    for (degrees, t) in peers().student_t {
        let count = degrees.parse::<usize>().unwrap() + 1;
        let values: Vec<f64> = (0..count).map(|i| (i * i % 7) as f64 + i as f64).collect();
        let interval = mean_interval(&values).unwrap();
        let squares: f64 = values.iter().map(|v| (v - interval.mean).powi(2)).sum();
        let error = (squares / (count - 1) as f64 / count as f64).sqrt();
        assert_close(&format!("{degrees} degrees"), interval.half_width.unwrap() / error, t, 1e-6);
    }
}
