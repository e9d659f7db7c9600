//! Frames of a real log: the rasterizers of a device compared with the CPU rasterizer.

use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{LogLocator, LogReader};
use point_skeleton::geometry::{ImageSize, View};
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    Crop, FrameJob, FrameMaps, MapSet, Occlusion, Rasterizer, SplatSchedule, rgb_of,
};
use point_skeleton::scene::{EgoOffset, SceneClouds, SelectionOptions, Substitutes, state_of_frame};
use point_skeleton::skeleton::BuildOptions;

use pskel_testing::devices::{Division, rasterizers, with_device};
use pskel_testing::shared::{shared, skeleton_of};

/// Compares every pixel of every map of two frames.
fn differing(a: &FrameMaps<'_>, b: &FrameMaps<'_>) -> [usize; 2] {
    let (mut pixels, mut count) = (0, 0);
    for (a, b) in a.iter().zip(b) {
        pixels += a.point.len();
        let same = |i: &usize| {
            let maps = |m: &point_skeleton::raster::ViewMaps<'_>| {
                (m.point[*i], m.depth_m[*i].to_bits(), m.rgb_class[*i], m.instance[*i])
            };
            maps(a) == maps(b)
        };
        count += (0..a.point.len()).filter(|i| !same(i)).count();
    }
    [count, pixels]
}

#[test]
fn all_rasterizers_draw_a_real_frame_alike() {
    let Some(folder) = shared("the PandaSet drive") else { return };
    let path = folder.join("data/pandaset-002/nuscenes");
    let locator = LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, path);
    let drive = NuScenes::open(&locator).unwrap();
    let scratch = tempfile::tempdir().unwrap();
    let skeleton = skeleton_of(&scratch.path().join("s"), &drive, &[3, 4, 5], &BuildOptions::default());
    let state = state_of_frame(drive.recording(), 4, EgoOffset::default()).unwrap();
    let stage = SceneClouds::with(&skeleton, &drive.recording().name, Substitutes::built_in());
    let instances = stage.instances(&state, &SelectionOptions::default());
    assert_ne!(instances.color, instances.geometry, "templates replace some actors");
    let clouds = stage.cloud_set();
    let views: Vec<View> = state.cameras.iter().map(|camera| camera.view.clone()).collect();
    let schedule = SplatSchedule::default();
    let center = state.global_from_ego.translation.truncate();
    let full = FrameJob {
        views: &views,
        schedule: &schedule,
        color: &instances.color,
        geometry: &instances.geometry,
        occlusion: Occlusion::Scene,
        crop: Some(Crop { center, radius_m: 60.0 }),
        maps: MapSet::SPLATTED,
        out_size: None,
    };
    let reduced = FrameJob {
        occlusion: Occlusion::Actors,
        out_size: Some(ImageSize { height: 256, width: 448 }),
        ..full
    };
    let mut cpu = ReferenceRasterizer::new(clouds.clone());
    with_device(|device| {
        let mut all = rasterizers(&device, &clouds, Division::default());
        for job in [full, reduced] {
            cpu.begin(&job).unwrap();
            let expected = cpu.finish().unwrap();
            let filled = expected.iter().flat_map(|view| view.point.iter()).filter(|p| **p > 0).count();
            let colored = expected[0].rgb_class.iter().any(|p| rgb_of(*p) != [0; 3]);
            assert!(expected.len() == 6 && filled > 30_000 && colored, "{filled}");
            for rasterizer in &mut all {
                rasterizer.begin(&job).unwrap();
                let [count, pixels] = differing(&expected, &rasterizer.finish().unwrap());
                let name = rasterizer.info().rasterizer;
                assert_eq!(count, 0, "{name}: {count} of {pixels} differ");
            }
        }
    });
}
