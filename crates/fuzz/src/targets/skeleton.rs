//! Skeletons and template libraries: opening and rendering.

use std::cell::RefCell;

use point_skeleton::cloud::paged::PagedWriter;
use point_skeleton::cloud::{Bounds, Cloud, Point};
use point_skeleton::dataset::LogReader;
use point_skeleton::error::FileError;
use point_skeleton::files::{Checksum, Inputs};
use point_skeleton::geometry::View;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{Crop, FrameJob, MapSet, Occlusion, Rasterizer, SplatSchedule};
use point_skeleton::scene::{
    EgoOffset, SceneClouds, SceneState, SelectionOptions, Substitutes, state_of_frame,
};
use point_skeleton::skeleton::{
    AugmentOptions, Skeleton, Template, TemplateKind, TemplateLibrary, TemplateOptions, TemplateReport,
    augment,
};
use serde_json::Value;

use super::{LARGE, SMALL, edit_seeds, seed};
use crate::check::{assert_names_file, assert_names_file_in};
use crate::edits::json_file;
use crate::folder::Folder;
use crate::synthetic_log::{self, SyntheticLog};
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 4] = [
    Target { name: "skeleton", run: manifest, seeds: manifest_seeds, max_len: 8192, memory: LARGE },
    Target { name: "skeleton_points", run: points, seeds: point_seeds, max_len: 4096, memory: LARGE },
    Target { name: "templates", run: library, seeds: library_seeds, max_len: 4096, memory: SMALL },
    Target { name: "template_points", run: library_points, seeds: point_seeds, max_len: 4096, memory: LARGE },
];

const MANIFEST: &str = "skeleton.json";
const LIBRARY: &str = "templates.json";
const TEMPLATE_POINTS: &str = "templates.points";
const LOG: &str = "made";

/// A folder, its manifest, and a step to render.
struct Stored {
    folder: Folder,
    manifest: Value,
    state: SceneState,
}

thread_local! {
    static SKELETON: RefCell<Stored> = RefCell::new(skeleton());
    static TEMPLATES: RefCell<Stored> = RefCell::new(templates());
}

fn state() -> SceneState {
    state_of_frame(SyntheticLog::new(3).recording(), 1, EgoOffset::default()).expect("a frame of ours")
}

fn skeleton() -> Stored {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("s");
    synthetic_log::skeleton(&path, &SyntheticLog::new(3));
    let folder = Folder::copy_of(&path);
    let manifest = serde_json::from_slice(folder.base(MANIFEST)).expect("JSON");
    Stored { folder, manifest, state: state() }
}

fn template(kind: TemplateKind) -> (Template, Vec<Point>) {
    let points: Vec<Point> =
        (0..12_u8).map(|i| Point::new([f32::from(i) * 0.3 - 1.8, 0.5, -0.5], [i; 3], 1)).collect();
    let bounds = Bounds::of(&points).expect("points");
    let (size, xxh3) = ([4.0, 1.8, 1.5], Checksum::of(&points));
    (Template { kind, class: kind.class(), size, points: points.len(), bounds, xxh3 }, points)
}

fn templates() -> Stored {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("t");
    let clouds = [TemplateKind::Sedan, TemplateKind::Pedestrian].map(template).to_vec();
    let library =
        TemplateLibrary::new(Vec::new(), TemplateOptions::default(), (clouds, TemplateReport::default()));
    let target = TemplateLibrary::target(&path, &Inputs::default()).expect("a new folder");
    library.write::<FileError>(target, |_| Ok(())).expect("a library");
    let folder = Folder::copy_of(&path);
    let manifest = serde_json::from_slice(folder.base(LIBRARY)).expect("JSON");
    Stored { folder, manifest, state: state() }
}

fn draw_folder(stored: &Stored, data: &[u8]) {
    let opened = Skeleton::open(stored.folder.root());
    let checked = opened.and_then(|skeleton| {
        // Reading the clouds compares checksums.
        let length = |cloud: &Cloud| Ok::<_, FileError>(cloud.points()?.len());
        let lengths = skeleton.clouds().iter().map(length).collect::<Result<Vec<usize>, _>>()?;
        Ok((skeleton, lengths))
    });
    match checked {
        Err(error) => assert_names_file_in(error, stored.folder.root(), data),
        Ok((skeleton, lengths)) => {
            let manifest = &skeleton.manifest;
            let counts =
                manifest.background.iter().map(|c| c.points).chain(manifest.actors.iter().map(|a| a.points));
            assert_eq!(
                lengths,
                counts.chain(manifest.templates.iter().map(|t| t.points)).collect::<Vec<_>>()
            );
            draw(&skeleton, &Substitutes::NONE, &stored.state);
            let options = AugmentOptions { share: 1.0, min_points: 2, ..AugmentOptions::default() };
            for (asset, points) in manifest.actors.iter().zip(skeleton.actors().expect("checked points")) {
                assert!(augment(points, &asset.track, &options).0.len() <= points.len());
            }
        }
    }
}

