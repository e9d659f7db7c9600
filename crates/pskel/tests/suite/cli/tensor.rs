//! Model tensors compared with NumPy and with the reference's bins, and as written by `pskel render`.

use point_skeleton::conditions::{
    BinScale, CameraConditions, DepthBins, DepthEmbedding, TensorEncoder, tensor,
};
use safetensors::{Dtype, SafeTensors};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FIRST_US, TinyLog};
use pskel_testing::{npz, shared as common};

const RENDER: &str = "render nuscenes:log --skeleton sk --out out";
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
    let peers: Peers = serde_json::from_str(include_str!("../../peers/tensor.json")).unwrap();
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
    let Some(fixtures) = common::fixtures("projection-pandaset") else { return };
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

fn built() -> TinyLog {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    log
}

#[test]
fn npz_and_safetensors_contain_the_tensor_of_the_maps() {
    let log = built();
    let maps = "--maps color,depth,class,boxes,tensor --depth-embedding both --depth-bins log --far 60";
    log.succeed(&format!("{RENDER} --frames 1..2 --out-size 16x24 --format npz {maps}"));
    let path = log.path("out/000001/maps.npz");
    let (points, layout) = (npz::read::<f32>(&path, "points"), npz::read::<f32>(&path, "layout"));
    assert_eq!((&points.shape[..], &layout.shape[..]), (&[2, 20, 16, 24][..], &[2, 6, 16, 24][..]));
    let (color, depth) = (npz::read::<u8>(&path, "color").data, npz::read::<f32>(&path, "depth").data);
    let boxes = npz::read::<u8>(&path, "boxes").data;
    let encoder = TensorEncoder::new(bins(BinScale::Log, 60.0), DepthEmbedding::Both);
    let expected: Vec<tensor::ModelTensor> = (0..2)
        .map(|camera| {
            let pixels = camera * 384..(camera + 1) * 384;
            let rgb = |map: &[u8]| Some(map.as_chunks::<3>().0[pixels.clone()].to_vec());
            let (color, boxes, depth_m) = (rgb(&color), rgb(&boxes), Some(depth[pixels.clone()].to_vec()));
            encoder.encode(&CameraConditions { color, boxes, depth_m, ..Default::default() }).unwrap()
        })
        .collect();
    let all = |part: fn(&tensor::ModelTensor) -> &[f32]| expected.iter().flat_map(part).copied().collect();
    assert_eq!((points.data, layout.data), (all(|t| &t.points), all(|t| &t.layout)));
    assert!(depth.contains(&-300.0) && depth.iter().any(|d| *d > 0.0) && boxes.iter().any(|l| *l > 0));

    log.succeed(&format!("{RENDER}/st --frames 1..2 --out-size 16x24 --format safetensors {maps}"));
    let bytes = std::fs::read(log.path("out/st/000001/conditions.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(file.names().len(), 6);
    for (name, numbers) in [("points", all(|t| &t.points)), ("layout", all(|t| &t.layout)), ("depth", depth)]
    {
        let found = file.tensor(name).unwrap();
        let expected: Vec<u8> = numbers.iter().flat_map(|n: &f32| n.to_le_bytes()).collect();
        assert_eq!((found.dtype(), found.data()), (Dtype::F32, &expected[..]), "{name}");
    }
    assert_eq!(file.tensor("color").unwrap().data(), color);
    let texts = SafeTensors::read_metadata(&bytes).unwrap().1.metadata().clone().unwrap();
    assert_eq!(texts["cameras"], json!(CAMERAS).to_string());
    assert_eq!(texts["t_us"], (FIRST_US + 500_000).to_string());
    assert_eq!(texts["depth_embedding"], "both");
    assert_eq!(log.json("out/st/index.json")["options"]["depth_embedding"], "both");
}

#[test]
fn requesting_only_the_tensor_gives_the_same_tensor() {
    let log = built();
    let args = "--frames 0..1 --out-size 16x24 --format safetensors";
    log.succeed(&format!("{RENDER}/all --maps color,depth,boxes,tensor {args}"));
    log.succeed(&format!("{RENDER}/alone --maps tensor {args}"));
    let read =
        |name: &str| std::fs::read(log.path(&format!("out/{name}/000000/conditions.safetensors"))).unwrap();
    let (all, alone) = (read("all"), read("alone"));
    let [all, alone] = [&all, &alone].map(|bytes| SafeTensors::deserialize(bytes).unwrap());
    let mut names = alone.names();
    names.sort_unstable();
    assert_eq!(names, ["layout", "points"]);
    for name in names {
        assert_eq!(all.tensor(name).unwrap(), alone.tensor(name).unwrap());
    }
    // By default depth is one channel, and sines and cosines are 0.
    let points = alone.tensor("points").unwrap();
    let values: Vec<f32> = points.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert!(values.chunks_exact(20 * 384).all(|camera| camera[4 * 384..].iter().all(|v| *v == 0.0)));
    assert!(values[3 * 384..4 * 384].contains(&-1.0) && values[3 * 384..4 * 384].iter().any(|u| *u > 0.0));
    assert!(
        log.path("out/alone/000000/sheet.png").is_file() && log.path("out/alone/000000/meta.json").is_file()
    );
}

#[test]
fn rejects_tensors_as_images_or_with_several_sizes() {
    let log = built();
    for format in ["png", "exr"] {
        let args = format!("{RENDER} --maps color,tensor --format {format}");
        log.fail(&args, 2, &["npz or safetensors", "--maps tensor", &format!("found {format}")]);
    }
    log.fail(&format!("{RENDER} --maps tensor --depth-embedding sine"), 2, &["continuous, discrete, both"]);
    let camera = |name: &str, width: u32| {
        let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
        let intrinsics = [[20, 0, 10], [0, 20, 10], [0, 0, 1]];
        json!({"name": name, "width": width, "height": 20, "intrinsics": intrinsics,
        "camera_from_world": pose})
    };
    let cameras = json!({"cameras": [camera("a", 20), camera("b", 24)]});
    std::fs::write(log.path("c.json"), cameras.to_string()).unwrap();
    for format in ["npz", "safetensors"] {
        let args = format!("{RENDER} --maps tensor --cameras c.json --format {format} --frames 0..1");
        log.fail(&args, 1, &["a at 20x20 and b at 20x24", "--out-size", format]);
    }
}
