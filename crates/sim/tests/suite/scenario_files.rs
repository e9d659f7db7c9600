//! Rollouts whose scenarios name point files: a resumed one refuses changed files.

use std::path::Path;

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::conditions::{ConditionOptions, MapFormat};
use point_skeleton::dataset::ActorEdits;
use point_skeleton::error::FileError;
use point_skeleton::files::Inputs;
use point_skeleton::raster::RasterizerKind;
use point_skeleton::skeleton::{BuildOptions, BuildReport, Skeleton, SkeletonWriter};
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_sim::rollout::{
    InputPaths, ResumeAfter, Rollout, RolloutError, RolloutInputs, RolloutOptions, check_finished,
};
use pskel_sim::{Rates, Scenario, SimOptions};
use pskel_testing::tiny_log::tree;
use pskel_testing::winding_road;
use serde_json::json;

use crate::scenario::Reader;

/// Writes a skeleton without points.
fn empty_skeleton(path: &Path) -> Skeleton {
    let nothing = |writer: &mut SkeletonWriter| {
        writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
    };
    SkeletonWriter::write::<FileError>(path, nothing).unwrap();
    Skeleton::open(path).unwrap()
}

/// Files of a rollout, and what it is resumed with.
struct Files<'a> {
    log: &'a Log,
    skeleton: &'a Skeleton,
    out: &'a Path,
}

impl Files<'_> {
    /// Simulates up to a number of steps, after those that are there.
    fn run(&self, steps: usize, resume: Option<ResumeAfter>) -> Result<(), RolloutError> {
        let scenario = Scenario { log: self.log.recording(), map: None, rates: Rates::default() };
        self.with_inputs(&scenario, |inputs| {
            let simulation = SimOptions { steps, ..SimOptions::default() };
            let conditions =
                ConditionOptions { maps: "depth".parse().unwrap(), ..ConditionOptions::default() };
            let format = MapFormat::Npz;
            let options = RolloutOptions { simulation, conditions, format, ..RolloutOptions::default() };
            let read = Inputs::default();
            let rollout = Rollout::open(inputs, options, Some((self.out, &read)), resume)?;
            let rasterizer = RasterizerKind::Cpu.into();
            let render = RenderOptions { rasterizer, ..RenderOptions::default() };
            let mut renderer = Renderer::new(self.skeleton, render).unwrap();
            let report = rollout.run(&mut renderer, None, &mut |_| {})?;
            assert_eq!((report.rows.len(), report.failure.is_none()), (steps + 1, true));
            Ok(())
        })
    }

    fn check_finished(&self) -> Result<(), RolloutError> {
        let scenario = Scenario { log: self.log.recording(), map: None, rates: Rates::default() };
        self.with_inputs(&scenario, |inputs| check_finished(self.out, &inputs))
    }

    fn with_inputs<T>(&self, scenario: &Scenario<'_>, work: impl FnOnce(RolloutInputs<'_>) -> T) -> T {
        let paths = InputPaths { log: Path::new("log"), skeleton: Path::new("skeleton"), prompt: None };
        let prompt = PromptParts::default();
        work(RolloutInputs { scenario, skeleton: self.skeleton, prompt: &prompt, paths })
    }
}

#[test]
fn changed_files_of_points_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (points, other, out) = (at("car.ply"), at("other"), at("out"));
    std::fs::write(&points, "points").unwrap();
    empty_skeleton(&other);
    let looks = json!({"lead": {"file": points}, "parked": {"skeleton": other, "track": "a"}});
    let edits: ActorEdits = serde_json::from_value(json!({"replace": looks})).unwrap();
    let log = Log::new(Box::new(Reader(winding_road::log(2)))).edited(&edits).unwrap();
    let skeleton = empty_skeleton(&at("skeleton"));
    let files = Files { log: &log, skeleton: &skeleton, out: &out };
    files.run(2, None).unwrap();
    files.check_finished().unwrap();
    files.run(4, Some(ResumeAfter::Last)).unwrap();
    let before = tree(&out);
    std::fs::write(&points, "Points").unwrap();
    for refused in [files.run(6, Some(ResumeAfter::Last)), files.check_finished()] {
        let message = refused.unwrap_err().to_string();
        assert!(message.starts_with("expected the points of lead in "), "{message}");
        assert!(message.contains("use another folder") && message.ends_with("car.ply"), "{message}");
    }
    assert_eq!(tree(&out), before);
    std::fs::write(&points, "points").unwrap();
    files.run(6, Some(ResumeAfter::Last)).unwrap();
    // Of a skeleton, its manifest counts.
    let more = BuildReport::default();
    let options = BuildOptions { color_window: 7, ..BuildOptions::default() };
    SkeletonWriter::write::<FileError>(&other, |writer| writer.finish(Vec::new(), options, more)).unwrap();
    let message = files.check_finished().unwrap_err().to_string();
    assert!(message.starts_with("expected the points of parked in "), "{message}");
    std::fs::remove_file(&points).unwrap();
    let message = files.run(8, Some(ResumeAfter::Last)).unwrap_err().to_string();
    assert!(message.contains("car.ply"), "{message}");
}