fn draw(skeleton: &Skeleton, substitutes: &Substitutes, state: &SceneState) {
    let stage = SceneClouds::with(skeleton, LOG, substitutes);
    let options = SelectionOptions { min_actor_points: 5, ..SelectionOptions::default() };
    let instances = stage.instances(state, &options);
    let views: Vec<View> = state.cameras.iter().map(|camera| camera.view.clone()).collect();
    let job = FrameJob {
        views: &views,
        schedule: &SplatSchedule::default(),
        color: &instances.color,
        geometry: &instances.geometry,
        occlusion: Occlusion::Scene,
        crop: Some(Crop { center: state.global_from_ego.translation.truncate(), radius_m: 60.0 }),
        maps: MapSet::SPLATTED,
        out_size: None,
    };
    let mut rasterizer = ReferenceRasterizer::new(stage.cloud_set());
    if rasterizer.begin(&job).is_ok() {
        let maps = rasterizer.finish().expect("maps of a frame that was begun");
        for maps in &maps {
            assert!(maps.depth_m.iter().all(|depth| *depth > 0.0), "a depth that is none");
            assert!(maps.instance.iter().all(|number| *number as usize <= state.actors.len()));
        }
    }
}

fn manifest(data: &[u8]) {
    SKELETON.with_borrow_mut(|stored| {
        stored.folder.put(MANIFEST, &json_file(data, &stored.manifest));
        draw_folder(stored, data);
        stored.folder.reset();
    });
}

fn manifest_seeds() -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", skeleton().folder.base(MANIFEST)));
    seeds
}

/// Writes arbitrary points and a manifest with their number; the first byte selects background or actors.
fn points(data: &[u8]) {
    SKELETON.with_borrow_mut(|stored| {
        let (whose, bytes) = data.split_first().unwrap_or((&0, &[]));
        let list = ["background", "actors"][usize::from(whose % 2)];
        let count = bytes.len() / size_of::<Point>();
        let mut manifest = stored.manifest.clone();
        if let Some(Value::Array(clouds)) = manifest.get_mut(list) {
            clouds.truncate(1);
            clouds[0]["points"] = count.into();
            clouds[0]["xxh3"] = Checksum::of(&bytes[..count * size_of::<Point>()]).to_string().into();
        }
        let (words, _) = bytes.as_chunks::<4>();
        let point = |[x, y, z, rgb_class]: &[[u8; 4]; 4]| {
            let position = [x, y, z].map(|word| f32::from_le_bytes(*word));
            Point { position, rgb_class: u32::from_le_bytes(*rgb_class) }
        };
        let table = PagedWriter::table_of(&words.as_chunks().0.iter().map(point).collect::<Vec<Point>>());
        manifest["pages"][list] = Checksum::of(&table).to_string().into();
        stored.folder.put(MANIFEST, manifest.to_string().as_bytes());
        stored.folder.put(&format!("{list}.points"), &bytes[..count * size_of::<Point>()]);
        stored.folder.put(&format!("{list}.pages"), &table);
        draw_folder(stored, data);
        stored.folder.reset();
    });
}

fn point_seeds() -> Vec<Seed> {
    let point = |i: u8, odd: f32| Point::new([f32::from(i) - 8.0, odd, 0.5], [i, 3, 255], i % 5);
    let bytes = |whose: u8, odd: f32| {
        let points = (0..16).flat_map(move |i| {
            let Point { position, rgb_class } = point(i, odd);
            position.map(f32::to_le_bytes).into_iter().chain([rgb_class.to_le_bytes()]).flatten()
        });
        std::iter::once(whose).chain(points).collect::<Vec<u8>>()
    };
    vec![
        seed("background", bytes(0, 1.0)),
        seed("actor", bytes(1, 0.25)),
        seed("nan", bytes(0, f32::NAN)),
        seed("far", bytes(0, f32::MAX)),
    ]
}

fn open_library(stored: &Stored, data: &[u8]) {
    match TemplateLibrary::open(stored.folder.root()) {
        Err(error) => assert_names_file_in(error, stored.folder.root(), data),
        Ok(library) => {
            assert!(library.clouds.iter().all(|(template, points)| template.points == points.len()));
            SKELETON.with_borrow(|skeleton| {
                let opened = Skeleton::open(skeleton.folder.root()).expect("a skeleton of ours");
                let substitutes = Substitutes { templates: library.clouds, ..Substitutes::NONE };
                draw(&opened, &substitutes, &skeleton.state);
            });
        }
    }
}

fn library(data: &[u8]) {
    SKELETON.with(|_| ()); // created in the first run, whose memory does not count
    TEMPLATES.with_borrow_mut(|stored| {
        stored.folder.put(LIBRARY, &json_file(data, &stored.manifest));
        let path = stored.folder.path(LIBRARY);
        match TemplateLibrary::open(stored.folder.root()) {
            Err(error) if !error.to_string().ends_with(TEMPLATE_POINTS) => {
                assert_names_file(error, &path, data)
            }
            _ => open_library(stored, data),
        }
        stored.folder.reset();
    });
}

fn library_seeds() -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", templates().folder.base(LIBRARY)));
    seeds
}

fn library_points(data: &[u8]) {
    TEMPLATES.with_borrow_mut(|stored| {
        let bytes = data.get(1..).unwrap_or_default();
        let count = bytes.len() / size_of::<Point>();
        let mut manifest = stored.manifest.clone();
        if let Some(Value::Array(templates)) = manifest.get_mut("templates") {
            templates.truncate(1);
            if let Some(template) = templates.first_mut() {
                template["points"] = count.into();
                template["xxh3"] = Checksum::of(&bytes[..count * size_of::<Point>()]).to_string().into();
            }
        }
        stored.folder.put(LIBRARY, manifest.to_string().as_bytes());
        stored.folder.put(TEMPLATE_POINTS, &bytes[..count * size_of::<Point>()]);
        open_library(stored, data);
        stored.folder.reset();
    });
}
