//! Templates: `pskel templates`, `build --templates`, and rendering with templates and with degraded assets.

use std::path::Path;

use point_skeleton::cloud::{Bounds, Point};
use point_skeleton::dataset::Class;
use point_skeleton::error::FileError;
use point_skeleton::files::Checksum;
use point_skeleton::skeleton::{
    Asset, BuildOptions, BuildReport, Chunk, Skeleton, SkeletonWriter, Source, TemplateKind, TemplateLibrary,
};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, tree};

/// Returns the sides and the top of a box, with a point every 5 cm.
fn shell([length, width, height]: [f64; 3]) -> Vec<Point> {
    let mut points = Vec::new();
    let steps = |size: f64| (size / 0.05).round() as i32;
    let at = |size: f64, i: i32| (size * (f64::from(i) / f64::from(steps(size)) - 0.5)) as f32;
    for x in 0..=steps(length) {
        for y in 0..=steps(width) {
            for z in 0..=steps(height) {
                let side = [(x, length), (y, width)].iter().any(|(i, s)| *i == 0 || *i == steps(*s));
                if side || z == steps(height) {
                    points.push(Point::new([at(length, x), at(width, y), at(height, z)], [90; 3], 1));
                }
            }
        }
    }
    points
}

fn asset(track: &str, category: &str, size: [f64; 3], points: Vec<Point>) -> (Asset, Vec<Point>) {
    let bounds = Bounds::of(&points).unwrap_or(Bounds { min: [0.0; 3], max: [0.0; 3] });
    let (class, count) = (Class::from_category(category), points.len());
    let (log, track, category) = (String::new(), track.to_owned(), category.to_owned());
    let xxh3 = Checksum::of(&points);
    (Asset { log, track, category, class, size, sweeps: 1, points: count, bounds, xxh3 }, points)
}

/// Writes a skeleton for a log with that name and some actors.
fn write_skeleton(path: &Path, log: &str, actors: Vec<(Asset, Vec<Point>)>) {
    let points = vec![Point::new([0.0; 3], [1; 3], 0)];
    let (bounds, xxh3) = (Bounds::of(&points).unwrap(), Checksum::of(&points));
    let chunk = Chunk { origin: [0.0; 3], points: 1, bounds, xxh3 };
    let source = Source { log: log.into(), location: "nowhere".into(), frames: 1, t_us: [0, 1] };
    SkeletonWriter::write::<FileError>(path, |writer| {
        writer.chunk(chunk, &points)?;
        for (asset, points) in actors {
            writer.actor(Asset { log: log.into(), ..asset }, &points)?;
        }
        writer.finish(vec![source], BuildOptions::default(), BuildReport::default())
    })
    .unwrap();
}

const SEDAN: [f64; 3] = [4.6, 1.9, 1.5];
const BUS: [f64; 3] = [12.0, 3.0, 3.3];

/// Writes two skeletons. The first has a vehicle as long as a bus, a car and a cone; the second has a car
/// without points, and a truck with few points.
fn two_skeletons(log: &TinyLog) {
    let first = vec![
        asset("bus", "vehicle", BUS, shell(BUS)),
        asset("car", "vehicle.car", SEDAN, shell(SEDAN)),
        asset("cone", "movable_object.trafficcone", [0.5; 3], shell([0.5; 3])),
    ];
    write_skeleton(&log.path("sk1"), "one", first);
    let second = vec![
        asset("empty", "vehicle.car", SEDAN, Vec::new()),
        asset("truck", "vehicle.truck", [8.0, 2.5, 3.0], shell([0.5; 3])),
    ];
    write_skeleton(&log.path("sk2"), "two", second);
}

