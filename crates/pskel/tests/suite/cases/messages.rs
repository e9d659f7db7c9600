//! What is wrong with a file, in words that name the cause: numbers that JSON lacks, other encodings, empty
//! files and pointers, Windows' names, map records without a shape, drivers that the environment names.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use super::Case;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{HEIGHT, PSKEL, TinyLog, WIDTH, assert_failed, picture, sweep};
use pskel_testing::nuplan_log::NuplanLog;

/// Edits the text of a table.
fn edit(log: &TinyLog, table: &str, edit: impl FnOnce(String) -> Vec<u8>) {
    let path = log.path(&format!("log/v1.0-mini/{table}.json"));
    std::fs::write(&path, edit(std::fs::read_to_string(&path).unwrap())).unwrap();
}

fn info(log: &TinyLog) -> (i32, String) {
    let output = log.run("info nuscenes:log");
    let text = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(text).unwrap())
}

#[test]
fn non_json_numbers_are_named_where_they_are_read() {
    let Some(case) = Case::new("data/08-nan-in-unread-field") else { return };
    case.succeed("info nuscenes:in/unread");
    let text = std::fs::read_to_string(case.path().join("in/read/v1.0-mini/sample_annotation.json")).unwrap();
    let records: Value = serde_json::from_str(&text.replace("NaN", "0")).unwrap();
    let token = records[5]["token"].as_str().unwrap();
    let found = format!("found NaN instead of a number in size[0] of record {token}: ");
    case.run("info nuscenes:in/read").refused("read", &[&found, "sample_annotation.json"]);
}

