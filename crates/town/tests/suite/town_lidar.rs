//! Sweeps of a skeleton of the town. Their accuracy is measured by `pskel fidelity --lidar`, and its bounds
//! are in the tests of `pskel-eval`.

use std::collections::HashSet;

use glam::DVec3;
use point_skeleton::dataset::{EgoTrack, LogReader};
use point_skeleton::lidar::{LidarSpec, LidarSweep, Motion};
use point_skeleton::raster::RasterizerKind;
use point_skeleton::scene::{EgoOffset, SceneClouds, Substitutes, state_at};
use point_skeleton::skeleton::BuildOptions;
use point_skeleton::{RenderOptions, Renderer};
use pskel_testing::devices::{Division, rasterizers, with_device};
use pskel_testing::shared::{WithLog, skeleton_of};
use pskel_testing::synthetic_town::other_town;

/// The same bytes on all rasterizers and with any number of threads.
#[test]
fn sweeps_do_not_depend_on_rasterizers_and_threads() {
    let town = other_town("seed=7,frames=8,size=90x160");
    let frames: Vec<usize> = (0..town.recording().frames.len()).collect();
    let folder = tempfile::tempdir().unwrap();
    let gray = WithLog::grey(&town, &frames);
    let skeleton = skeleton_of(&folder.path().join("s"), &gray, &frames, &BuildOptions::default());
    let (track, offset) =
        (EgoTrack::new(town.recording()), EgoOffset { left_m: 2.0, ..EgoOffset::default() });
    let t_us = town.recording().frames[4].t_us;
    let [now, before] =
        [t_us, t_us - 100_000].map(|t_us| state_at(town.recording(), &track, t_us, offset).unwrap());
    let mut spec = LidarSpec::named("av2").unwrap().mounted_at(DVec3::new(0.94, 0.0, 1.84));
    spec.devices.iter_mut().for_each(|device| device.columns = 120);
    let motion = Motion::new(&now, Some(&before));
    let render = |mut renderer: Renderer<'_>| renderer.lidar(&spec, &motion).unwrap();
    let cpu = || {
        let options = RenderOptions { rasterizer: RasterizerKind::Cpu.into(), ..RenderOptions::default() };
        render(Renderer::new(&skeleton, options).unwrap())
    };
    let with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(cpu);
    let expected: LidarSweep = with(1);
    assert!(expected.count() > 5000 && expected == with(3), "{}", expected.count());
    let actors: HashSet<u32> = expected.returns().map(|r| r.instance).collect();
    assert!(actors.len() > 2 && actors.iter().all(|actor| *actor as usize <= now.actors.len()));
    with_device(|device| {
        let clouds = || SceneClouds::with(&skeleton, &town.recording().name, Substitutes::built_in());
        for rasterizer in rasterizers(&device, &clouds().cloud_set(), Division::default()) {
            let name = rasterizer.info().rasterizer;
            let renderer = Renderer::with_rasterizer(clouds(), rasterizer, Default::default());
            assert!(render(renderer) == expected, "{name}");
        }
    });
}
