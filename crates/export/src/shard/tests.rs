use super::*;
use crate::{Layout, SampleFormat, SampleTimes};
use point_skeleton::files::Inputs;

fn options(shard_frames: usize) -> ExportOptions {
    ExportOptions {
        layout: Layout::Frames,
        conditions: Default::default(),
        selection: Default::default(),
        substitutes: Default::default(),
        format: SampleFormat::Png,
        frames: None,
        shard_frames,
        images: false,
        times: SampleTimes::KeyFrames,
        color_folder: String::new(),
        validation_logs: Default::default(),
        prompt: Default::default(),
        captions: Default::default(),
    }
}

fn unit() -> WorkUnit {
    WorkUnit { name: "a-000000".into(), frames: 0..2 }
}

fn input() -> ShardInput {
    ShardInput { log: "1".into(), skeleton: Some("2".into()), map: None, templates: None }
}

fn record() -> ShardRecord {
    let (notes, files) = Default::default();
    let input = input();
    ShardRecord { name: unit().name, log: "a".into(), input, frames: [0, 2], samples: 2, notes, files }
}

#[test]
fn shards_are_published_atomically() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let find = |verify| ShardRecord::read(out, &unit(), Some(&input()), verify).unwrap();
    let mut shard = Shard::begin(out, &unit()).unwrap();
    shard.put("images/1.png", b"abc").unwrap();
    assert!(matches!(Shard::begin(out, &unit()), Err(FileError::Busy { .. })));
    assert!(!out.join("images").exists() && find(false).is_none());
    let written = shard.publish(record()).unwrap();
    // SHA-256 of "abc", from FIPS 180-2.
    let sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(written.files[0].sha256, sha256);
    assert_eq!(
        (find(true), std::fs::read(out.join("images/1.png")).unwrap()),
        (Some(written), b"abc".into())
    );
    SharedFolder::remove_work(out);
    assert_eq!(std::fs::read_dir(out).unwrap().count(), 2);
    // Damage: of the same length, then of another one.
    std::fs::write(out.join("images/1.png"), "abd").unwrap();
    assert!(find(false).is_some() && find(true).is_none());
    std::fs::write(out.join("images/1.png"), "ab").unwrap();
    assert!(find(false).is_none());
    std::fs::write(out.join("images/1.png"), "abc").unwrap();
    let longer = WorkUnit { frames: 0..3, ..unit() };
    let message = ShardRecord::read(out, &longer, None, false).unwrap_err().to_string();
    assert!(message.contains("of frames 0..3, found shard a-000000 of frames 0..2"), "{message}");
}

#[test]
fn rejects_shards_of_another_input() {
    let folder = tempfile::tempdir().unwrap();
    let mut shard = Shard::begin(folder.path(), &unit()).unwrap();
    shard.put("1.png", b"abc").unwrap();
    shard.publish(record()).unwrap();
    let read = |input: &ShardInput, verify| ShardRecord::read(folder.path(), &unit(), Some(input), verify);
    for (other, what) in [
        (ShardInput { log: "3".into(), ..input() }, "recording"),
        (ShardInput { skeleton: Some("3".into()), ..input() }, "skeleton"),
        (ShardInput { map: Some("3".into()), ..input() }, "HD map"),
        (ShardInput { templates: Some("3".into()), ..input() }, "template library"),
    ] {
        let message = read(&other, false).unwrap_err().to_string();
        let part = format!("a shard of this {what}, found one of another {what}");
        assert!(message.contains(&part), "{message}");
        assert!(read(&other, true).unwrap().is_none(), "written again");
    }
    assert!(read(&ShardInput { skeleton: None, ..input() }, false).unwrap().is_some());
}

/// Another process may have found no shard before this one began its first.
#[test]
fn rejects_publishing_with_other_options() {
    let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let out = folder.path();
    claim::claim(out, &options(2), &Inputs::default()).unwrap();
    claim::claim(other.path(), &options(9), &Inputs::default()).unwrap();
    let begin = || Shard::begin(out, &unit()).unwrap().with_options(&options(2));
    let mut shard = begin().unwrap();
    shard.put("1.png", b"abc").unwrap();
    std::fs::copy(other.path().join(SharedFolder::OPTIONS), out.join(SharedFolder::OPTIONS)).unwrap();
    let message = shard.publish(record()).unwrap_err().to_string();
    assert!(message.contains("--shard-frames 2, found --shard-frames 9"), "{message}");
    assert!(!out.join("1.png").exists() && begin().is_err());
}

#[test]
fn records_need_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shards/a-000000.json");
    std::fs::create_dir(folder.path().join("shards")).unwrap();
    let read = || ShardRecord::read(folder.path(), &unit(), Some(&input()), false);
    write_json(&path, &record()).unwrap();
    assert!(read().unwrap().is_none());
    let file = ShardFile { path: "../x".into(), bytes: 0, sha256: String::new() };
    write_json(&path, &ShardRecord { files: vec![file], ..record() }).unwrap();
    assert!(read().unwrap_err().to_string().contains("expected paths below the export"));
    std::fs::write(&path, "{}").unwrap();
    assert!(read().unwrap_err().to_string().starts_with("expected the record of a shard"));
    std::fs::write(&path, "").unwrap();
    assert!(read().unwrap().is_none());
    std::fs::remove_file(&path).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    assert!(read().unwrap_err().to_string().contains("found a FIFO"));
}

#[test]
fn an_unfinished_shard_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut shard = Shard::begin(folder.path(), &unit()).unwrap();
    shard.put("a/b.json", b"{}").unwrap();
    drop(shard);
    SharedFolder::remove_work(folder.path());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