#[test]
fn tables_of_other_writers_are_read_or_named() {
    for table in ["scene", "sample", "sample_data", "sample_annotation", "ego_pose", "calibrated_sensor"] {
        let log = TinyLog::new();
        for word in ["NaN", "-Infinity", "nan"] {
            edit(&log, table, |text| text.replacen('{', &format!("{{\"unread\": [{word}], "), 2).into());
        }
        edit(&log, table, |text| [b"\xef\xbb\xbf", text.as_bytes()].concat());
        let (code, text) = info(&log);
        assert_eq!(code, 0, "{table}: {text}");
        for (content, found) in [
            (&b""[..], "found an empty file: "),
            (b"\xff\xfe[\0]\0", "found UTF-16 text (save it as UTF-8): "),
            (b"\x1f\x8b\x08\0\0\0\0\0", "found gzip-compressed data (unpack it): "),
            (b"<!doctype html><html>Quota exceeded</html>", "found an HTML page (a failed download?): "),
            (b"<?xml version='1.0'?><Error><Code>AccessDenied</Code></Error>", "found an XML error page"),
            (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", "`git lfs pull`"),
            (b"/annex/objects/SHA256E-s1--a.json\n", "`git annex get`"),
            (
                b"{\"token\": \"a\"}\n{\"token\": \"b\"}\n",
                "instead of an array (JSON lines? write one array): ",
            ),
        ] {
            std::fs::write(log.path(&format!("log/v1.0-mini/{table}.json")), content).unwrap();
            let (code, text) = info(&log);
            assert!(code == 1 && text.contains(found) && text.contains(table), "{table}: {text}");
            assert!(!text.contains("expected value") && !text.contains("EOF"), "{table}: {text}");
        }
    }
    let log = TinyLog::new();
    let token = log.json("log/v1.0-mini/sample_annotation.json")[1]["token"].clone();
    let token = token.as_str().unwrap();
    for (from, to, found) in [
        (
            "\"size\":[",
            "\"size\":[NaN,",
            format!("found NaN instead of a number in size[0] of record {token}"),
        ),
        ("\"size\":", "\"sizes\":", format!("no field size in record {token}")),
        ("\"size\":[", "'size':[", "single quotes instead of double quotes".to_owned()),
    ] {
        let log = TinyLog::new();
        let place = format!("\"token\":\"{token}\"");
        edit(&log, "sample_annotation", |text| {
            let start = text[..text.find(&place).unwrap()].rfind('{').unwrap();
            let (head, tail) = text.split_at(start);
            [head, &tail.replacen(from, to, 1)].concat().into()
        });
        let (code, text) = info(&log);
        assert!(code == 1 && text.contains(&found), "{text}\nexpected {found}");
    }
}

#[test]
fn empty_files_and_pointers_are_named() {
    let Some(case) = Case::new("data/14-empty-or-pointer-file") else { return };
    for (name, found) in
        [("empty", "found an empty file: "), ("pointer", "found a Git LFS pointer (`git lfs pull`")]
    {
        let ended = case.run(&format!("info nuscenes:in/{name}"));
        let text = ended.stdout + &ended.stderr;
        assert!(text.contains(found) && text.contains("CAM_FRONT"), "{name}: {text}");
    }
    let db = "in/empty-log/nuplan-v1.1/splits/mini/2020.01.01.00.00.00_veh-02_00000_00079.db";
    let parts = ["expected a SQLite database, found an empty file: ", ".db"];
    case.run(&format!("info nuplan:{db}")).refused("empty log", &parts);
}

/// The same words for every kind of file.
#[test]
fn undownloaded_files_are_named_in_every_reader() {
    let lfs = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n";
    let html = b"<html><head><title>404 Not Found</title></head></html>";
    for (content, found) in [(&lfs[..], "found a Git LFS pointer"), (html, "found an HTML page")] {
        for file in [sweep(1), picture(1, "CAM_BACK")] {
            let log = TinyLog::new();
            std::fs::write(log.path(&file), content).unwrap();
            let (_, text) = info(&log);
            assert!(text.contains(found) && text.contains(&file), "{file}: {text}");
        }
        let nuplan = NuplanLog::new();
        std::fs::write(nuplan.map(), content).unwrap();
        let message = nuplan.open().unwrap().read_map_error();
        assert!(message.contains(found) && message.ends_with("map.gpkg"), "{message}");
        std::fs::write(nuplan.database(), content).unwrap();
        let message = nuplan.open().unwrap_err().to_string();
        assert!(message.contains(found) && message.ends_with(".db"), "{message}");
        let log = TinyLog::new();
        for name in ["a.npy", "a.ply", "a.json"] {
            std::fs::write(log.path(name), content).unwrap();
        }
        let splat = |points: &str| log.run(&format!("splat --points {points} --cameras a.json --out a.npz"));
        assert_failed(&splat("a.npy"), 1, &[found]);
        assert_failed(&splat("a.ply"), 1, &[found]);
    }
    // Other formats in place of an image.
    for (content, found) in [
        (&b"RIFF\0\0\0\0WEBPVP8 "[..], "found a WebP image (convert it to JPEG or PNG)"),
        (b"{\"detail\": \"Not found.\"}", "found text that begins with \"{\\\"detail\\\""),
        (&[0; 400], "found zero bytes (a download that was cut off?)"),
    ] {
        let log = TinyLog::new();
        std::fs::write(log.path(&picture(0, "CAM_FRONT")), content).unwrap();
        let (_, text) = info(&log);
        assert!(text.contains(found), "{text}");
    }
}

#[test]
fn truncated_files_are_named() {
    let log = TinyLog::new();
    let (image, mut jpeg) = (image::RgbImage::new(WIDTH, HEIGHT), std::io::Cursor::new(Vec::new()));
    image.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    let file = picture(1, "CAM_BACK");
    for (content, is_whole) in [(&jpeg[..], true), (&jpeg[..jpeg.len() - 2], false), (&jpeg[..100], false)] {
        std::fs::write(log.path(&file), content).unwrap();
        std::fs::write(log.path("a.jpg"), content).unwrap();
        let (code, text) = info(&log);
        let alone = log.run("info a.jpg");
        assert_eq!((code, alone.status.code()), if is_whole { (0, Some(0)) } else { (1, Some(1)) }, "{text}");
        if !is_whole {
            let found = format!("found {} bytes without an end marker (cut off)", content.len());
            assert!(text.contains(&found) && text.contains(&file), "{text}");
            assert_failed(&alone, 1, &[&found, "a.jpg"]);
        }
    }
    for bytes in [100, 8192] {
        let nuplan = NuplanLog::new();
        let cut = |path: &Path| {
            let length = std::fs::metadata(path).unwrap().len();
            std::fs::OpenOptions::new().write(true).open(path).unwrap().set_len(bytes).unwrap();
            format!("found {bytes} of at least {length} bytes (cut off): ")
        };
        let found = cut(&nuplan.map());
        let message = nuplan.open().unwrap().read_map_error();
        assert!(message.contains(&found) && message.ends_with("map.gpkg"), "{message}");
        let found = cut(&nuplan.database());
        nuplan.refuses(&[&found]);
    }
}

#[test]
fn tables_of_other_shapes_are_named() {
    type Edit = fn(String) -> Vec<u8>;
    let edits: [(&str, Edit, &str); 6] = [
        ("category", |text| format!("{{\"data\": {text}}}").into(), "its field data holds the records?"),
        ("sample_data", |text| format!("{{\"data\": {text}}}").into(), "its field data holds the records?"),
        ("sample_data", |text| text.encode_utf16().flat_map(u16::to_le_bytes).collect(), "found UTF-16 text"),
        ("scene", |_| b"[]".to_vec(), "expected at least one scene, found none"),
        ("sensor", |_| b"404: Not Found".to_vec(), "found text that begins with \"404: Not Found\""),
        ("sample_data", |text| text.replacen('{', "{\"note\": 0x1F, ", 1).into(), "a hexadecimal number"),
    ];
    for (table, change, found) in edits {
        let log = TinyLog::new();
        edit(&log, table, change);
        let (code, text) = info(&log);
        assert!(code == 1 && text.contains(found) && text.contains(table), "{table}: {text}");
    }
}

trait MapError {
    fn read_map_error(&self) -> String;
}

impl<D: point_skeleton::dataset::LogReader> MapError for D {
    fn read_map_error(&self) -> String {
        self.read_map().unwrap_err().to_string()
    }
}

#[test]
fn windows_separators_are_read() {
    let Some(case) = Case::new("data/15-backslashes") else { return };
    let (shown, _) = case.succeed("info nuscenes:in --json");
    let shown: Value = serde_json::from_str(&shown).unwrap();
    assert_eq!(shown["damaged"], json!([]));
    assert_eq!(shown["cameras"][0]["images"], json!(4));
}

#[test]
fn names_of_windows_cannot_leave_the_folder() {
    for (name, found) in [
        (r"..\..\x.png", "expected a path below the data set's folder"),
        (r"samples\..\..\x.png", "expected a path below the data set's folder"),
        (r"\\server\share\x.png", "expected a path below the data set's folder"),
        (r"C:\data\x.png", "without a drive of Windows as filename of sample_data"),
    ] {
        let log = TinyLog::new();
        log.change("sample_data", "/0/filename", json!(name));
        let (code, text) = info(&log);
        assert!(code == 1 && text.contains(found) && text.contains("filename of sample_data"), "{text}");
    }
}

#[test]
fn map_records_without_a_shape_do_not_invalidate_the_map() {
    let Some(case) = Case::new("data/16-degenerate-map-record") else { return };
    for (name, note, counts) in [
        ("no-corners", "map: stop lines without an area (skipped)", [8, 5, 2, 0]),
        ("two-corners", "map: lanes without an area (skipped)", [7, 5, 2, 1]),
        ("one-node-line", "map: dividers without a length (skipped)", [8, 4, 2, 1]),
        ("no-polygon", "map: crossings that refer to a missing record (skipped)", [8, 5, 1, 1]),
    ] {
        let (shown, _) = case.succeed(&format!("info nuscenes:in/{name} --json"));
        let shown: Value = serde_json::from_str(&shown).unwrap();
        assert_eq!(shown["left_out"][note], json!(1), "{name}: {}", shown["left_out"]);
        let of = |layer: &str| shown["map"][layer].as_u64().unwrap();
        assert_eq!([of("lanes"), of("dividers"), of("crossings"), of("stop_lines")], counts, "{name}");
        assert_eq!(shown["damaged"], json!([]), "{name}");
    }
}

#[test]
fn json_options_name_field_and_value() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let path = |content: &str| {
        std::fs::write(log.path("path.json"), content).unwrap();
        log.run(
            "simulate nuscenes:log --skeleton sk --out run --ego file --trajectory path.json --steps 2 \
            --rasterizer cpu",
        )
    };
    let expected = "expected a list of [x, y] or {\"points\": [[x, y], ..]}, found ";
    for (content, found) in [
        ("[[0, 0], [1, \"a\"]]", "\"a\" instead of a number in [1][1]: "),
        ("{\"points\": [[0, 0], [1]]}", "1 elements instead of an array of length 2 in points[1]: "),
        ("{\"path\": []}", "no field points: "),
        ("[[0, 0], [NaN, 1]]", "NaN instead of a number in [1][0]: "),
        ("", "an empty file: "),
    ] {
        assert_failed(&path(content), 1, &[&format!("{expected}{found}"), "path.json"]);
    }
    for (file, args) in [
        (
            "notes.json",
            "render nuscenes:log --skeleton sk --out maps --rasterizer cpu --annotations notes.json",
        ),
        ("c.json", "splat --points a.npy --cameras c.json --out a.npz"),
    ] {
        std::fs::write(log.path(file), "{\"weather\": 5, \"cameras\": 5}").unwrap();
        let output = log.run(args);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(text.contains("found 5 instead of ") && text.contains(file), "{text}");
    }
}

