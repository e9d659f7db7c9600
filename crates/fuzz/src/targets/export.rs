//! Exports that are continued: their options, and the records of their shards.

use std::cell::RefCell;
use std::path::Path;

use point_skeleton::Log;
use point_skeleton::conditions::ConditionOptions;
use point_skeleton::dataset::{LogLocator, LogOutline};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{MapKind, MapSet, RasterizerDesc, RasterizerKind};
use point_skeleton::scene::{SelectionOptions, SubstituteOptions};
use pskel_export::{
    Export, ExportError, ExportOptions, ExportReport, Layout, SampleFormat, SampleTimes, WorkList, export,
};
use serde_json::Value;

use super::{LARGE, edit_seeds, seed};
use crate::check::{assert_names_file_in, short};
use crate::edits::json_file;
use crate::folder::Folder;
use crate::synthetic_log::SyntheticLog;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 1] =
    [Target { name: "export", run: run_resumed, seeds, max_len: 4096, memory: LARGE }];

const FRAMES: usize = 2;
/// A file beside the export, which records must not reach.
const BESIDE: &str = "beside.txt";
/// Files that are edited.
const EDITED: [&str; 4] =
    ["out/shards/made-000000.json", "out/shards/made-000001.json", "out/export.json", "out/index.json"];

/// A complete export.
struct Complete {
    folder: Folder,
    list: WorkList,
}

thread_local! {
    static COMPLETE: RefCell<Complete> = RefCell::new(Complete::new());
}

fn options() -> ExportOptions {
    let maps = MapSet::of(&[MapKind::Color, MapKind::Depth]);
    let out_size = Some(ImageSize { height: 8, width: 12 });
    ExportOptions {
        layout: Layout::Frames,
        conditions: ConditionOptions { maps, out_size, ..ConditionOptions::default() },
        selection: SelectionOptions::default(),
        substitutes: SubstituteOptions { use_default: false, ..SubstituteOptions::default() },
        format: SampleFormat::Png,
        frames: None,
        shard_frames: 1,
        images: false,
        times: SampleTimes::KeyFrames,
        color_folder: "color".into(),
        validation_logs: Default::default(),
        prompt: Default::default(),
        captions: Default::default(),
    }
}

fn run(root: &Path, list: &WorkList, verify: bool) -> Result<ExportReport, ExportError> {
    export(Export {
        list: Some(list),
        part: list,
        out: &root.join("out"),
        skeletons: &root.join("skeletons"),
        options: &options(),
        open: &|_| Ok(Log::new(Box::new(SyntheticLog::new(FRAMES)))),
        rasterizer: &RasterizerDesc::from(RasterizerKind::Cpu),
        jobs: 1,
        verify,
        progress: &(),
    })
}

impl Complete {
    fn new() -> Self {
        let log = LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, "made");
        let outline = LogOutline { name: "made".into(), frames: FRAMES };
        let list = WorkList::new([(log, outline)], 1, None).expect("a list");
        let folder = tempfile::tempdir().expect("a temporary folder");
        let report = run(folder.path(), &list, false).expect("an export");
        assert!(report.complete && report.written == FRAMES, "{:?}", report.failures);
        std::fs::write(folder.path().join(BESIDE), "kept").expect("a file of ours");
        Self { folder: Folder::copy_of(folder.path()), list }
    }
}

/// Edits the file that the first byte selects, then continues the export; an odd second byte compares
/// checksums.
fn run_resumed(data: &[u8]) {
    COMPLETE.with_borrow_mut(|Complete { folder, list }| {
        let (head, edits) = data.split_at(data.len().min(2));
        let [number, verify] = [head.first(), head.get(1)].map(|byte| byte.copied().unwrap_or(1));
        let name = EDITED[usize::from(number) % EDITED.len()];
        let base: Value = serde_json::from_slice(folder.base(name)).expect("JSON");
        folder.rewrite();
        folder.put(name, &json_file(edits, &base));
        match run(folder.root(), list, verify % 2 == 1) {
            Err(error) => assert_names_file_in(error, folder.root(), data),
            Ok(report) => {
                report.failures.iter().for_each(|failure| short(&failure.error, data));
                // Finished shards have the bytes of an export that was not interrupted.
                if verify % 2 == 1 && report.failures.is_empty() {
                    assert!(report.complete);
                    let whole = |name: &&String| name.starts_with("out/made/");
                    for name in folder.names().iter().filter(whole) {
                        let bytes = std::fs::read(folder.path(name)).expect("a file of a shard");
                        assert!(bytes == folder.base(name), "{name} has changed");
                    }
                }
            }
        }
        assert_eq!(std::fs::read(folder.path(BESIDE)).expect("a file of ours"), b"kept");
    });
}

fn seeds() -> Vec<Seed> {
    let mut seeds = Vec::new();
    for (number, name) in [(0, "record"), (2, "options")] {
        for (kind, edits) in edit_seeds() {
            let verify = u8::from(kind.len().is_multiple_of(2));
            seeds.push(seed(&format!("{name}-{kind}"), [&[number, verify, 0], &edits[..]].concat()));
        }
    }
    let record = |text: &str| [&[1, 1], text.as_bytes()].concat();
    seeds.push(seed("cut", record("{\"name\": ")));
    seeds.push(seed(
        "outside",
        record(
            r#"{"name":"made-000001","log":"made","input":{"log":"","skeleton":null},"frames":[1,2],
             "samples":1,"notes":{},"files":[{"path":"../beside.txt","bytes":4,"sha256":""}]}"#,
        ),
    ));
    seeds
}
