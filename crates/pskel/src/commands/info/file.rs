use std::path::Path;

use glam::Vec3;
use point_skeleton::cloud::{self, Bounds, Point};
use point_skeleton::dataset::{Sweep, av2, nuplan, nuscenes, picture_size};
use serde_json::{Value, json};

/// Describes a single file as JSON.
pub(super) fn describe(path: &Path) -> anyhow::Result<Value> {
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let mut json = match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "npy" | "ply" => cloud_file(path)?,
        "bin" => sweep(&nuscenes::read_sweep_file(path)?),
        "feather" => sweep(&av2::read_sweep_file(path)?),
        "pcd" => sweep(&nuplan::read_pcd_file(path)?),
        "json" => camera_file(path)?,
        "jpg" | "jpeg" | "png" => {
            let (height, width) = picture_size(path)?;
            json!({"kind": "image", "size": format!("{height}x{width}")})
        }
        _ => anyhow::bail!(
            "expected a file ending in .npy, .ply, .pcd.bin, .pcd, .feather, .json, .jpg or .png, found \
                {name:?}: {}",
            path.display()
        ),
    };
    json["path"] = json!(path);
    Ok(json)
}

fn cloud_file(path: &Path) -> anyhow::Result<Value> {
    let cloud = cloud::read(path)?;
    let bounds = Bounds::of(&cloud.points);
    let at = |corner: [f32; 3]| (Vec3::from(corner).as_dvec3() + cloud.origin).to_array();
    Ok(json!({
        "kind": "points",
        "points": cloud.points.len(),
        "not_finite": cloud.non_finite,
        "min": bounds.map(|b| at(b.min)),
        "max": bounds.map(|b| at(b.max)),
        "classes": classes(&cloud.points),
        "notes": cloud.notes,
    }))
}

/// Counts the points of each class, by class number.
fn classes(points: &[Point]) -> Value {
    let mut counts = std::collections::BTreeMap::<u8, usize>::new();
    points.iter().for_each(|p| *counts.entry(p.class()).or_default() += 1);
    json!(counts)
}

fn sweep(sweep: &Sweep) -> Value {
    let points: Vec<Point> = sweep.points.iter().map(|p| Point::new(p.position, [0; 3], 0)).collect();
    let bounds = Bounds::of(&points);
    let rings = sweep.points.iter().map(|p| usize::from(p.ring) + 1).max();
    json!({
        "kind": "sweep",
        "points": sweep.points.len(),
        "not_finite": sweep.dropped_non_finite,
        "rings": rings,
        "min": bounds.map(|b| b.min),
        "max": bounds.map(|b| b.max),
        "merged_lidars": sweep.devices,
        "notes": sweep.notes,
    })
}

fn camera_file(path: &Path) -> anyhow::Result<Value> {
    let cameras = cloud::cameras::read(path)?;
    let camera = |v: &point_skeleton::geometry::View| {
        let c = &v.camera;
        json!({"name": c.name, "size": format!("{}x{}", c.height, c.width),
        "focal_px": c.intrinsics.x_axis.x})
    };
    Ok(json!({"kind": "cameras", "cameras": cameras.iter().map(camera).collect::<Vec<_>>()}))
}