#[test]
fn drivers_of_the_environment_are_named() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        let mut command = Command::new(PSKEL);
        command.current_dir(log.path("")).env_remove("VK_DRIVER_FILES").env_remove("VK_ICD_FILENAMES");
        command.env(variable, "/nowhere/driver.json").env("PSKEL_VALIDATION", "0");
        let args = "render nuscenes:log --skeleton sk --out maps --rasterizer compute";
        let output = command.args(args.split(' ')).output().unwrap();
        let found = format!("found no driver ({variable} names /nowhere/driver.json, which does not exist");
        assert_failed(&output, 1, &[&found]);
    }
}

#[test]
fn invalid_sizes_and_focal_lengths_name_their_record() {
    let log = TinyLog::new();
    log.change("sample_data", "/1/width", json!(20_000));
    let (code, text) = info(&log);
    assert!(code == 1 && text.contains("sample_data.json"), "{text}");
    assert!(text.contains(" in sample_data ") && !text.contains("calibrated_sensor"), "{text}");
    for focal in [-1e308, 1e308] {
        let log = TinyLog::new();
        log.change("calibrated_sensor", "/1/camera_intrinsic/0/0", json!(focal));
        let (code, text) = info(&log);
        let found = format!("focal lengths above 0 and up to 1e9 pixels, found fx {focal:?}, fy ");
        assert!(code == 1 && text.contains(&found) && text.contains("calibrated_sensor.json"), "{text}");
    }
}

