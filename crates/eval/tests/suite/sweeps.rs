//! LiDAR sweeps of skeletons against true ones.

use glam::DVec3;
use point_skeleton::dataset::LogReader;
use point_skeleton::lidar::LidarSpec;
use point_skeleton::raster::RasterizerKind;
use point_skeleton::skeleton::{BuildOptions, Skeleton};
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_eval::{FidelityFrames, FidelitySource, Rows, SweepRow, sweep_fidelity};
use pskel_testing::shared::{WithLog, shared, skeleton_of};
use pskel_testing::synthetic_town::other_town;

fn rows(
    source: FidelitySource<'_>,
    skeleton: &Skeleton,
    frames: &FidelityFrames,
    spec: &LidarSpec,
) -> Vec<SweepRow> {
    let options = RenderOptions { rasterizer: RasterizerKind::Cpu.into(), ..RenderOptions::default() };
    let mut renderer = Renderer::new(skeleton, options).unwrap();
    let report = sweep_fidelity(source, &mut renderer, frames, spec, &mut |_| ()).unwrap();
    let Rows::Sweeps(rows) = report.rows else { panic!("expected sweeps") };
    rows
}

/// The second row is moved by 2 m and 5 degrees. Rays between few beams' lines are behind the true surface,
/// and so are cars that moved while they were recorded.
#[test]
fn sweeps_agree_with_beams_through_the_town() {
    let town = other_town("seed=11,frames=20,size=90x160");
    let frames: Vec<usize> = (0..town.recording().frames.len()).collect();
    let folder = tempfile::tempdir().unwrap();
    let gray = WithLog::grey(&town, &frames);
    let skeleton = skeleton_of(&folder.path().join("s"), &gray, &frames, &BuildOptions::default());
    let mut spec = LidarSpec::named("hdl-32e").unwrap().mounted_at(DVec3::new(0.94, 0.0, 1.84));
    spec.devices.iter_mut().for_each(|device| device.range_m[1] = 60.0);
    let frames = FidelityFrames { range: 4..17, hold_out: Some(4) };
    let rows = rows(FidelitySource::Town(&town), &skeleton, &frames, &spec);
    for row in &rows {
        assert!(row.median_m.unwrap() <= 0.03 && row.f_score.unwrap() >= 0.9, "{row:?}");
        assert!(row.sweeps == 3 && row.behind.unwrap() <= 0.02, "{row:?}");
    }
}

/// Two LiDARs at 10 Hz, with every other sweep held out. The second one scans at other times than the first,
/// whose timing it gets, and is not quite where its calibration says: its road is higher by centimeters.
#[test]
fn sweeps_agree_with_held_out_ones() {
    let Some(root) = shared("PandaSet").map(|shared| shared.join("data/pandaset-002/nuscenes")) else {
        return;
    };
    let log = Log::open(&format!("nuscenes:{}@v1.0-mini", root.display())).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let used: Vec<usize> = (0..log.recording().frames.len()).step_by(2).collect();
    let gray = WithLog::grey(log.reader(), &used);
    let skeleton = skeleton_of(&folder.path().join("s"), &gray, &used, &BuildOptions::default());
    let lidar = log.recording().frames[0].sweeps[0].ego_from_lidar.translation;
    let spec = LidarSpec::named("pandar64").unwrap().mounted_at(lidar);
    let frames = FidelityFrames { range: 0..12, hold_out: Some(4) };
    let rows = rows(FidelitySource::Log(&log), &skeleton, &frames, &spec);
    assert_eq!(rows.iter().map(|row| &*row.sweep).collect::<Vec<_>>(), ["device 0", "device 1", "all"]);
    for (row, most_m) in rows.iter().zip([0.05, 0.06, 0.05]) {
        let share = row.returns as f64 / row.true_returns as f64;
        assert!(
            row.sweeps == 3 && row.median_m.unwrap() <= most_m && (0.9..=1.1).contains(&share),
            "{row:?}"
        );
    }
}
