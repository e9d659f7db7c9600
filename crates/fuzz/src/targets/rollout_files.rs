//! Files of rollouts with generated images: resumed with an MCAP file, scored by protocols, copied into a
//! data set.

use std::cell::RefCell;
use std::path::Path;

use image::{Rgb, RgbImage};
use point_skeleton::conditions::ConditionOptions;
use point_skeleton::dataset::{LogLocator, LogReader, nuscenes};
use point_skeleton::files::{Inputs, OutputFile};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{MapKind, MapSet, RasterizerDesc, RasterizerKind};
use point_skeleton::scene::SceneState;
use point_skeleton::skeleton::Skeleton;
use point_skeleton::{RenderOptions, Renderer};
use pskel_eval::protocol::{Method, PartRollouts, Protocol, ProtocolReport, ScoreOptions, check_settings};
use pskel_eval::{MaskRule, MetricNetworks, NetworkPaths};
use pskel_generate::{CopiedLog, DatasetCopy};
use pskel_sim::report::images::StepImages;
use pskel_sim::rollout::{
    AnyError, GenerationTimes, ImageGenerator, InputPaths, MCAP, ResumeAfter, Rollout, RolloutError,
    RolloutInputs, RolloutOptions,
};
use pskel_sim::{Committed, Forecast, Rates, Scenario, SimOptions};
use serde_json::{Value, json};

use super::{LARGE, edit_seeds, seed};
use crate::check::{assert_names_file_in, short};
use crate::edits::json_file;
use crate::folder::Folder;
use crate::synthetic_log::{self, SyntheticLog};
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 3] = [
    Target { name: "mcap", run: resume, seeds, max_len: 4096, memory: LARGE },
    Target { name: "protocol", run: score, seeds, max_len: 4096, memory: LARGE },
    Target { name: "dataset_copy", run: copy, seeds, max_len: 4096, memory: LARGE },
];

/// Frames of the log.
const FRAMES: usize = 5;
/// Steps of the rollout, at the frames of the log.
const STEPS: usize = 3;
/// Files that are edited.
const EDITED: [&str; 7] = [
    "rollout/rollout.json",
    "rollout/states.jsonl",
    "rollout/metrics.json",
    "rollout/steps/000002/generated.json",
    "rollout/steps/000002/generated/CAM_FRONT.png",
    "rollout/steps/000001/state.json",
    "protocol.json",
];
const FILE: &str = "out.mcap";
const COPY: &str = "copy";

/// Gives every planning step an image of one color.
struct Painter {
    frames: u8,
}

impl ImageGenerator for Painter {
    fn forecasts(&self) -> usize {
        0
    }

    fn generate(
        &mut self,
        _: usize,
        _: Committed<&SceneState>,
        _: &[Forecast<SceneState>],
        _: &mut Renderer<'_>,
    ) -> Result<Option<StepImages>, AnyError> {
        self.frames += 1;
        let image = |level: u8| vec![RgbImage::from_pixel(12, 8, Rgb([level, 40 * self.frames, 90]))];
        Ok(Some(StepImages {
            is_reference: self.frames == 1,
            images: image(60),
            truth: Some(image(50)),
            rows: None,
        }))
    }

    fn add_reference(
        &mut self,
        _: Committed<&SceneState>,
        _: Vec<RgbImage>,
        _: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        Ok(())
    }

    fn times(&self) -> GenerationTimes {
        GenerationTimes::default()
    }

    fn save(&self) -> Result<Option<Vec<u8>>, AnyError> {
        Ok(None)
    }

    fn resume(
        &mut self,
        frames: usize,
        _: &[Committed<SceneState>],
        _: Option<&[u8]>,
        _: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        self.frames = u8::try_from(frames)?;
        Ok(())
    }

    fn window(&self) -> usize {
        2
    }

    fn has_truth(&self) -> bool {
        true
    }
}

/// A finished rollout, its inputs, and the file of a protocol's options.
struct Finished {
    folder: Folder,
    skeleton: Skeleton,
}

thread_local! {
    static FINISHED: RefCell<Finished> = RefCell::new(Finished::new());
}

fn settings() -> Value {
    json!({ "protocol": "nuscenes-val", "generator": { "name": "painter" }, "captions": null })
}

/// Runs the rollout in a folder, or resumes it, and writes the MCAP file.
fn roll(root: &Path, skeleton: &Skeleton, after: Option<ResumeAfter>) -> Result<(), RolloutError> {
    let synthetic = SyntheticLog::with_images_in(FRAMES, &root.join("data"));
    let (log, prompt) = (synthetic.recording(), Default::default());
    let scenario = Scenario { log, map: None, rates: Rates { sim_hz: 10.0, plan_hz: 10.0 } };
    let [log_path, skeleton_path] = [root.join("data"), root.join("skeleton")];
    let paths = InputPaths { log: &log_path, skeleton: &skeleton_path, prompt: None };
    let inputs = RolloutInputs { scenario: &scenario, skeleton, prompt: &prompt, paths };
    let out_size = Some(ImageSize { height: 8, width: 12 });
    let options = RolloutOptions {
        simulation: SimOptions { steps: STEPS, ..SimOptions::default() },
        conditions: ConditionOptions {
            maps: MapSet::of(&[MapKind::Color]),
            out_size,
            ..ConditionOptions::default()
        },
        mcap: Some(OutputFile::open(&root.join(FILE), MCAP, &Inputs::default())?),
        ..RolloutOptions::default()
    };
    let out = root.join("rollout");
    let rasterizer = RasterizerDesc::from(RasterizerKind::Cpu);
    let render = RenderOptions { rasterizer, log: Some(&log.name), ..RenderOptions::default() };
    let mut renderer = Renderer::new(skeleton, render).expect("points of ours");
    let read = Inputs::new([&log_path, &skeleton_path]);
    let rollout = Rollout::open(inputs, options, Some((out.as_path(), &read)), after)?;
    let mut painter = Painter { frames: 0 };
    let report = rollout.run(&mut renderer, Some(&mut painter), &mut |_| ())?;
    report.failure.or(report.summary_failure).map_or(Ok(()), Err)
}

