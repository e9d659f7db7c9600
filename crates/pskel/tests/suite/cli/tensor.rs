//! Model tensors compared with NumPy and with the reference's bins, and as written by `pskel render`.

use point_skeleton::conditions::{
    BinScale, CameraConditions, DepthBins, DepthEmbedding, TensorEncoder, tensor,
};
use safetensors::{Dtype, SafeTensors};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FIRST_US, TinyLog};
use pskel_testing::npz;

const RENDER: &str = "render nuscenes:log --skeleton sk --out out";

fn bins(scale: BinScale, far_m: f32) -> DepthBins {
    DepthBins { scale, far_m, ..DepthBins::default() }
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
