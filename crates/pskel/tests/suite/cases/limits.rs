//! Resources that run out: threads that the system refuses, and memory by sizes that small files declare.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{INTRINSICS, PSKEL, TinyLog, assert_failed, tree};
use pskel_testing::shared::skip;

const LOG: &str = "nuscenes:log@v1.0-mini";
/// A hang is reported after this time.
const MAX_TIME: Duration = Duration::from_secs(60);

/// Control group with a limit on processes and threads, removed on drop.
struct FewProcesses(PathBuf);

impl FewProcesses {
    /// Creates a group; `None` where control groups cannot be created.
    fn new(most: usize) -> Option<Self> {
        let name = format!("pskel-test-{}-{most}", std::process::id());
        ["/sys/fs/cgroup/pids", "/sys/fs/cgroup"].iter().find_map(|root| {
            let group = Path::new(root).join(&name);
            std::fs::create_dir(&group).ok()?;
            let group = Self(group);
            std::fs::write(group.0.join("pids.max"), most.to_string()).ok()?;
            Some(group)
        })
    }
}

impl Drop for FewProcesses {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.0);
    }
}

/// Runs a shell script, and kills it after [`MAX_TIME`].
fn run_within_time(folder: &Path, script: &str) -> Output {
    let mut command = Command::new("sh");
    command
        .arg("-c")
        .arg(script)
        .current_dir(folder)
        .env("RAYON_NUM_THREADS", "2")
        .env("LP_NUM_THREADS", "2");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let (mut child, start) = (command.spawn().unwrap(), Instant::now());
    while child.try_wait().unwrap().is_none() && start.elapsed() < MAX_TIME {
        std::thread::sleep(Duration::from_millis(5));
    }
    let _ = child.kill(); // fails if it has ended
    child.wait_with_output().unwrap()
}

/// Asserts that a run has succeeded, or was refused in one line that names what to set.
#[track_caller]
fn assert_ran_or_refused(output: &Output, what: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    match output.status.code() {
        Some(0) => {}
        Some(1) => {
            assert_eq!(stderr.lines().count(), 1, "{what}: {stderr}");
            for part in ["error: ", "cannot start ", "RAYON_NUM_THREADS=1", "LP_NUM_THREADS=1", "pids.max"] {
                assert!(stderr.contains(part), "{what}: {stderr}\nexpected {part}");
            }
        }
        other => panic!("{what}: {other:?}, {stderr}"),
    }
}

fn log_with_skeleton() -> TinyLog {
    let log = TinyLog::new();
    log.succeed(&format!("build {LOG} --out sk"));
    log
}

/// The command takes 2 threads beside the pool, with the writer 3; the driver 6. Between the two numbers of a
/// rasterizer, a run succeeds only if a thread of the start ends before the last one begins.
#[test]
fn a_process_limit_is_reported_in_one_line() {
    let log = log_with_skeleton();
    for (kind, refused_to, runs_from) in
        [("cpu", 4, 5), ("auto", 4, 5), ("compute", 8, 11), ("graphics", 8, 11)]
    {
        for processes in [1, 3, 4, 5, 6, 8, 10, 14] {
            let Some(group) = FewProcesses::new(processes) else { return skip("control groups") };
            let script = format!(
                "echo $$ > {}/cgroup.procs; exec {PSKEL} render {LOG} --skeleton sk --out \
                    out/{kind}{processes} --frames 0..1 \
                 --out-size 14x25 --rasterizer {kind}",
                group.0.display()
            );
            let output = run_within_time(&log.path(""), &script);
            let what = format!("{processes} processes, {kind}");
            assert_ran_or_refused(&output, &what);
            let runs = output.status.success();
            assert!(if runs { processes > refused_to } else { processes < runs_from }, "{what}: {output:?}");
        }
    }
    let Some(group) = FewProcesses::new(5) else { return skip("control groups") };
    let planner = "simulate nuscenes:log@v1.0-mini --skeleton sk --out out/sim --steps 1 --dry --ego \
        external --planner cat";
    let output = run_within_time(
        &log.path(""),
        &format!("echo $$ > {}/cgroup.procs; exec {PSKEL} {planner}", group.0.display()),
    );
    assert_ran_or_refused(&output, planner);
    assert_eq!(output.status.code(), Some(1));
}

/// `ulimit -u` counts all processes of a user, so another user is needed; root is not limited.
#[test]
fn a_user_process_limit_is_reported_in_one_line() {
    let log = log_with_skeleton();
    for folder in ["", "out"] {
        let everyone = std::os::unix::fs::PermissionsExt::from_mode(0o777);
        std::fs::set_permissions(log.path(folder), everyone).unwrap();
    }
    for (processes, user, command) in [
        (2, 54_321, format!("build {LOG} --out out/sk")),
        (3, 54_322, format!("info {LOG}")),
        (4, 54_323, format!("render {LOG} --skeleton sk --out out/maps --rasterizer cpu")),
        (7, 54_324, format!("render {LOG} --skeleton sk --out out/compute --rasterizer compute")),
    ] {
        let as_user = format!("setpriv --reuid {user} --clear-groups --inh-caps=-all --bounding-set=-all");
        if !run_within_time(&log.path(""), &format!("{as_user} test -x {PSKEL}")).status.success() {
            return skip("setpriv and another user");
        }
        let script = format!("exec {as_user} prlimit --nproc={processes} {PSKEL} {command}");
        let output = run_within_time(&log.path(""), &script);
        assert_ran_or_refused(&output, &command);
        assert_eq!(output.status.code(), Some(1), "{command}");
        assert_eq!(tree(&log.path("out")).len(), 0);
    }
}