#[test]
fn scenes_with_the_same_name_are_selected_by_token() {
    let log = TinyLog::new();
    let mut scenes = log.json("log/v1.0-mini/scene.json");
    let mut other = scenes[0].clone();
    other["token"] = json!("other");
    let token = scenes[0]["token"].as_str().unwrap().to_owned();
    scenes.as_array_mut().unwrap().push(other);
    log.write_table("scene", &scenes);
    let output = log.run("info nuscenes:log#tiny");
    let names =
        format!("expected #SCENE to name one of other (named tiny), {token} (named tiny), found tiny");
    assert_failed(&output, 1, &[&names]);
    assert!(log.run(&format!("info nuscenes:log#{token}")).status.success());
}

#[test]
fn values_of_recipes_and_large_maps_are_named() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    std::fs::write(log.path("recipe.json"), r#"{"size": "1600"}"#).unwrap();
    let output = log.run(
        "generate nuscenes:log --skeleton sk --out new --generator fill --recipe recipe.json --maps color \
            --rasterizer cpu",
    );
    let found = "expected a recipe of conditions, found \"1600\" instead of a size HxW of 1 to 16384 pixels, \
                 like 256x448 in size";
    assert_failed(&output, 1, &[found, "recipe.json"]);
    let mut render = Command::new(PSKEL);
    render.current_dir(log.path("")).env("PSKEL_MEMORY", "1G");
    render.args(
        "render nuscenes:log --skeleton sk --out new --out-size 16384x16384 --rasterizer cpu".split(' '),
    );
    let output = render.output().unwrap();
    assert_failed(&output, 1, &["pixels for maps of 16384x16384 needs ", " GiB of memory"]);
    // The images, which are all of another size, are the reason.
    for record in 0..3 * 3 {
        for side in ["width", "height"] {
            log.change("sample_data", &format!("/{record}/{side}"), json!(1600));
        }
    }
    let output = log.run("build nuscenes:log --out new");
    assert_failed(&output, 1, &["that an image colors", "and 0 images (", "6 damaged image files"]);
}
