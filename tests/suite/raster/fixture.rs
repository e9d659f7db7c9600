//! Comparison with the reference implementation's maps of real points.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use glam::{DAffine3, DMat4};
use point_skeleton::cloud::Point;
use point_skeleton::geometry::{Camera, View};
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{CloudSet, Instance, MapSet, Rasterizer, SplatJob, SplatMaps, SplatSchedule};

use pskel_testing::devices::{Division, assert_same, rasterizers, with_device};
use pskel_testing::shared::fixtures;

/// Pixels at the border where the reference truncates toward zero.
const BORDER: u32 = 3;

struct Projection {
    points: Vec<Point>,
    /// The two views with complete reference maps, and those maps.
    views: Vec<View>,
    depth_m: Vec<f32>,
    color: Vec<u8>,
    class_scene: Vec<u8>,
    class_actors: Vec<u8>,
}

/// Reads an array of an archive.
fn npz<T: npyz::Deserialize>(archive: &Path, name: &str) -> Vec<T> {
    let mut archive = zip::ZipArchive::new(File::open(archive).unwrap()).unwrap();
    let mut bytes = Vec::new();
    archive.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
    npyz::NpyFile::new(&bytes[..]).unwrap().into_vec().unwrap()
}

fn points(path: &Path) -> Vec<Point> {
    let file = npyz::NpyFile::new(std::io::BufReader::new(File::open(path).unwrap())).unwrap();
    assert_eq!(file.shape()[1], 7);
    let values: Vec<f32> = file.into_vec().unwrap();
    let point = |row: &[f32]| {
        let [r, g, b, class] = [row[3], row[4], row[5], row[6]].map(|v| v as u8);
        Point::new([row[0], row[1], row[2]], [r, g, b], class)
    };
    values.chunks_exact(7).map(point).collect()
}

fn views(path: &Path) -> Vec<View> {
    let json: serde_json::Value = serde_json::from_reader(File::open(path).unwrap()).unwrap();
    let view = |value: &serde_json::Value| {
        let size = |name: &str| value[name].as_u64().unwrap() as u32;
        let rows: [[f64; 3]; 3] = serde_json::from_value(value["intrinsics"].clone()).unwrap();
        let pose: [[f64; 4]; 4] = serde_json::from_value(value["camera_from_world"].clone()).unwrap();
        let camera =
            Camera::new(value["name"].as_str().unwrap(), size("width"), size("height"), rows).unwrap();
        let camera_from_world = DAffine3::from_mat4(DMat4::from_cols_array_2d(&pose).transpose());
        View { camera, camera_from_world }
    };
    json["cameras"].as_array().unwrap().iter().map(view).collect()
}

fn load() -> Option<Projection> {
    let folder = fixtures("projection-pandaset")?.join("projection-pandaset");
    let all = views(&folder.join("cameras.json"));
    let full = folder.join("full.npz");
    let chosen: Vec<i64> = npz(&full, "cameras");
    Some(Projection {
        points: points(&folder.join("points.npy")),
        views: chosen.iter().map(|i| all[*i as usize].clone()).collect(),
        depth_m: npz(&full, "depth"),
        color: npz(&full, "color"),
        class_scene: npz(&full, "class_scene"),
        class_actors: npz(&full, "class_actors"),
    })
}

/// Returns the share of pixels, except at the border, for which `differs` is true.
fn share(view: &View, differs: impl Fn(usize) -> bool) -> f64 {
    let (width, height) = (view.camera.width, view.camera.height);
    let rows = BORDER..height - BORDER;
    let pixels = rows.flat_map(|y| (BORDER..width - BORDER).map(move |x| (y * width + x) as usize));
    let count = pixels.filter(|i| differs(*i)).count();
    count as f64 / f64::from((width - 2 * BORDER) * (height - 2 * BORDER))
}

fn class(maps: &SplatMaps, pixel: usize) -> u8 {
    maps.rgb_class[pixel].to_le_bytes()[3]
}

/// Compares one view's maps of all points and of the actors' points with the fixture.
fn check(fixture: &Projection, index: usize, scene: &SplatMaps, actors: &SplatMaps) {
    const PARITY: f64 = 1e-4;
    let view = &fixture.views[index];
    let first = index * scene.point.len();
    let depth = share(view, |i| {
        let expected = fixture.depth_m[first + i];
        let found = if scene.depth_m[i].is_finite() { scene.depth_m[i] } else { -300.0 };
        (found - expected).abs() > 2e-3
    });
    let color = share(view, |i| {
        let expected = &fixture.color[3 * (first + i)..][..3];
        scene.rgb_class[i].to_le_bytes()[..3] != *expected
    });
    let in_scene = share(view, |i| class(scene, i) != fixture.class_scene[first + i]);
    let of_actors = share(view, |i| class(actors, i) != fixture.class_actors[first + i]);
    println!("view {index}: depth {depth:.1e} color {color:.1e} class {in_scene:.1e} {of_actors:.1e}");
    for (what, share) in [("depth", depth), ("color", color), ("class", in_scene), ("actors", of_actors)] {
        assert!(share <= PARITY, "view {index}: {what} differs on {share} of the pixels");
    }
}

/// Returns the maps of each view with all points (cloud 0) and with only the actors' points (cloud 1).
fn draw(fixture: &Projection, rasterizer: &mut dyn Rasterizer) -> Vec<[SplatMaps; 2]> {
    let schedule = SplatSchedule::default();
    let mut draw = |view: &View, cloud: usize| {
        let instances = [Instance { cloud, world_from_local: DAffine3::IDENTITY, number: 0 }];
        let maps = MapSet::SPLATTED;
        let job = SplatJob { view, schedule: &schedule, instances: &instances, crop: None, maps };
        rasterizer.splat(&job).unwrap()
    };
    fixture.views.iter().map(|view| [draw(view, 0), draw(view, 1)]).collect()
}

#[test]
fn fixture_maps_equal_the_references() {
    let Some(fixture) = load() else { return };
    let actors: Vec<Point> = fixture.points.iter().filter(|p| p.class() > 0).copied().collect();
    let clouds: CloudSet<'_> = vec![(&fixture.points).into(), (&actors).into()];
    let cpu = draw(&fixture, &mut ReferenceRasterizer::new(clouds.clone()));
    with_device(|device| {
        for mut rasterizer in rasterizers(&device, &clouds, Division::default()) {
            let maps = draw(&fixture, rasterizer.as_mut());
            println!("{} {:?}", rasterizer.info().rasterizer, rasterizer.take_stages().0);
            for (a, b) in cpu.iter().flatten().zip(maps.iter().flatten()) {
                assert_same(a, b, rasterizer.info().rasterizer);
            }
        }
    });
    for (index, [scene, actors]) in cpu.iter().enumerate() {
        check(&fixture, index, scene, actors);
    }
}

/// The check must be able to fail: another schedule gives other maps than the reference.
#[test]
fn fixture_check_sees_a_wrong_radius() {
    let Some(fixture) = load() else { return };
    let view = &fixture.views[0];
    let (schedule, maps): (SplatSchedule, _) = ("15:1,35:1,100:0".parse().unwrap(), MapSet::SPLATTED);
    let instances = [Instance { cloud: 0, world_from_local: DAffine3::IDENTITY, number: 0 }];
    let job = SplatJob { view, schedule: &schedule, instances: &instances, crop: None, maps };
    let maps = ReferenceRasterizer::new(vec![(&fixture.points).into()]).splat(&job).unwrap();
    assert!(std::panic::catch_unwind(|| check(&fixture, 0, &maps, &maps)).is_err());
}