/// A run that can open few files ends with an error, and leaves nothing that later runs take for a foreign
/// folder.
#[test]
fn a_limit_on_open_files_leaves_the_output_usable() {
    let log = log_with_skeleton();
    let args = format!("simulate {LOG} --skeleton sk --out out --maps depth --rasterizer cpu --steps 1");
    for limit in 5..16 {
        let script = format!("ulimit -n {limit}; exec {PSKEL} {args}");
        let output = run_within_time(&log.path(""), &script);
        let stderr = String::from_utf8_lossy(&output.stderr);
        // 127: the program itself cannot be loaded.
        assert!(matches!(output.status.code(), Some(0 | 1 | 127)), "{limit}: {:?}: {stderr}", output.status);
        assert!(!stderr.contains("panicked"), "{limit}: {stderr}");
    }
    log.succeed(&args);
}

/// Writes cameras of a size, as in files of `--cameras`.
fn write_cameras(log: &TinyLog, count: usize, side: u32) {
    let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
    let camera = |i: usize| {
        json!({"name": format!("c{i}"), "width": side, "height": side,
        "intrinsics": INTRINSICS, "camera_from_world": pose})
    };
    let cameras: Vec<_> = (0..count).map(camera).collect();
    std::fs::write(log.path("cameras.json"), json!({"cameras": cameras}).to_string()).unwrap();
}

#[test]
fn rejects_camera_lists_that_need_terabytes() {
    let log = log_with_skeleton();
    std::fs::write(
        log.path("points.ply"),
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty \
         float z\nend_header\n0 0 5\n",
    )
    .unwrap();
    let render = format!("render {LOG} --skeleton sk --out maps --frames 0..1 --rasterizer cpu");
    log.succeed(&format!("{render} --out-size 14x25"));
    let before = tree(&log.path("maps"));
    write_cameras(&log, 300, 16_384);
    assert!(std::fs::metadata(log.path("cameras.json")).unwrap().len() < 70_000);
    let needs = [
        "300 views of up to 16384x16384 pixels needs ",
        " TiB of memory, but ",
        "--out-size",
        "PSKEL_MEMORY=8G",
    ];
    let with_little = |args: &str| {
        let script = format!("PSKEL_MEMORY=8G exec {PSKEL} {args}");
        assert_failed(&run_within_time(&log.path(""), &script), 1, &needs);
    };
    with_little(&format!("{render} --cameras cameras.json"));
    // An earlier output stays complete.
    assert!(tree(&log.path("maps")) == before);
    let splat = "splat --points points.ply --cameras cameras.json --out out/a.npz --rasterizer cpu";
    with_little(splat);
    // Drawn in strips, few pixels are written.
    write_cameras(&log, 3, 16_384);
    log.succeed(&format!("{splat} --out-size 256x256"));
}

#[test]
fn rejects_huge_sizes_in_tables() {
    let log = log_with_skeleton();
    for record in 0..3 * 3 {
        for side in ["width", "height"] {
            log.change("sample_data", &format!("/{record}/{side}"), 16_384.into());
        }
    }
    let limited = |args: &str, memory: &str| {
        let mut command = Command::new(PSKEL);
        command.current_dir(log.path("")).args(args.split(' ')).env("PSKEL_MEMORY", memory).output().unwrap()
    };
    let needs =
        ["views of up to 16384x16384 pixels needs ", " GiB of memory, but ", "limited by PSKEL_MEMORY"];
    let render = format!("render {LOG} --skeleton sk --out out/maps --rasterizer cpu");
    assert_failed(&limited(&render, "2G"), 1, &needs);
    let simulate = format!(
        "simulate {LOG} --skeleton sk --out out/rollout --steps 1 --size 16384x16384 --rasterizer cpu"
    );
    assert_failed(&limited(&simulate, "2G"), 1, &needs);
    let bench = format!("bench {LOG} --skeleton sk --frames 0..1 --repeat 1 --warm-up 0 --rasterizer cpu");
    assert_failed(&limited(&bench, "2G"), 1, &needs);
    assert_failed(
        &limited(&render, "lots"),
        2,
        &["expected a size in PSKEL_MEMORY, like 8G or 512M, found \"lots\""],
    );
    // Images whose header declares the size, of few bytes.
    for (path, _) in tree(&log.path("log/samples")).iter().filter(|(path, _)| path.ends_with(".png")) {
        std::fs::write(log.path("log/samples").join(path), png_header(16_384)).unwrap();
    }
    let build = format!("build {LOG} --out out/sk");
    let image = [
        "cannot decode: an image of 16384x16384 pixels needs 768.0 MiB of memory",
        "limited by PSKEL_MEMORY",
        ".png",
    ];
    assert_failed(&limited(&build, "500M"), 1, &image);
}