impl Finished {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let root = folder.path();
        std::fs::create_dir_all(root.join("data/samples")).expect("a folder of ours");
        for index in 0..FRAMES {
            let path = root.join(format!("data/samples/{index}.png"));
            RgbImage::new(24, 16).save(path).expect("an image of ours");
        }
        let skeleton = synthetic_log::skeleton(&root.join("skeleton"), &SyntheticLog::new(FRAMES));
        roll(root, &skeleton, None).expect("a rollout");
        std::fs::write(root.join("protocol.json"), settings().to_string()).expect("a file of ours");
        let folder = Folder::copy_of(root);
        let skeleton = Skeleton::open(&folder.path("skeleton")).expect("a skeleton of ours");
        Self { folder, skeleton }
    }

    /// Changes the file that the first byte selects: JSON by edits, or any file as a whole.
    fn change(&mut self, data: &[u8]) {
        self.folder.rewrite();
        let (number, edits) = data.split_first().unwrap_or((&0, &[]));
        let name = EDITED[usize::from(*number) % EDITED.len()];
        // Of several lines, the first one is edited.
        let base = self.folder.base(name);
        let end = base.iter().position(|byte| name.ends_with('l') && *byte == b'\n').unwrap_or(base.len());
        let (edited, rest) = base.split_at(end);
        let bytes = match serde_json::from_slice(edited) {
            Ok(value) => [&json_file(edits, &value), rest].concat(),
            Err(_) => edits.to_vec(),
        };
        self.folder.put(name, &bytes);
    }
}

/// Resumes after a step; the last byte selects which.
fn resume(data: &[u8]) {
    FINISHED.with_borrow_mut(|finished| {
        finished.change(data);
        let root = finished.folder.root();
        let after = match data.last().map_or(0, |byte| byte % 4) {
            3 => ResumeAfter::Last,
            step => ResumeAfter::Step(usize::from(step)),
        };
        match roll(root, &finished.skeleton, Some(after)) {
            Err(error) => short(&error.to_string(), data),
            Ok(()) => {
                let bytes = std::fs::read(root.join(FILE)).expect("a file that was written");
                let times = mcap::MessageStream::new(&bytes).expect("an MCAP file").map(|message| {
                    let message = message.expect("a message");
                    assert!(!message.data.is_empty());
                    message.log_time
                });
                assert!(times.is_sorted(), "times that do not grow");
            }
        }
    });
}

fn score(data: &[u8]) {
    FINISHED.with_borrow_mut(|finished| {
        finished.change(data);
        let root = finished.folder.root();
        if let Err(error) = check_settings(&root.join("protocol.json"), &settings()) {
            assert_names_file_in(error, root, data);
        }
        let part = Protocol::NuscenesVal.parts().remove(1);
        let parts = [PartRollouts { part, folders: vec![root.join("rollout")], frames: STEPS }];
        let logs = ["made".to_owned()];
        let options = ScoreOptions {
            method: Method::default(),
            root,
            networks: MetricNetworks::new(NetworkPaths::default()),
            mask_rule: MaskRule::default(),
            cache: &root.join("metrics"),
        };
        let mut ignore = (|_: usize| (), |_: &str| ());
        match ProtocolReport::score(
            Protocol::NuscenesVal,
            &logs,
            &parts,
            options,
            &mut ignore.0,
            &mut ignore.1,
        ) {
            Err(error) => short(&error.to_string(), data),
            Ok(report) => assert!(report.table().contains("0 of its 150 logs, 1 others")),
        }
    });
}

fn copy(data: &[u8]) {
    FINISHED.with_borrow_mut(|finished| {
        finished.change(data);
        let root = finished.folder.root();
        let synthetic = SyntheticLog::with_images_in(FRAMES, &root.join("data"));
        let logs = [CopiedLog { log: synthetic.recording(), rollout: &root.join("rollout") }];
        let place = root.join(COPY);
        let source = LogLocator::new(&nuscenes::FORMAT, root.join("data"));
        match DatasetCopy::open(&source, &place, None).and_then(|copy| copy.write(&logs)) {
            Err(error) => {
                assert_names_file_in(error, root, data);
                assert!(!place.exists(), "half a copy");
            }
            Ok(counts) => {
                assert!(counts.replaced > 0 && counts.replaced + counts.retained == FRAMES);
                let images = std::fs::read_dir(place.join("samples")).expect("a copy");
                let replaced =
                    images.map(|entry| entry.expect("a copy").path()).filter(|image| !image.is_symlink());
                assert_eq!(replaced.count(), counts.replaced);
                std::fs::remove_dir_all(place).expect("a copy of ours");
            }
        }
    });
}

fn seeds() -> Vec<Seed> {
    let mut seeds = Vec::new();
    for (kind, edits) in edit_seeds() {
        for number in [0_u8, 1, 2, 6] {
            seeds.push(seed(&format!("{number}-{kind}"), [&[number, 0], &edits[..]].concat()));
        }
    }
    seeds.push(seed("kind", b"\x03{\"kind\": \"reference\"}"));
    seeds.push(seed("image", b"\x04no image"));
    seeds.push(seed("state", b"\x05{}"));
    seeds
}
