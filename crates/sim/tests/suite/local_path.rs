use std::path::Path;
use std::time::Instant;

use npyz::WriterBuilder;
use pskel_sim::{EgoPolicy, LocalPath, LocalPathError, PathAnchor, SimOptions};
use pskel_testing::winding_road;

const POINTS: [[f64; 2]; 3] = [[0.0, 0.0], [5.5, -0.25], [1e1, 1.0]];

fn read(folder: &Path, name: &str, content: &[u8]) -> Result<LocalPath, LocalPathError> {
    let path = folder.join(name);
    std::fs::write(&path, content).unwrap();
    LocalPath::read(&path)
}

fn npy<T: npyz::AutoSerialize + Copy>(order: npyz::Order, shape: &[u64], numbers: &[T]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = npyz::WriteOptions::new().default_dtype().shape(shape).order(order);
    let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
    writer.extend(numbers.iter().copied()).unwrap();
    writer.finish().unwrap();
    bytes
}

#[test]
fn reads_all_forms() {
    let folder = tempfile::tempdir().unwrap();
    let flat: Vec<f64> = POINTS.as_flattened().to_vec();
    let columns: Vec<f64> = [0, 1].iter().flat_map(|i| POINTS.map(|p| p[*i])).collect();
    let single: Vec<f32> = flat.iter().map(|n| *n as f32).collect();
    let files: [(&str, Vec<u8>); 10] = [
        ("a.json", b"[[0, 0], [5.5, -0.25], [10.0, 1]]".to_vec()),
        ("b.json", b" {\"points\": [[0, 0], [5.5, -0.25], [1e1, 1]], \"name\": \"x\"}".to_vec()),
        ("c.csv", b"0,0\n5.5,-0.25\n10,1\n".to_vec()),
        ("d.csv", b"\xef\xbb\xbfx,y\r\n0,0\r\n5.5,-0.25\r\n1e1,1\r\n".to_vec()),
        ("e.txt", b"# x y\n0 0\n\n  5.5\t-0.25 # bend\n10 1".to_vec()),
        ("f.CSV", b"x;y\n0;0\n5.5;-0.25\n10;1\n".to_vec()),
        ("g.npy", npy(npyz::Order::C, &[3, 2], &flat)),
        ("h.npy", npy(npyz::Order::Fortran, &[3, 2], &columns)),
        ("i.npy", npy(npyz::Order::C, &[3, 2], &single)),
        ("j.tsv", b"0\t0\n5.5\t-0.25\n10\t1\n".to_vec()),
    ];
    for (name, content) in files {
        assert_eq!(read(folder.path(), name, &content).unwrap().points(), POINTS, "{name}");
    }
}

#[test]
fn rejects_invalid_paths_and_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let cut = |mut bytes: Vec<u8>| {
        bytes.truncate(bytes.len() - 1);
        bytes
    };
    let files: [(&str, Vec<u8>, &str); 18] = [
        ("one.json", b"[[1, 2]]".to_vec(), "found 1"),
        ("none.json", b"[]".to_vec(), "found 0"),
        ("same.json", b"[[1, 2], [1, 2]]".to_vec(), "with a length"),
        ("three.json", b"[[1, 2, 3], [1, 2, 3]]".to_vec(), "[x, y]"),
        ("text.json", b"hello".to_vec(), "[x, y]"),
        ("null.json", b"[[1, null], [2, 3]]".to_vec(), "[x, y]"),
        ("far.json", b"[[1, 2], [1e300, 2]]".to_vec(), "point 1"),
        ("deep.json", vec![b'['; 100_000], "[x, y]"),
        ("nan.csv", b"1,2\nnan,3\n".to_vec(), "point 1"),
        ("three.csv", b"1,2\n1,2,3\n".to_vec(), "line 2"),
        ("words.csv", b"1,2\nx,y\n".to_vec(), "line 2"),
        ("headers.csv", b"x,y\nx,y\n1,2\n3,4\n".to_vec(), "line 2"),
        ("bytes.txt", vec![0xff, 0xfe, 0x31], "text"),
        ("flat.npy", npy(npyz::Order::C, &[4], &[1.0, 2.0, 3.0, 4.0]), "[N, 2]"),
        ("three.npy", npy(npyz::Order::C, &[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), "[N, 2]"),
        ("int.npy", npy(npyz::Order::C, &[2, 2], &[1i64, 2, 3, 4]), "i8"),
        ("cut.npy", cut(npy(npyz::Order::C, &[2, 2], &[1.0, 2.0, 3.0, 4.0])), "32 bytes"),
        ("a.xml", b"<a/>".to_vec(), ".json"),
    ];
    for (name, content, part) in files {
        let error = read(folder.path(), name, &content).unwrap_err().to_string();
        assert!(error.contains(part) && error.ends_with(name), "{error}\nexpected {part}");
    }
    let missing = LocalPath::read(&folder.path().join("missing.json")).unwrap_err().to_string();
    assert!(missing.contains("cannot read"), "{missing}");
    // A header that declares more rows than the file has.
    let mut bytes = npy(npyz::Order::C, &[2, 2], &[1.0, 2.0, 3.0, 4.0]);
    let at = bytes.windows(5).position(|w| w == b"(2, 2").unwrap();
    bytes[at..at + 5].copy_from_slice(b"(9, 2");
    assert!(read(folder.path(), "more.npy", &bytes).is_err());
}

#[test]
fn a_million_points_are_fast() {
    let points: Vec<[f64; 2]> =
        (0..1_000_000).map(|i| [f64::from(i) * 1e-3, (f64::from(i) * 1e-5).sin()]).collect();
    let folder = tempfile::tempdir().unwrap();
    let text: String = points.iter().map(|[x, y]| format!("{x},{y}\n")).collect();
    let start = Instant::now();
    let path = read(folder.path(), "long.csv", text.as_bytes()).unwrap();
    let log = winding_road::log(1);
    let options =
        SimOptions { steps: 100, ego: EgoPolicy::File(path, PathAnchor::Takeover), ..SimOptions::default() };
    let mut sim = winding_road::start(&log, &options);
    while sim.step().unwrap().is_some() {}
    assert_eq!(sim.committed().get().step, 100);
    let seconds = start.elapsed().as_secs_f64();
    assert!(seconds < 20.0, "{seconds} s");
}
