//! What the page shows is what the commands write.

use std::path::Path;

use point_skeleton::conditions::write::png;
use point_skeleton::conditions::{ConditionOptions, DepthBins, ImageSize, MapKind, MapSet};
use point_skeleton::{EgoOffset, RenderOptions, Renderer};
use serde_json::json;

use crate::client::{Server, inputs};

const CAMERAS: [&str; 6] =
    ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"];

#[test]
fn a_state_that_is_looked_at_has_the_bytes_of_rendered_files() {
    let server = Server::start();
    let mut client = server.connect();
    assert_eq!(client.hello["protocol"], 1);
    assert_eq!(client.hello["cameras"].as_array().unwrap().len(), 6);
    assert_eq!(client.hello["frames_us"].as_array().unwrap().len(), 6);
    client.send(&json!({"type": "view", "codec": "png", "maps": ["color", "depth", "class"],
        "size": [45, 80], "splat": "8:3,60:1", "radius_m": 60.0}));
    client
        .send(&json!({"type": "look", "frame": 2, "left_m": 1.5, "yaw_deg": -10.0, "camera": {"up_m": 0.5}}));
    let frame = client.frame_with(|header| header["offset"]["left_m"] == 1.5);
    let command = frame.header["command"].as_str().unwrap();
    let expected = "--frames 2..3 --ego-offset left_m=1.5,up_m=0.5,yaw_deg=-10 --maps color,depth,class \
        --size 45x80 --splat 8:3,60:1 --radius 60 --out out/maps";
    assert!(command.starts_with("pskel render nuscenes:") && command.ends_with(expected), "{command}");

    let scratch = tempfile::tempdir().unwrap();
    let inputs = inputs(scratch.path(), None);
    let conditions = ConditionOptions {
        maps: MapSet::of(&[MapKind::Color, MapKind::Depth, MapKind::Class]),
        splat: "8:3,60:1".parse().unwrap(),
        size: Some(ImageSize { height: 45, width: 80 }),
        radius_m: 60.0,
        depth_bins: DepthBins { far_m: 60.0, ..DepthBins::default() },
        ..ConditionOptions::default()
    };
    let bins = conditions.depth_bins;
    let mut renderer =
        Renderer::new(&inputs.skeleton, RenderOptions { conditions, ..RenderOptions::default() }).unwrap();
    let offset = EgoOffset { left_m: 1.5, up_m: 0.5, yaw_deg: -10.0, ..EgoOffset::default() };
    let maps = renderer.render(&inputs.log.frame_moved(2, offset).unwrap()).unwrap();
    let mut filled = 0;
    for camera in &maps.set.cameras {
        for kind in [MapKind::Color, MapKind::Depth, MapKind::Class] {
            let expected = png::encode_map(Path::new("x"), camera, kind, &bins).unwrap().unwrap();
            assert!(frame.image(&camera.name, kind.name()) == Some(&expected[..]), "{} {kind}", camera.name);
        }
        filled += camera.color.as_ref().unwrap().iter().filter(|rgb| **rgb != [0; 3]).count();
    }
    assert!(filled > 1000, "{filled} filled pixels");

    // The same state at the size of the cameras.
    let (status, bytes) =
        server.get(&format!("/picture?camera=CAM_BACK&map=color&token={}", server.token), "");
    let image = image::load_from_memory(&bytes).unwrap();
    assert_eq!((status, image.height(), image.width()), (200, 90, 160));
    let (status, text) = server.get(&format!("/picture?camera=X&map=color&token={}", server.token), "");
    assert_eq!((status, String::from_utf8(text).unwrap().contains("expected a camera of CAM_")), (400, true));
}

#[test]
fn recorded_images_and_answers_to_clicks() {
    let server = Server::start();
    let mut client = server.connect();
    client.send(&json!({"type": "view", "maps": ["color", "recorded"]}));
    let frame = client.frame_with(|header| !header["psnr_db"].as_array().unwrap().is_empty());
    for camera in CAMERAS {
        for map in ["color", "recorded"] {
            let image = image::load_from_memory(frame.image(camera, map).unwrap()).unwrap();
            assert_eq!((image.height(), image.width()), (256, 448), "{camera} {map}");
        }
    }
    let psnr = frame.header["psnr_db"].as_array().unwrap();
    assert!(psnr.iter().all(|pair| pair[1].as_f64().unwrap() > 5.0), "{psnr:?}");
    let birdseye = image::load_from_memory(frame.image("", "birdseye").unwrap()).unwrap();
    assert_eq!(birdseye.height(), 480);

    // The car ahead is in the middle of the front camera, 12 m from the ego's origin to its center.
    client.send(&json!({"type": "pick", "camera": "CAM_FRONT", "x": 224, "y": 140}));
    let picked = client.text("picked");
    assert_eq!(picked["actor"]["track"], "ahead", "{picked}");
    let depth_m = picked["depth_m"].as_f64().unwrap();
    assert!((9.0..13.0).contains(&depth_m), "{picked}");
    let x = picked["point"][0].as_f64().unwrap();
    assert!((x - 1000.0 - depth_m).abs() < 0.5, "{picked}");
    client.send(&json!({"type": "view", "hide": ["ahead"]}));
    client.text("view");
    client.send(&json!({"type": "pick", "camera": "CAM_FRONT", "x": 224, "y": 140}));
    assert_ne!(client.text("picked")["actor"]["track"], "ahead");
    for wrong in [
        json!({"type": "pick", "camera": "CAM_FRONT", "x": 448, "y": 0}),
        json!({"type": "view", "splat": "1"}),
        json!({"type": "look", "frame": 6}),
        json!({"type": "step"}),
        json!({"type": "control", "by": "nobody"}),
        json!({"type": "save"}),
        json!({"type": "save", "name": "../x"}),
        json!({"type": "play", "speed": 1e9}),
    ] {
        client.send(&wrong);
        if wrong["type"] != "step" {
            let notice = client.text("notice");
            assert_eq!(notice["level"], "error", "{wrong}: {notice}");
        }
    }
}
