//! `pskel splat` through the command line.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::{DAffine3, DVec3};
use point_skeleton::cloud::{Point, cameras, npy, ply};
use point_skeleton::conditions::{BinScale, DepthBins};
use point_skeleton::geometry::{Camera, View};

use pskel_testing::parity::{Layout, assert_parity, differing};
use pskel_testing::{npz, shared as common};

const PSKEL: &str = env!("CARGO_BIN_EXE_pskel");

/// A folder with points, cameras and an empty folder for the output.
struct Case {
    folder: tempfile::TempDir,
}

impl Case {
    /// Four points in front of two cameras of 20x30 pixels.
    fn new() -> Self {
        let case = Self { folder: tempfile::tempdir().unwrap() };
        std::fs::create_dir(case.path("out")).unwrap();
        let point = |x: f32, z: f32, level: u8, class| Point::new([x, 0.0, z], [level, 2 * level, 7], class);
        let points = [
            point(0.0, 40.0, 9, 0),
            point(0.0, 10.0, 50, 1),
            point(1.0, 40.0, 20, 2),
            point(0.0, 10.0, 60, 3),
        ];
        npy::write(&case.path("p.npy"), &points, true).unwrap();
        ply::write(&case.path("p.ply"), &points).unwrap();
        let rows = [[30.0, 0.0, 15.0], [0.0, 30.0, 10.0], [0.0, 0.0, 1.0]];
        let view = |name: &str, x: f64| View {
            camera: Camera::new(name, 30, 20, rows).unwrap(),
            camera_from_world: DAffine3::from_translation(DVec3::new(x, 0.0, 0.0)),
        };
        cameras::write(&case.path("c.json"), &[view("a", 0.0), view("b", -3.0)]).unwrap();
        case
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn splat(&self, points: &str, extra: &[&str]) -> Output {
        let mut command = Command::new(PSKEL);
        command.current_dir(self.folder.path()).args(["splat", "--points", points, "--cameras", "c.json"]);
        command.args(["--out", "out/f.npz", "--rasterizer", "cpu"]).args(extra).output().unwrap()
    }

    fn out_files(&self) -> usize {
        std::fs::read_dir(self.path("out")).unwrap().count()
    }

    /// Asserts that the command fails with a code and a message, and leaves no output.
    #[track_caller]
    fn assert_fails(&self, output: &Output, code: i32, message: &str) {
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        assert!(stderr.contains(message), "{stderr}\nexpected {message}");
        assert_eq!(self.out_files(), 0);
    }
}

/// Returns an array of zeros in NumPy's format.
fn zeros(descr: &str, fortran: &str, shape: &str, bytes: usize) -> Vec<u8> {
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}");
    text += &" ".repeat(63 - (10 + text.len()) % 64);
    text.push('\n');
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((text.len() as u16).to_le_bytes());
    file.extend(text.as_bytes());
    file.resize(file.len() + bytes, 0);
    file
}

#[test]
fn the_nearest_point_wins_and_ties_go_to_the_first_row() {
    let case = Case::new();
    let output = case.splat("p.npy", &[]);
    assert!(output.status.success(), "{output:?}");
    let summary = String::from_utf8(output.stdout).unwrap();
    assert!(summary.contains("4 points into 2 views by cpu") && summary.lines().count() == 1, "{summary}");
    let path = case.path("out/f.npz");
    let point = npz::read::<u32>(&path, "point");
    assert_eq!(point.shape, [2, 20, 30]);
    let at = |view: usize, row: usize, column: usize| (view * 20 + row) * 30 + column;
    // Points 2 and 4 have the same position; point 1 is behind them, within their squares.
    assert_eq!(point.data[at(0, 10, 15)], 2);
    assert_eq!((point.data[at(0, 8, 13)], point.data[at(0, 7, 13)]), (2, 0));
    assert_eq!(point.data[at(1, 10, 6)], 2);
    assert_eq!(npz::read::<u8>(&path, "class").data[at(0, 10, 15)], 1);
    assert_eq!(npz::read::<u8>(&path, "color").data[3 * at(0, 10, 15)..][..3], [50, 100, 7]);
    let depth = npz::read::<f32>(&path, "depth").data;
    assert_eq!((depth[at(0, 10, 15)], depth[at(0, 0, 0)]), (10.0, -300.0));
}