#[test]
fn actors_of_several_skeletons_become_a_library() {
    let log = TinyLog::new();
    two_skeletons(&log);
    let summary = log.succeed("templates sk1 sk2 --out out/t");
    assert!(summary.starts_with("created 2 templates from 2 logs: sedan ("), "{summary}");
    assert!(summary.contains("skipped 1 actors without points"), "{summary}");
    let mut files: Vec<String> = tree(&log.path("out/t")).into_keys().collect();
    files.sort();
    assert_eq!(files, ["bus.png", "sedan.png", "templates.json", "templates.points"]);
    let library = TemplateLibrary::open(&log.path("out/t")).unwrap();
    let kinds: Vec<TemplateKind> = library.clouds.iter().map(|(t, _)| t.kind).collect();
    assert_eq!(kinds, [TemplateKind::Sedan, TemplateKind::Bus]);
    assert_eq!(library.clouds[1].0.size, BUS);
    let manifest = log.json("out/t/templates.json");
    let notes = json!({
        "actors of a category without templates": 1, "actors without points": 1,
        "truck templates with too few points": 1,
    });
    assert_eq!(manifest["report"]["notes"], notes);
    assert_eq!(
        manifest["sources"][1],
        json!({"log": "two", "location": "nowhere", "frames": 1, "t_us": [0, 1], "actors": 2})
    );
    assert_eq!(manifest["report"]["templates"][0]["clusters"][0]["members"], json!(["one/car"]));
    let picture = image::open(log.path("out/t/bus.png")).unwrap().into_rgb8();
    assert!(picture.pixels().filter(|p| p.0 != [0; 3]).count() > 50_000);
    // The bytes do not depend on the number of threads; the older library is replaced.
    let first = tree(&log.path("out/t"));
    for threads in ["1", "2"] {
        assert!(log.run_with("templates sk1 sk2 --out out/t", threads).status.success());
        assert!(first == tree(&log.path("out/t")), "{threads} threads");
    }
    let reported: serde_json::Value = {
        let output = log.run("info --json out/t");
        serde_json::from_slice(&output.stdout).unwrap()
    };
    assert_eq!((&reported["kind"], &reported["report"]["notes"]), (&json!("templates"), &notes));
    let text = String::from_utf8(log.run("info out/t").stdout).unwrap();
    assert!(text.contains("bus: ") && text.contains("12.00 x 3.00 x 3.30 m"), "{text}");
}

#[test]
fn templates_of_a_log_equal_its_skeletons() {
    let log = TinyLog::new();
    log.succeed("templates nuscenes:log --out out/t --min-points 10");
    log.succeed("build nuscenes:log --out sk");
    log.succeed("templates sk --out out/u --min-points 10");
    assert!(tree(&log.path("out/t")) == tree(&log.path("out/u")));
}

#[test]
fn template_errors_leave_no_output() {
    let log = TinyLog::new();
    two_skeletons(&log);
    write_skeleton(&log.path("none"), "none", Vec::new());
    log.fail("templates none --out out/t", 1, &["actors with enough points for a template, found no actors"]);
    log.fail("templates sk2 --out out/t", 1, &["found skipped 1 actors without points", "1 truck templates"]);
    log.fail("templates --out out/t", 2, &["LOG|SKELETON"]);
    log.fail("templates nowhere --out out/t", 2, &["the folder of a skeleton", "FORMAT:PATH", "nowhere"]);
    log.fail("templates nuscenes:nowhere --out out/t", 1, &["nowhere"]);
    log.fail(
        "templates sk1 --out log",
        1,
        &["expected only files that pskel wrote", "another file: log/samples"],
    );
    std::fs::remove_file(log.path("sk1/actors.points")).unwrap();
    log.fail("templates sk1 --out out/t", 1, &["cannot read", "sk1/actors.points"]);
}

#[test]
fn damaged_libraries_are_errors_that_leave_nothing() {
    let log = TinyLog::new();
    two_skeletons(&log);
    log.succeed("build nuscenes:log --out sk");
    log.succeed("templates sk1 --out t");
    const RENDER: &str = "render nuscenes:log --skeleton sk --out out --templates t";
    let path = log.path("t/templates.json");
    let good = std::fs::read_to_string(&path).unwrap();
    let mut many: serde_json::Value = serde_json::from_str(&good).unwrap();
    many["templates"][0]["points"] = json!(u64::MAX);
    let with = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        good.replace(from, to)
    };
    for (text, parts) in [
        (with("\"version\": 2", "\"version\": 9"), ["version 2, found format", "templates.json"]),
        (with("point-skeleton-templates", "point-skeleton"), ["point-skeleton-templates", "templates.json"]),
        (
            with("\"sources\"", "\"source\""),
            ["a list of templates, found no field sources", "templates.json"],
        ),
        (with("\"bus\"", "\"sedan\""), ["one template a kind", "sedan twice"]),
        (with("\"bus\"", "\"tank\""), ["found \"tank\" instead of the template sedan", "templates.json"]),
        (good.replace("4.6", "-4.6"), ["a box with sides of", "in template sedan"]),
        (many.to_string(), ["bytes (18446744073709", "templates.points"]),
        ("{".to_owned(), ["a list of templates", "templates.json"]),
    ] {
        std::fs::write(&path, text).unwrap();
        log.fail(RENDER, 1, &parts);
        log.fail("build nuscenes:log --out out/sk --templates-from t", 1, &parts);
    }
    std::fs::write(&path, &good).unwrap();
    let points = log.path("t/templates.points");
    let length = std::fs::metadata(&points).unwrap().len();
    std::fs::OpenOptions::new().write(true).open(&points).unwrap().set_len(length - 16).unwrap();
    log.fail(RENDER, 1, &[&format!("expected {length} bytes"), "templates.points"]);
    std::fs::remove_file(points).unwrap();
    log.fail(RENDER, 1, &["cannot read", "templates.points"]);
    log.fail(&RENDER.replace("--templates t", "--templates nowhere"), 1, &["nowhere/templates.json"]);
    for (extra, part) in [
        ("--augment=x", "SEED,share=S,color_only"),
        ("--augment=share", "SEED,share=S,color_only"),
        ("--augment=share=1.5", "a share from 0 to 1"),
    ] {
        log.fail(&format!("render nuscenes:log --skeleton sk --out out {extra}"), 2, &[part]);
    }
}

