//! Model tensors compared with NumPy and with the reference's bins.

use point_skeleton::conditions::{BinScale, DepthBins, DepthEmbedding, TensorEncoder, tensor};
use pskel_testing::npz;
use pskel_testing::shared;

const ALLOWED: f32 = 1e-5;

/// Returns the maximum absolute difference of two tensors.
fn farthest(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn bins(scale: BinScale, far_m: f32) -> DepthBins {
    DepthBins { scale, far_m, ..DepthBins::default() }
}

#[derive(serde::Deserialize)]
struct Peers {
    color: Vec<u8>,
    depth: Vec<f32>,
    boxes: Vec<u8>,
    map: Vec<u8>,
    layout: Vec<f32>,
    cases: Vec<Case>,
}

#[derive(serde::Deserialize)]
struct Case {
    scale: String,
    far_m: f32,
    bins: Vec<u16>,
    points: Vec<f32>,
}

#[test]
fn tensors_match_numpy() {
    let peers: Peers = serde_json::from_str(include_str!("../peers/tensor.json")).unwrap();
    let rgb = |levels: &[u8]| levels.as_chunks::<3>().0.to_vec();
    for case in peers.cases {
        let scale = if case.scale == "log" { BinScale::Log } else { BinScale::Linear };
        let bins = bins(scale, case.far_m);
        let found: Vec<u16> = peers.depth.iter().map(|d| bins.bin(*d)).collect();
        assert_eq!(found, case.bins, "{}", case.scale);
        let encoder = TensorEncoder::new(bins, DepthEmbedding::Both);
        let off = farthest(&encoder.points(&rgb(&peers.color), &peers.depth), &case.points);
        println!("{}: {off:e}", case.scale);
        assert!(off <= ALLOWED, "{}: {off}", case.scale);
    }
    let layout = tensor::layout(&rgb(&peers.boxes), Some(&rgb(&peers.map)));
    assert!(farthest(&layout, &peers.layout) <= ALLOWED);
}

/// Computes the depth channels independently: pixel by pixel, from the reference's bins.
fn channels_of(bin: u16) -> [f32; 17] {
    if bin == 0 {
        return std::array::from_fn(|channel| if channel == 0 { -1.0 } else { 0.0 });
    }
    let unit = f32::from(bin.min(255)) / 255.0;
    // All frequencies are powers of two, so only this product is rounded.
    let turn = f64::from(2.0 * std::f32::consts::PI * unit);
    std::array::from_fn(|channel| match channel {
        0 => unit,
        1..=8 => (turn * f64::from(1 << (channel - 1))).sin() as f32,
        _ => (turn * f64::from(1 << (channel - 9))).cos() as f32,
    })
}

#[test]
fn fixture_tensors_match_the_references_bins() {
    let Some(fixtures) = shared::fixtures("projection-pandaset") else { return };
    let path = fixtures.join("projection-pandaset/reduced.npz");
    let (color, depth) = (npz::read::<u8>(&path, "color"), npz::read::<f32>(&path, "depth"));
    let [cameras, height, width] = depth.shape[..] else { panic!("{:?}", depth.shape) };
    let pixels = height * width;
    for (scale, name) in [(BinScale::Linear, "bins_linear"), (BinScale::Log, "bins_log")] {
        let expected = npz::read::<u16>(&path, name).data;
        let encoder = TensorEncoder::new(bins(scale, 50.0), DepthEmbedding::Both);
        let mut filled = 0;
        for camera in 0..cameras {
            let range = camera * pixels..(camera + 1) * pixels;
            let color = &color.data.as_chunks::<3>().0[range.clone()];
            let points = encoder.points(color, &depth.data[range.clone()]);
            for (pixel, bin) in expected[range].iter().enumerate() {
                let value = |channel: usize| points[channel * pixels + pixel];
                assert_eq!([0, 1, 2].map(value), color[pixel].map(|level| f32::from(level) / 255.0));
                let found: [f32; 17] = std::array::from_fn(|channel| value(3 + channel));
                assert!(farthest(&found, &channels_of(*bin)) <= ALLOWED, "{name} {bin}: {found:?}");
                filled += usize::from(*bin > 0);
            }
        }
        assert!(filled > pixels, "{filled}");
    }
    // The comparison detects a bin that is off by one, most of all at the highest frequency.
    assert!(farthest(&channels_of(100), &channels_of(101)) > 100.0 * ALLOWED);
}