#[test]
fn two_runs_and_both_formats_give_the_same_bytes() {
    let case = Case::new();
    let run = |points: &str| {
        assert!(case.splat(points, &["--out-size", "10x15", "--splat", "15:2,100:1"]).status.success());
        std::fs::read(case.path("out/f.npz")).unwrap()
    };
    let first = run("p.npy");
    assert_eq!(first, run("p.npy"));
    assert_eq!(first, run("p.ply"));
    assert_eq!(npz::read::<u8>(&case.path("out/f.npz"), "color").shape, [2, 10, 15, 3]);
}

#[test]
fn bad_points_are_refused() {
    let case = Case::new();
    let mut class = zeros("<f4", "False", "(1, 7)", 24);
    class.extend(1.5_f32.to_le_bytes());
    for (file, message) in [
        (
            zeros("<i8", "False", "(1, 6)", 48),
            "error: expected dtype <f2, <f4 or <f8, found dtype '<i8': bad.npy",
        ),
        (zeros("<f4", "False", "(1, 8)", 32), "expected shape [N, 6] or [N, 7], found shape [1, 8]"),
        (zeros("<f4", "True", "(2, 6)", 48), "expected C order, found Fortran order"),
        (zeros("<f4", "False", "(0, 6)", 0), "expected 1 to 4294967294 points, found 0"),
        (zeros("<f4", "False", "(2, 6)", 47), "expected 2 rows of 24 bytes, found 47 bytes of data"),
        (class, "expected an integer class of 0 to 255, found 1.5 in row 0: bad.npy"),
    ] {
        std::fs::write(case.path("bad.npy"), file).unwrap();
        case.assert_fails(&case.splat("bad.npy", &[]), 1, message);
    }
    case.assert_fails(&case.splat("none.npy", &[]), 1, "none.npy");
    case.assert_fails(&case.splat("c.json", &[]), 1, "ending in .npy or .ply");
}

#[test]
fn bad_cameras_are_refused() {
    let case = Case::new();
    let good = std::fs::read_to_string(case.path("c.json")).unwrap();
    for (from, to, message) in [
        ("30.0,", "0.0,", "expected invertible intrinsics"),
        ("\"b\"", "\"a\"", "\"a\" twice"),
        ("\"width\": 30", "\"width\": 0", "found 20x0 in camera a"),
        ("\"cameras\"", "\"views\"", "found no field cameras"),
    ] {
        assert!(good.contains(from));
        std::fs::write(case.path("c.json"), good.replace(from, to)).unwrap();
        case.assert_fails(&case.splat("p.npy", &[]), 1, message);
    }
    let last = good.rfind("\"width\": 30").unwrap();
    std::fs::write(case.path("c.json"), format!("{}{}", &good[..last], good[last..].replace("30,", "31,")))
        .unwrap();
    case.assert_fails(&case.splat("p.npy", &[]), 1, "--out-size");
    assert!(case.splat("p.npy", &["--out-size", "4x5"]).status.success());
}

#[test]
fn wrong_usage_exits_with_2() {
    let case = Case::new();
    case.assert_fails(&case.splat("p.npy", &["--splat", "15:1,35:2"]), 2, "radii");
    case.assert_fails(&case.splat("p.npy", &["--splat", "35:1,15:0"]), 2, "rising depths");
    case.assert_fails(&case.splat("p.npy", &["--out-size", "0x5"]), 2, "a size HxW");
    case.assert_fails(&case.splat("p.npy", &["--no-such-option"]), 2, "Usage");
    let help = Command::new(PSKEL).args(["splat", "--help"]).output().unwrap();
    assert!(help.status.success() && String::from_utf8_lossy(&help.stdout).contains("--out-size"));
    assert_eq!(Command::new(PSKEL).output().unwrap().status.code(), Some(2));
}