#[test]
fn templates_take_precedence_skeleton_library_built_in() {
    let log = TinyLog::new();
    two_skeletons(&log);
    log.succeed("templates sk1 --out t");
    log.succeed("build nuscenes:log --out sk");
    let render = |skeleton: &str, extra: &str| {
        log.succeed(&format!("render nuscenes:log --skeleton {skeleton} --out out --frames 0..1 {extra}"));
        log.json("out/index.json")["options"]["templates"].clone()
    };
    let defaults = json!({
        "sedan": "default", "suv": "default", "pickup": "default", "pedestrian": "default", "bike": "default",
    });
    assert_eq!(render("sk", ""), defaults);
    assert_eq!(render("sk", "--no-default-templates"), json!({}));
    let mut both = defaults.clone();
    both["sedan"] = json!("library");
    both["bus"] = json!("library");
    assert_eq!(render("sk", "--templates t"), both);
    // Sources of a skeleton's templates by precedence: a file, its own actors, the library.
    log.succeed("convert sk --out npy");
    log.succeed("build nuscenes:log --out sk3 --templates-from t --template bus=npy/actors/car.npy");
    let skeleton = Skeleton::open(&log.path("sk3")).unwrap();
    let kinds: Vec<_> = skeleton.manifest.templates.iter().map(|t| t.kind).collect();
    assert_eq!(kinds, [TemplateKind::Sedan, TemplateKind::Bus]);
    let library = TemplateLibrary::open(&log.path("t")).unwrap();
    assert_eq!(skeleton.templates().unwrap()[0], library.clouds[0].1);
    assert_ne!(skeleton.templates().unwrap()[1], library.clouds[1].1);
    assert_eq!(render("sk3", "--templates t")["sedan"], "skeleton");
    let summary = log.succeed("build nuscenes:log --out sk4 --templates");
    assert!(summary.contains("templates of its actors: "), "{summary}");
}

#[test]
fn degraded_assets_are_reproducible_and_listed_in_the_index() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk --voxel 0");
    let run = |args: &str, threads: &str| {
        let all =
            format!("render nuscenes:log --skeleton sk --out out --frames 0..2 --rasterizer cpu {args}");
        let output = log.run_with(&all, threads);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        (tree(&log.path("out")), log.json("out/index.json")["options"]["augment"].clone())
    };
    let (clean, reported) = run("", "2");
    assert_eq!(reported, json!(null));
    let (worse, reported) = run("--augment=3,share=1", "2");
    assert_eq!((&reported["seed"], &reported["share"]), (&json!(3), &json!(1.0)));
    let car = &reported["assets"]["car"];
    assert!(["thinned", "one_view"].contains(&car["kind"].as_str().unwrap()), "{car}");
    let before = Skeleton::open(&log.path("sk")).unwrap().manifest.actors[0].points as u64;
    let after = car["points"].as_u64().unwrap();
    assert!((200..before).contains(&after), "{after} of {before}");
    let color = "000000/CAM_FRONT/color.png";
    assert!(worse[color] != clean[color]);
    assert!(worse == run("--augment=3,share=1", "1").0);
    let (none, reported) = run("--augment=share=0", "2");
    assert_eq!((&reported["seed"], &reported["assets"]["car"]["kind"]), (&json!(0), &json!("none")));
    assert!(none[color] == clean[color]);
    // With its own points in depth, class and instance maps, too, or in color alone.
    let own = "--min-actor-points 0 --splat 100:0";
    let clean = run(own, "2").0;
    let worse = run(&format!("{own} --augment=3,share=1"), "2").0;
    let (only, reported) = run(&format!("{own} --augment=3,share=1,color_only"), "2");
    assert_eq!(reported["color_only"], json!(true));
    let depth = "000000/CAM_FRONT/depth.png";
    assert!(worse[color] != clean[color] && worse[depth] != clean[depth]);
    for (name, bytes) in only.iter().filter(|(name, _)| name.contains("/CAM_") && name.ends_with(".png")) {
        let expected = if name.ends_with("color.png") { &worse } else { &clean };
        assert!(expected[name] == *bytes, "{name}");
    }
}
