//! A skeleton on disk: writing and reading it, and errors of damaged ones.

use std::path::Path;

use point_skeleton::cloud::{Bounds, Point};
use point_skeleton::error::FileError;
use point_skeleton::files::Checksum;
use point_skeleton::skeleton::{BuildOptions, BuildReport, Chunk, Skeleton, SkeletonWriter};

fn chunk() -> (Chunk, Vec<Point>) {
    let points: Vec<Point> = (0..10).map(|i| Point::new([i as f32, 0.5, -1.0], [i, 2, 3], 0)).collect();
    let bounds = Bounds::of(&points).unwrap();
    let (origin, xxh3) = ([664_416.0, 3_997_632.0, 0.1 + 0.2], Checksum::of(&points));
    (Chunk { origin, points: points.len(), bounds, xxh3 }, points)
}

fn write(path: &Path) -> Result<(), FileError> {
    let (chunk, points) = chunk();
    SkeletonWriter::write(path, |writer| {
        writer.chunk(chunk, &points)?;
        writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
    })
}

fn refused(folder: &Path, damage: impl Fn(&Path), words: &[&str]) {
    let path = folder.join("s");
    write(&path).unwrap();
    damage(&path);
    let message = Skeleton::open(&path).unwrap_err().to_string();
    for word in words {
        assert!(message.contains(word), "{word:?} in {message:?}");
    }
}

#[test]
fn a_skeleton_is_read_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/er/s");
    write(&path).unwrap();
    write(&path).unwrap(); // replaces the older one
    let skeleton = Skeleton::open(&path).unwrap();
    let (chunk, points) = chunk();
    assert_eq!(skeleton.manifest.background, [chunk]);
    assert_eq!(skeleton.background().unwrap(), [points.as_slice()]);
    assert!(skeleton.actors().unwrap().is_empty() && skeleton.templates().unwrap().is_empty());
    let names = std::fs::read_dir(path.parent().unwrap()).unwrap();
    assert_eq!(names.count(), 1, "nothing temporary is left");
}

#[test]
fn damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let cut = |path: &Path| {
        let file = std::fs::File::options().write(true).open(path.join("background.points")).unwrap();
        file.set_len(150).unwrap();
    };
    refused(folder.path(), cut, &["expected 160 bytes (10 points)", "found 150 bytes", "background.points"]);
    let other = |path: &Path| {
        let file = path.join("skeleton.json");
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(file, text.replace("\"version\": 4", "\"version\": 3")).unwrap();
    };
    refused(
        folder.path(),
        other,
        &[
            "version 4",
            "found format \"point-skeleton\" version 3 (written by an earlier version",
            "skeleton.json",
        ],
    );
    let broken = |path: &Path| std::fs::write(path.join("skeleton.json"), "{").unwrap();
    refused(folder.path(), broken, &["a skeleton manifest", "skeleton.json"]);
    let missing = |path: &Path| std::fs::remove_file(path.join("actors.points")).unwrap();
    refused(folder.path(), missing, &["cannot read", "actors.points"]);
    let huge = |path: &Path| {
        let file = path.join("skeleton.json");
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(file, text.replace("\"points\": 10", "\"points\": 18446744073709551615")).unwrap();
    };
    refused(folder.path(), huge, &["found 160 bytes", "background.points"]);
}

#[test]
fn a_folder_with_other_content_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("thesis.tex"), "years of work").unwrap();
    let message = write(folder.path()).unwrap_err().to_string();
    assert!(message.contains("expected only files that pskel wrote"), "{message}");
    assert!(folder.path().join("thesis.tex").is_file());
}
