//! Points of strangers: origins, colors, and text that is not finite; coordinates and sizes beyond all
//! limits.

use std::path::Path;

use point_skeleton::cloud::{self, Bounds, Point, npy};
use point_skeleton::error::FileError;
use point_skeleton::files::Checksum;
use point_skeleton::skeleton::{Asset, BuildOptions, BuildReport, Chunk, Skeleton, SkeletonWriter, Source};
use serde_json::json;

use super::Case;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::TinyLog;
use crate::untrusted::guarded;
use pskel_testing::npz;
use pskel_testing::shared::shared;

impl Case {
    /// Copies the files of a shared case. Returns `None` where these are missing.
    fn of_files(name: &str) -> Option<Self> {
        let source = shared("the case")?.join("cases").join(name);
        let case = Self::empty();
        for entry in std::fs::read_dir(source).unwrap() {
            let entry = entry.unwrap();
            std::fs::copy(entry.path(), case.path().join(entry.file_name())).unwrap();
        }
        Some(case)
    }

    /// Returns an empty folder.
    fn empty() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// Splats points into the cameras of `c.json`. Returns the maps and the notes, one a line.
    #[track_caller]
    fn splat(&self, points: &str) -> (Maps, String) {
        let args =
            format!("splat --points {points} --cameras c.json --splat 100:0 --rasterizer cpu --out f.npz");
        let (_, reported) = self.succeed(&args);
        let notes = reported
            .lines()
            .filter(|line| line.starts_with("note: "))
            .map(|line| format!("{line}\n"))
            .collect();
        let path = self.path().join("f.npz");
        let maps = Maps {
            color: npz::read::<u8>(&path, "color").data,
            depth: npz::read::<f32>(&path, "depth").data,
            point: npz::read::<u32>(&path, "point").data,
        };
        (maps, notes)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.path().join(name), bytes).unwrap();
    }

    /// Writes an array of doubles.
    fn write_npy(&self, name: &str, rows: &[[f64; 6]]) {
        let text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 6), }}", rows.len());
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(rows.as_flattened().iter().flat_map(|value| value.to_le_bytes()));
        self.write(name, bytes);
    }

    /// Writes a camera of 64x48 pixels at a position, looking along z.
    fn write_camera(&self, [x, y, z]: [f64; 3]) {
        let camera = json!({
            "name": "c", "width": 64, "height": 48,
            "intrinsics": [[50.0, 0.0, 32.0], [0.0, 50.0, 24.0], [0.0, 0.0, 1.0]],
            "camera_from_world": [[1.0, 0.0, 0.0, -x], [0.0, 1.0, 0.0, -y], [0.0, 0.0, 1.0, -z], [0.0, 0.0,
            0.0, 1.0]],
        });
        self.write("c.json", json!({ "cameras": [camera] }).to_string());
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Maps {
    color: Vec<u8>,
    depth: Vec<f32>,
    point: Vec<u32>,
}

impl Maps {
    /// Returns the maps with higher numbers of points.
    fn shifted(&self, by: u32) -> Self {
        let point = self.point.iter().map(|number| if *number == 0 { 0 } else { number + by }).collect();
        Self { point, ..self.clone() }
    }
}

/// Returns 400 points before a camera at UTM coordinates.
fn scene([x, y, z]: [f64; 3]) -> Vec<[f64; 6]> {
    let at = |i: u32| {
        let [u, v, w] = [7_919, 104_729, 1_299_709].map(|prime| f64::from(i * prime % 10_007) / 10_007.0);
        [x + 8.0 * u - 4.0, y + 6.0 * v - 3.0, z + 5.0 + 15.0 * w, 200.0, f64::from(i % 200), 30.0]
    };
    (0..400).map(at).collect()
}

const MUNICH: [f64; 3] = [691_603.25, 5_335_787.75, 520.5];
const BERLIN: [f64; 3] = [391_780.5, 5_820_070.25, 34.0];

#[test]
fn an_invalid_point_does_not_change_the_maps() {
    let Some(case) = Case::of_files("ecosystem/01-first-point-far-away") else { return };
    let (plain, notes) = case.splat("plain.npy");
    assert_eq!(notes, "");
    for points in ["zero-first.npy", "far-first.npy"] {
        let (maps, notes) = case.splat(points);
        assert!(maps == plain.shifted(1), "{points}");
        let note = format!("note: {points}: 1 of 401 points lie more than 16384 m from the origin (691");
        assert!(notes.starts_with(&note), "{notes}");
    }
}

#[test]
fn invalid_points_do_not_reduce_precision() {
    let case = Case::empty();
    case.write_camera(MUNICH);
    let rows = scene(MUNICH);
    case.write_npy("p.npy", &rows);
    let (plain, _) = case.splat("p.npy");
    let invalid = |[x, y, z]: [f64; 3]| [x, y, z, 0.0, 0.0, 0.0];
    for position in [
        [0.0; 3],
        [0.0, 0.0, -1e20],
        [f64::INFINITY, 0.0, 0.0],
        [f64::NAN; 3],
        [-9999.0; 3],
        [1e300, 1e300, 1e300],
    ] {
        for (before, after) in [(1, 0), (0, 1), (5, 5), (400, 0)] {
            let lost = invalid(position);
            let all = [vec![lost; before], rows.clone(), vec![lost; after]].concat();
            case.write_npy("p.npy", &all);
            assert!(
                case.splat("p.npy").0 == plain.shifted(before as u32),
                "{before}, {after} times {position:?}"
            );
        }
    }
    // Fewer points in another city are counted.
    case.write_npy("p.npy", &[scene(BERLIN)[..300].to_vec(), rows.clone()].concat());
    let (maps, notes) = case.splat("p.npy");
    assert!(maps == plain.shifted(300));
    assert!(notes.contains("300 of 700 points lie more than 16384 m from the origin (69"), "{notes}");
}

#[test]
fn an_origin_applies_only_to_its_file() {
    let case = Case::empty();
    let origin = |name: &str| case.json(name)["origin"][0].as_f64().unwrap();
    case.write_npy("munich.npy", &scene(MUNICH));
    case.write_npy("berlin.npy", &scene(BERLIN));
    case.write_npy("local.npy", &scene([1.0, 2.0, 3.0]));
    let (reported, _) = case.succeed("convert munich.npy --out z.ply");
    assert!(reported.contains("relative to the origin in z.ply.origin.json"), "{reported}");
    case.succeed("convert berlin.npy --out z.npy");
    let near = |name: &str, [x, ..]: [f64; 3]| (origin(name) - x).abs() < 100.0;
    assert!(near("z.ply.origin.json", MUNICH) && near("z.npy.origin.json", BERLIN));
    // Points without an origin leave none beside them, except for what no run wrote.
    case.succeed("convert local.npy --out z.ply");
    assert!(!case.path().join("z.ply.origin.json").exists() && near("z.npy.origin.json", BERLIN));
    case.write("z.npy.origin.json", "mine");
    let ended = case.run("convert local.npy --out z.npy");
    ended.refused("a file of somebody", &["expected an origin of points", "z.npy.origin.json"]);
}

#[test]
fn converting_beside_an_invalid_point_retains_millimeters() {
    let case = Case::empty();
    let rows = [vec![[0.0; 6]], scene(MUNICH)].concat();
    case.write_npy("p.npy", &rows);
    case.succeed("convert p.npy --out out.ply");
    let origin: Vec<f64> =
        serde_json::from_value(case.json("out.ply.origin.json")["origin"].clone()).unwrap();
    let points = cloud::read(&case.path().join("out.ply")).unwrap().points;
    for (row, point) in rows.iter().zip(points).skip(1) {
        for axis in 0..3 {
            let off = f64::from(point.position[axis]) + origin[axis] - row[axis];
            assert!(off.abs() < 1e-4, "{off}");
        }
    }
}

#[test]
fn coordinates_rounded_to_single_precision_are_noted() {
    let case = Case::empty();
    case.write_camera(MUNICH);
    let points: Vec<Point> = scene(MUNICH)
        .iter()
        .map(|row| Point::new([row[0], row[1], row[2]].map(|v| v as f32), [9; 3], 0))
        .collect();
    npy::write(&case.path().join("p.npy"), &points, false).unwrap();
    let (_, notes) = case.splat("p.npy");
    let expected =
        "400 of 400 points lie more than 16384 m from zero in single precision: rounded by up to 0.250 m";
    assert!(notes.contains(expected), "{notes}");
    let (reported, _) = case.succeed("info p.npy --json");
    assert!(reported.contains(expected), "{reported}");
}

#[test]
fn ply_colors_from_0_to_1_equal_0_to_255() {
    let Some(case) = Case::of_files("ecosystem/02-ply-colors-from-0-to-1") else { return };
    let (levels, notes) = case.splat("uchar_bin.ply");
    assert_eq!(notes, "");
    assert!(levels.color.windows(3).any(|rgb| rgb == [255, 128, 0]));
    for points in ["float01_bin.ply", "double01_bin.ply"] {
        let (maps, notes) = case.splat(points);
        assert!(maps == levels, "{points}");
        assert_eq!(notes, format!("note: {points}: colors of 0 to 1, scaled to 0 to 255\n"));
    }
}

/// Returns a text file with a point before the camera; `properties` are its colors, `values` their text.
fn text_ply(properties: &[(&str, &str)], values: &str) -> String {
    let properties: String =
        properties.iter().map(|(kind, name)| format!("property {kind} {name}\n")).collect();
    format!(
        "ply\nformat ascii 1.0\ncomment made\nobj_info a\nelement vertex 1\nproperty float x\nproperty float \
            y\n\
         property float z\n{properties}end_header\n0 0 5 {values}\n"
    )
}

#[test]
fn ply_colors_are_found_by_other_names_and_missing_ones_are_noted() {
    let case = Case::empty();
    case.write_camera([0.0; 3]);
    let packed = f32::from_bits(0x00ff_8000).to_string();
    let three = |kind, names: [&'static str; 3]| names.map(|name| (kind, name)).to_vec();
    for (properties, values, rgb, note) in [
        (three("uchar", ["r", "g", "b"]), "255 128 0", [255, 128, 0], "colors from r, g, b"),
        (three("uchar", ["Red", "Green", "Blue"]), "255 128 0", [255, 128, 0], ""),
        (
            three("uchar", ["diffuse_red", "diffuse_green", "diffuse_blue"]),
            "255 128 0",
            [255, 128, 0],
            "colors from diffuse_red, diffuse_green, diffuse_blue",
        ),
        (
            three("float", ["scalar_Red", "scalar_Green", "scalar_Blue"]),
            "255.0 128 0",
            [255, 128, 0],
            "colors from scalar_red, scalar_green, scalar_blue",
        ),
        (three("float", ["red_f", "green_f", "blue_f"]), "1 0.5 0", [255, 128, 0], "scaled to 0 to 255"),
        (vec![("float", "rgb")], packed.as_str(), [255, 128, 0], "colors from the bits of rgb"),
        (vec![("float", "rgb")], "16744448", [255, 128, 0], "colors from the bits of rgb"),
        (vec![("float", "rgb")], "4294934528", [255, 128, 0], "colors from the bits of rgb"),
        (vec![("double", "rgb")], packed.as_str(), [255, 128, 0], "colors from the bits of rgb"),
        (vec![("double", "rgb")], "16744448", [255, 128, 0], "colors from the bits of rgb"),
        (
            three("float", ["red", "green", "blue"]),
            "nan 0.5 -1e-9",
            [0, 128, 0],
            "colors of 1 of 1 points are not finite or just beyond 0 to 1: black, or the nearest level",
        ),
        (vec![("uint", "rgba")], "4294934528", [255, 128, 0], "colors from the bits of rgba"),
        (
            three("ushort", ["red", "green", "blue"]),
            "65535 32896 0",
            [255, 128, 0],
            "colors of 0 to 65535, scaled to 0 to 255",
        ),
        (three("uchar", ["red", "green", "blue"]), "1 0 1", [1, 0, 1], ""),
        (
            three("float", ["f_dc_0", "f_dc_1", "f_dc_2"]),
            "1.7724539 0 -9",
            [255, 128, 0],
            "colors from the constant harmonics f_dc_0, f_dc_1, f_dc_2",
        ),
        (vec![("float", "intensity")], "7", [128; 3], "no red, green, blue among intensity: gray 128"),
        (vec![("uchar", "red")], "9", [9, 128, 128], "of colors red alone: the other channels are 128"),
    ] {
        case.write("p.ply", text_ply(&properties, values));
        let (maps, notes) = case.splat("p.ply");
        let at = maps.point.iter().position(|number| *number == 1).unwrap();
        assert_eq!(maps.color[3 * at..3 * at + 3], rgb, "{properties:?}");
        assert!(notes.contains(note) && notes.is_empty() == note.is_empty(), "{properties:?}: {notes}");
    }
}

#[test]
fn packed_colors_are_found_in_binary_doubles() {
    let case = Case::empty();
    case.write_camera([0.0; 3]);
    for rgb in [f64::from(f32::from_bits(0x00ff_8000)), f64::from(0x00ff_8000)] {
        let header = text_ply(&[("double", "rgb")], "").replace("ascii", "binary_little_endian");
        let (header, _) = header.split_once("0 0 5").unwrap();
        let position = [0.0_f32, 0.0, 5.0].map(f32::to_le_bytes);
        case.write("p.ply", [header.as_bytes(), position.as_flattened(), &rgb.to_le_bytes()].concat());
        let (maps, _) = case.splat("p.ply");
        let at = maps.point.iter().position(|number| *number == 1).unwrap();
        assert_eq!(maps.color[3 * at..3 * at + 3], [255, 128, 0], "{rgb}");
    }
}

#[test]
fn non_finite_words_are_read_in_text_ply() {
    let Some(case) = Case::of_files("ecosystem/07-nan-in-ascii-ply") else { return };
    let (binary, _) = case.splat("binary.ply");
    assert_eq!(binary.depth.iter().filter(|depth| **depth == 5.0).count(), 1);
    for points in ["nan.ply", "inf.ply"] {
        assert!(case.splat(points).0 == binary, "{points}");
        let (reported, _) = case.succeed(&format!("info {points} --json"));
        let info: serde_json::Value = serde_json::from_str(&reported).unwrap();
        assert!(reported.contains("\"not_finite\": 1") || reported.contains("\"not_finite\":1"), "{info}");
    }
    let text = std::fs::read_to_string(case.path().join("nan.ply")).unwrap();
    for (from, to) in [
        ("nan nan nan", "-nan(ind) 1.#QNAN -1.#IND"),
        ("nan nan nan", "NaN Infinity -inf"),
        ("nan nan nan 0 0 0", "  nan\tnan  nan nan nan nan   "),
        ("0 0 5 255 128 0", "0. .0 +5e0 255.0 128 0 "),
        ("\n", "\r\n"),
        ("0 0 5 255 128 0\n", "\n0 0 5 255 128 0"),
    ] {
        let changed = text.replace(from, to);
        assert!(changed != text, "{from}");
        case.write("p.ply", changed);
        assert!(case.splat("p.ply").0 == binary, "{to:?}");
    }
    for (from, to, found) in [
        ("0 0 5 255 128 0", "0 0 5,5 255 128 0", "a float as z of vertex 1, found \"5,5\""),
        ("0 0 5 255 128 0", "0 0 5 255 128", "a uchar as blue of vertex 1, found the end of the line"),
        ("0 0 5 255 128 0", "0 0 5 256 128 0", "a uchar as red of vertex 1, found \"256\""),
        ("0 0 5 255 128 0\n", "", "Unexpected end of file in vertex 1"),
    ] {
        case.write("p.ply", text.replace(from, to));
        let args = "splat --points p.ply --cameras c.json --out g.npz --rasterizer cpu";
        case.run(args).refused(to, &[found, "p.ply"]);
    }
}

#[test]
fn impossible_box_sizes_name_their_record() {
    let log = TinyLog::new();
    log.change("sample_annotation", "/0/size/1", json!(1e308));
    for args in ["build nuscenes:log --out sk --templates", "build nuscenes:log --out sk"] {
        let parts = ["a box with sides of 0.0001 to 100000 m", "1e308", "sample_annotation"];
        guarded::run(&log.path(""), &args.split(' ').collect::<Vec<_>>()).refused(args, &parts);
    }
    assert!(!log.path("sk").exists() && !log.path("sk.partial").exists());
}

#[test]
fn impossible_coordinates_of_a_sweep_are_dropped_and_counted() {
    let log = TinyLog::new();
    let sweep = log.path("log/samples/0.pcd.bin");
    let mut bytes = std::fs::read(&sweep).unwrap();
    for position in [[0.0, 0.0, -1e20_f32], [3e38, -3e38, 3e38]] {
        bytes.extend(position.iter().chain(&[0.0, 0.0]).flat_map(|v| v.to_le_bytes()));
    }
    log.succeed("build nuscenes:log --out plain");
    std::fs::write(&sweep, bytes).unwrap();
    log.succeed("build nuscenes:log --out sk");
    assert_eq!(log.json("sk/skeleton.json")["report"]["dropped_not_finite"], 2);
    for file in ["background.points", "actors.points"] {
        let [plain, found] =
            ["plain", "sk"].map(|sk| std::fs::read(log.path(&format!("{sk}/{file}"))).unwrap());
        assert!(plain == found, "{file}");
    }
}

/// Writes a skeleton of an actor with points up to a coordinate, its manifest being `bounds`.
fn forged(path: &Path, far: f32, bounds: Bounds) {
    let points: Vec<Point> = (0..2000)
        .map(|i| Point::new([far * (i % 50) as f32 / 50.0, (i / 50) as f32 * 0.02, 0.5], [9; 3], 1))
        .collect();
    let asset = Asset {
        log: "log".into(),
        track: "car".into(),
        category: "vehicle.car".into(),
        class: point_skeleton::dataset::Class::MotorVehicle,
        size: [4.6, 1.9, 1.5],
        sweeps: 1,
        points: points.len(),
        bounds,
        xxh3: Checksum::of(&points),
    };
    let chunk_points = [Point::new([0.0; 3], [1; 3], 0)];
    let chunk = Chunk {
        origin: [0.0; 3],
        points: 1,
        bounds: Bounds::of(&chunk_points).unwrap(),
        xxh3: Checksum::of(&chunk_points),
    };
    SkeletonWriter::write::<FileError>(path, |writer| {
        writer.chunk(chunk, &chunk_points)?;
        writer.actor(asset, &points)?;
        let source = Source { log: "log".into(), ..Source::default() };
        writer.finish(vec![source], BuildOptions::default(), BuildReport::default())
    })
    .unwrap();
}

#[test]
fn forged_coordinates_do_not_crash_templates() {
    let case = Case::empty();
    let near = Bounds { min: [0.0; 3], max: [1.0; 3] };
    // The manifest says less than the points.
    forged(&case.path().join("sk"), 3e38, near);
    let ended = case.run("templates sk --out t1");
    assert!(matches!(ended.code, Some(0 | 1)), "{}", ended.stderr);
    // The manifest says it too.
    let manifest = case.path().join("sk/skeleton.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["actors"][0]["bounds"]["max"] = json!([3e38, 1.0, 1.0]);
    std::fs::write(&manifest, json.to_string()).unwrap();
    let parts = ["bounds within 100000000 m of zero", "track \"car\" of log \"log\"", "skeleton.json"];
    case.run("templates sk --out t2").refused("bounds", &parts);
    json["actors"][0]["bounds"]["max"] = json!([1.0, 1.0, 1.0]);
    json["actors"][0]["size"] = json!([1e308, 1.9, 1.5]);
    std::fs::write(&manifest, json.to_string()).unwrap();
    let parts = ["a box with sides of 0.0001 to 100000 m", "track \"car\" of log \"log\""];
    case.run("templates sk --out t3").refused("size", &parts);
    assert!(!case.path().join("t2").exists() && !case.path().join("t3").exists());
}

#[test]
fn a_template_of_impossible_size_keeps_the_old_skeleton() {
    let log = TinyLog::new();
    let build = "build nuscenes:log --out sk";
    log.succeed(build);
    let before = std::fs::read(log.path("sk/skeleton.json")).unwrap();
    let points = [[-3e38, -3e38, -3e38], [3e38, 3e38, 3e38]].map(|p| Point::new(p, [9; 3], 0));
    npy::write(&log.path("t.npy"), &points, false).unwrap();
    let parts = ["points within a box with sides of 0.0001 to 100000 m", "t.npy"];
    log.fail(&format!("{build} --template sedan=t.npy"), 1, &parts);
    assert!(std::fs::read(log.path("sk/skeleton.json")).unwrap() == before);
    Skeleton::open(&log.path("sk")).unwrap();
}