/// A PNG file that ends after its header.
fn png_header(side: u32) -> Vec<u8> {
    let (mut file, image) = (Vec::new(), image::RgbImage::new(2, 2));
    image.write_to(&mut std::io::Cursor::new(&mut file), image::ImageFormat::Png).unwrap();
    // Signature, length and type precede the size; a checksum follows the 13 bytes.
    file[16..20].copy_from_slice(&side.to_be_bytes());
    file[20..24].copy_from_slice(&side.to_be_bytes());
    let crc = file[12..29].iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(
            crc ^ u32::from(*byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 },
        )
    });
    file[29..33].copy_from_slice(&(!crc).to_be_bytes());
    file
}

#[test]
fn rejects_recipes_of_huge_images() {
    let log = log_with_skeleton();
    for (recipe, needs) in [
        (
            json!({"drawn": "16384x16384", "size": "16384x16384"}),
            "a window of 4 frames of 2 views of 16384x16384 pixels needs ",
        ),
        (
            json!({"drawn": "16384x16384", "size": "8x16", "color_filter": "valid-area"}),
            "views of up to 16384x16384 pixels needs ",
        ),
    ] {
        std::fs::write(log.path("recipe.json"), recipe.to_string()).unwrap();
        let args = format!(
            "generate {LOG} --skeleton sk --generator fill --recipe recipe.json --out out/images \
                --rasterizer cpu"
        );
        let mut command = Command::new(PSKEL);
        let output = command
            .current_dir(log.path(""))
            .args(args.split(' '))
            .env("PSKEL_MEMORY", "2G")
            .output()
            .unwrap();
        assert_failed(&output, 1, &[needs, "limited by PSKEL_MEMORY"]);
    }
}

/// Creates a file of a declared size that takes no space on the disk.
fn write_sparse(log: &TinyLog, name: &str, header: &[u8], bytes: u64) {
    std::fs::write(log.path(name), header).unwrap();
    let file = std::fs::File::options().write(true).open(log.path(name)).unwrap();
    file.set_len(header.len() as u64 + bytes).unwrap();
}

fn npy_header(kind: &str, rows: u64, columns: u64) -> Vec<u8> {
    let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({rows}, {columns}), }}\n");
    [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
}

/// Sizes that sparse files and options declare, under `ulimit -v` and with both numbers in one line.
#[test]
fn declared_sizes_are_compared_with_the_address_space() {
    let log = log_with_skeleton();
    write_cameras(&log, 1, 64);
    write_sparse(&log, "a.npy", &npy_header("<f8", 500_000_000, 6), 500_000_000 * 48);
    let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\nproperty \
        float y\n\
        property float z\nend_header\n";
    write_sparse(&log, "a.ply", ply.as_bytes(), 12_000_000_000);
    let generate = format!(
        "generate {LOG} --skeleton sk --every 1 --generator fill --window 2 --maps color,depth,class \
            --rasterizer cpu \
         --out rollout"
    );
    let output = log.run(&generate);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let cloud = "a cloud of 500000000 points needs 7.5 GiB of memory, but ";
    let splat = "splat --cameras cameras.json --rasterizer cpu --out f.npz --points";
    for (kib, args, need) in [
        (4_000_000, format!("{splat} a.npy"), cloud),
        (4_000_000, "convert a.npy --out b.ply".to_owned(), cloud),
        (4_000_000, "info a.npy".to_owned(), cloud),
        (4_000_000, format!("{splat} a.ply"), "a cloud of 1000000000 points needs 14.9 GiB of memory, but "),
        (4_000_000, "bench --synthetic 4e9".to_owned(), "a street of 4000000000 points needs 89.4 GiB"),
        (500_000, "town frames=1,size=28x50 --out out/town".to_owned(), " needs 512.0 MiB of memory, but "),
        (
            400_000,
            format!("render {LOG} --skeleton sk --out out/maps --rasterizer compute"),
            "a Vulkan driver needs 512.0 MiB of memory, but ",
        ),
    ] {
        let output = run_within_time(&log.path(""), &format!("ulimit -v {kib}; exec {PSKEL} {args}"));
        assert_failed(&output, 1, &[need, "limited by ulimit -v"]);
        let stderr = String::from_utf8_lossy(&output.stderr);
        let is_progress = |line: &&str| line.starts_with('[') || line.starts_with("generating a street");
        assert_eq!(stderr.lines().filter(|line| !is_progress(line)).count(), 1, "{args}: {stderr}");
        assert_eq!(std::fs::read_dir(log.path("out")).unwrap().count(), 0, "{args}");
    }
    // Unless a driver is asked for, the processor draws.
    let render = format!("ulimit -v 500000; exec {PSKEL} render {LOG} --skeleton sk --out out/maps");
    let output = run_within_time(&log.path(""), &render);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