#[test]
fn a_file_size_limit_is_an_error_that_names_the_file() {
    let case = Case::new();
    // The archive is larger than the file size limit of one block.
    let big: Vec<Point> = (0..40_000_u32)
        .map(|i| {
            Point::new(
                [(i % 200) as f32 * 0.1, (i / 200) as f32 * 0.1, 20.0],
                i.to_le_bytes()[..3].try_into().unwrap(),
                1,
            )
        })
        .collect();
    npy::write(&case.path("big.npy"), &big, false).unwrap();
    let script = format!(
        "ulimit -f 1; exec '{PSKEL}' splat --points big.npy --cameras c.json --out out/f.npz --rasterizer cpu"
    );
    let output = Command::new("bash").arg("-c").arg(script).current_dir(case.folder.path()).output().unwrap();
    case.assert_fails(&output, 1, "out/f.npz");
}

#[test]
fn non_finite_rows_are_counted_and_retain_their_number() {
    let case = Case::new();
    let mut points: Vec<Point> = cloud(&case.path("p.npy"));
    points[0].position[1] = f32::NAN;
    points[1].position[2] = f32::INFINITY;
    npy::write(&case.path("nan.npy"), &points, true).unwrap();
    let output = case.splat("nan.npy", &[]);
    assert!(
        String::from_utf8_lossy(&output.stdout).contains("4 points (2 not finite, never drawn)"),
        "{output:?}"
    );
    let point = npz::read::<u32>(&case.path("out/f.npz"), "point").data;
    assert!(point.contains(&4) && point.contains(&3) && !point.contains(&1) && !point.contains(&2));
}

fn cloud(path: &Path) -> Vec<Point> {
    npy::read(path).unwrap().points
}

#[test]
fn fixture_reduced_maps_agree_with_the_reference() {
    let Some(fixtures) = common::fixtures("projection-pandaset") else { return };
    let fixture = fixtures.join("projection-pandaset");
    let [compute, raster, cpu] =
        ["compute", "graphics", "cpu"].map(|rasterizer| reduced_points(&fixture, rasterizer));
    for found in [compute, raster] {
        let differ = found.iter().zip(&cpu).filter(|(a, b)| a != b).count();
        assert!(differ as f64 <= 1e-5 * cpu.len() as f64, "{differ} of {} pixels differ", cpu.len());
    }
}

/// Compares a rasterizer's reduced maps with the reference's; returns the map of point numbers.
fn reduced_points(fixture: &Path, rasterizer: &str) -> Vec<u32> {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("f.npz");
    let mut command = Command::new(PSKEL);
    command.arg("splat").arg("--points").arg(fixture.join("points.npy")).env("PSKEL_VALIDATION", "1");
    command.arg("--cameras").arg(fixture.join("cameras.json")).arg("--out").arg(&out);
    command.args(["--splat", "15:2,35:1,100:0", "--out-size", "256x448", "--rasterizer", rasterizer]);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let expected = fixture.join("reduced.npz");
    let layout = Layout { height: 256, width: 448, channels: 1, border: 1 };
    let depth = npz::read::<f32>(&out, "depth");
    assert_eq!(depth.shape, [6, 256, 448]);
    let reference = npz::read::<f32>(&expected, "depth").data;
    let part = differing(&depth.data, &reference, layout, |a, b| (a - b).abs() > 0.002);
    assert_parity("depth", part, 1e-4);
    let class = npz::read::<u8>(&out, "class").data;
    let reference = npz::read::<u8>(&expected, "class_scene").data;
    assert_parity("class", differing(&class, &reference, layout, |a, b| a != b), 1e-4);
    let color = npz::read::<u8>(&out, "color").data;
    let reference = npz::read::<u8>(&expected, "color").data;
    let rgb = Layout { channels: 3, ..layout };
    assert_parity("color", differing(&color, &reference, rgb, |a, b| a.abs_diff(b) > 2), 1e-3);
    for (scale, name) in [(BinScale::Linear, "bins_linear"), (BinScale::Log, "bins_log")] {
        let bins = DepthBins { scale, far_m: 50.0, ..DepthBins::default() };
        let found: Vec<u16> = depth.data.iter().map(|d| bins.bin(*d)).collect();
        let reference = npz::read::<u16>(&expected, name).data;
        let part = differing(&found, &reference, layout, |a, b| a != b);
        assert_parity(name, part, 1e-4);
    }
    npz::read::<u32>(&out, "point").data
}
