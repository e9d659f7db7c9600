//! Output folders that cannot be renamed or locked.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use crate::simulate::built;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{PSKEL, TinyLog, tree};
use pskel_testing::shared::skip;

const BUILD: &str = "build nuscenes:log --out out";
const RENDER: &str = "render nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu";
const SIMULATE: &str =
    "simulate nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu --steps 1";
const TOWN: &str = "town seed=5,frames=1,size=57x100 --out out";
const TEMPLATES: &str = "templates sk --min-points 1 --out out";
const CONVERT: &str = "convert sk --out out";
const EXPORT: &str =
    "export nuscenes:log --skeletons sks --out out --out-size 32x48 --rasterizer cpu --layout frames";
/// Commands whose output folder appears as a whole.
const WHOLE: [&str; 4] = [BUILD, CONVERT, TEMPLATES, TOWN];

/// Library whose `flock` fails with the error number in the variable `FLOCK_ERROR`.
const SHIM: &str = "#include <errno.h>\n#include <stdlib.h>\n\
    int flock(int file, int operation) { errno = atoi(getenv(\"FLOCK_ERROR\")); return -1; }\n";

/// Returns a log with a skeleton, and no folder `out`.
fn ready() -> TinyLog {
    let log = built();
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log
}

/// Returns the files of a command in a new folder.
fn expected(log: &TinyLog, args: &str) -> BTreeMap<String, Vec<u8>> {
    log.succeed(args);
    let files = tree(&log.path("out"));
    std::fs::remove_dir_all(log.path("out")).unwrap();
    files
}

/// Returns the names in a folder.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Runs a script with the variable `PSKEL` in a log's folder, as root of a namespace that may mount. Returns
/// `None`, and the test counts as skipped, where the system does not permit that or the script exits with 77.
fn in_namespace(log: &TinyLog, script: &str) -> Option<Output> {
    let run = |script: &str| {
        let mut command = Command::new("unshare");
        command.args(["-rm", "bash", "-euc", script]).current_dir(log.path(""));
        command.env("PSKEL", PSKEL).env("RAYON_NUM_THREADS", "2").output()
    };
    let probe = "mkdir probe; mount -t tmpfs tmpfs probe; umount probe";
    let is_allowed = run(probe).is_ok_and(|output| output.status.success());
    let _ = std::fs::remove_dir(log.path("probe"));
    if !is_allowed {
        skip("no namespace in which to mount (unshare -rm)");
        return None;
    }
    let output = run(script).unwrap();
    if output.status.code() == Some(77) {
        skip("a namespace without this kind of mount");
        return None;
    }
    Some(output)
}

#[track_caller]
fn assert_success(output: &Output, what: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{what}: {text}\n{}", String::from_utf8_lossy(&output.stdout));
}

/// Compiles the library; `None` without a compiler.
fn shim(log: &TinyLog) -> Option<()> {
    std::fs::write(log.path("nolock.c"), SHIM).unwrap();
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-o", "nolock.so", "nolock.c"]).current_dir(log.path(""));
    if compiler.status().is_ok_and(|status| status.success()) {
        return Some(());
    }
    skip("no C compiler for the library without locks");
    None
}

fn with_error(log: &TinyLog, args: &str, error: i32) -> Output {
    let mut command = Command::new(PSKEL);
    command.args(args.split_whitespace()).current_dir(log.path("")).env("RAYON_NUM_THREADS", "2");
    command.env("LD_PRELOAD", log.path("nolock.so")).env("FLOCK_ERROR", error.to_string()).output().unwrap()
}

/// ENOLCK, EINVAL, ENOSYS and EOPNOTSUPP, as of NFS and parallel file systems.
#[test]
fn file_systems_without_locks_are_written() {
    let log = ready();
    let Some(()) = shim(&log) else { return };
    for (args, errors) in [
        (BUILD, &[37, 22, 38, 95][..]),
        (RENDER, &[37]),
        (SIMULATE, &[37]),
        (EXPORT, &[37]),
        (CONVERT, &[22]),
        ("convert clouds/background.npy --out out.ply", &[37]),
    ] {
        if args.contains("clouds") {
            log.succeed("convert sk --out clouds");
        }
        for &error in errors {
            let files = (!args.contains("clouds")).then(|| expected(&log, args));
            let output = with_error(&log, args, error);
            assert_success(&output, args);
            let warned = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(warned.matches("has no locks").count(), 1, "{args}: {warned}");
            let Some(files) = files else { continue };
            assert!(tree(&log.path("out")) == files, "{args}");
            assert!(!log.path("out/.pskel").exists() && !log.path("out.partial").exists(), "{args}");
            std::fs::remove_dir_all(log.path("out")).unwrap();
        }
    }
}

#[test]
fn a_lock_that_fails_leaves_nothing() {
    let log = ready();
    let Some(()) = shim(&log) else { return };
    log.succeed("convert sk --out clouds");
    let before = names(&log.path(""));
    for args in [BUILD, RENDER, SIMULATE, CONVERT, TOWN, "convert clouds/background.npy --out out.ply"] {
        let output = with_error(&log, args, 5); // EIO
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{args}: {text}");
        assert!(text.contains("cannot lock: Input/output error"), "{args}: {text}");
        assert_eq!(names(&log.path("")), before, "{args}");
    }
}

/// Folders from a lower overlay layer, as in a container's image, cannot be renamed.
#[test]
fn folders_of_an_image_layer_are_replaced() {
    for (first, second) in [
        (BUILD, "build nuscenes:log --frames 0..2 --out out"),
        (RENDER, RENDER),
        (
            RENDER,
            "render nuscenes:log --skeleton sk --out out --maps depth,class --frames 1..3 --rasterizer cpu",
        ),
        (SIMULATE, SIMULATE),
        (CONVERT, "convert sk --format ply --out out"),
        (TEMPLATES, "templates sk --min-points 1 --target-points 50 --out out"),
        (TOWN, "town seed=5,frames=1,size=28x50 --out out"),
    ] {
        let log = ready();
        // What is in a folder of maps besides the frames of a run stays there.
        log.succeed(first);
        log.succeed(second);
        let files = tree(&log.path("out"));
        std::fs::remove_dir_all(log.path("out")).unwrap();
        let script = format!(
            "mkdir lower upper work merged; mv log sk lower; cd lower; $PSKEL {first} >&2; cd ..
            mount -t overlay overlay -o lowerdir=lower,upperdir=upper,workdir=work,userxattr merged || exit 77
            cd merged; $PSKEL {second}; rm -rf ../seen; cp -a out ../seen; ls -A > ../left; cd ..; umount \
            merged"
        );
        let Some(output) = in_namespace(&log, &script) else { return };
        assert_success(&output, second);
        assert!(tree(&log.path("seen")) == files, "{second}");
        assert_eq!(std::fs::read_to_string(log.path("left")).unwrap(), "log\nout\nsk\n", "{second}");
        assert!(!log.path("seen/.pskel").exists(), "{second}");
        let list = std::fs::read_to_string(log.path("seen/.pskel-files")).unwrap();
        for line in list.lines().skip(1) {
            assert!(log.path("seen").join(line).exists(), "{second}: {line}");
        }
    }
}

/// `--out` is the volume of a container: empty, then with the output of an earlier run.
#[test]
fn mount_points_are_filled() {
    for args in WHOLE.into_iter().chain([RENDER, SIMULATE, EXPORT]) {
        let log = ready();
        let files = expected(&log, args);
        let script = format!(
            "mkdir out; mount -t tmpfs tmpfs out; mkdir out/lost+found
            $PSKEL {args}; cp -a out first; $PSKEL {args}; cp -a out second; umount out; ls -A out > left"
        );
        let before = names(&log.path(""));
        let Some(output) = in_namespace(&log, &script) else { return };
        assert_success(&output, args);
        for copy in ["first", "second"] {
            assert!(tree(&log.path(copy)) == files, "{args}");
            let hidden = |name: &String| name.starts_with('.') && name != ".pskel-files";
            assert!(!names(&log.path(copy)).iter().any(hidden), "{args}");
            std::fs::remove_dir_all(log.path(copy)).unwrap();
        }
        assert_eq!(std::fs::read_to_string(log.path("left")).unwrap(), "", "{args}");
        for name in ["out", "left"] {
            let path = log.path(name);
            if path.is_dir() {
                std::fs::remove_dir(path).unwrap()
            } else {
                std::fs::remove_file(path).unwrap()
            }
        }
        assert_eq!(names(&log.path("")), before, "{args}");
    }
}

/// A folder that is bound to another one of the same file system, below a folder that is read-only.
#[test]
fn volumes_in_read_only_containers_are_filled() {
    let log = ready();
    let files = expected(&log, BUILD);
    let build = BUILD.replace("--out out", "--out root/out");
    let script = format!(
        "mkdir -p disk root/out; mount --bind disk root/out
        $PSKEL {build}; test ! -e root/out.partial; cd root/out; $PSKEL convert ../../sk --out . 2> \
        ../../said && exit 9
        cd ../..; umount root/out; ls -A root"
    );
    let Some(output) = in_namespace(&log, &script) else { return };
    assert_success(&output, "build");
    assert!(tree(&log.path("disk")) == files);
    let said = std::fs::read_to_string(log.path("said")).unwrap();
    assert!(
        said.contains("expected a folder of kind points, or a new one, found one of kind skeleton"),
        "{said}"
    );
    // Nothing can be created beside the output.
    std::fs::remove_dir_all(log.path("disk")).unwrap();
    let script = format!(
        "mkdir disk; mount --bind root root; mount --bind disk root/out; mount -o remount,bind,ro root || \
            exit 77
        ! touch root/x 2>/dev/null; $PSKEL {build}; $PSKEL {build}"
    );
    let Some(output) = in_namespace(&log, &script) else { return };
    assert_success(&output, "build below a read-only folder");
    assert!(tree(&log.path("disk")) == files);
}

/// A foreign file in a volume is found before the work, and stays.
#[test]
fn foreign_files_in_a_mount_point_stay() {
    let log = ready();
    for (args, name) in [(BUILD, "thesis.tex"), (CONVERT, "actors/thesis.tex"), (BUILD, ".pskel/thesis.tex")]
    {
        let script = format!(
            "mkdir -p out; mount -t tmpfs tmpfs out; mkdir -p $(dirname out/{name}); echo mine > out/{name}
            ! $PSKEL {args} 2> said; cat out/{name}; umount out"
        );
        let Some(output) = in_namespace(&log, &script) else { return };
        assert_success(&output, args);
        assert_eq!(String::from_utf8_lossy(&output.stdout), "mine\n", "{args}");
        let said = std::fs::read_to_string(log.path("said")).unwrap();
        assert!(said.contains("expected ") && said.contains("out/"), "{said}");
    }
}

/// A list with paths outside of its folder, which is replaced file by file.
#[test]
fn lists_of_a_mount_point_stay_inside_it() {
    let log = ready();
    let script = format!(
        "mkdir out; mount -t tmpfs tmpfs out; $PSKEL {BUILD}; echo mine > victim; echo ../victim >> \
            out/.pskel-files
        ! $PSKEL {BUILD} 2> said; cat victim; umount out"
    );
    let Some(output) = in_namespace(&log, &script) else { return };
    assert_success(&output, BUILD);
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().last(), Some("mine"));
    let said = std::fs::read_to_string(log.path("said")).unwrap();
    assert!(said.contains("expected paths of files below the folder, found ../victim: out/"), "{said}");
}

/// A folder of an export that is a volume of its own.
#[test]
fn shards_are_written_into_mount_points() {
    let log = ready();
    let args =
        "export nuscenes:log --skeletons sks --out out --out-size 32x48 --rasterizer cpu --layout pas-cache";
    let script = format!(
        "$PSKEL {args}; cp -a out first; rm -r out/proj_clr; mkdir out/proj_clr; mount -t tmpfs tmpfs \
            out/proj_clr
        $PSKEL {args}; cp -a out second; umount out/proj_clr"
    );
    let Some(output) = in_namespace(&log, &script) else { return };
    assert_success(&output, args);
    assert!(tree(&log.path("first")) == tree(&log.path("second")));
}

/// An output file that is bound to another one, with a folder beside it that can be written or not.
#[test]
fn files_that_are_mount_points_are_written() {
    let log = ready();
    log.succeed("convert sk --out clouds");
    log.succeed("convert clouds/background.npy --out expected.ply");
    let expected = std::fs::read(log.path("expected.ply")).unwrap();
    for lock in ["", "mount -o remount,bind,ro root || exit 77;"] {
        std::fs::create_dir_all(log.path("root")).unwrap();
        for name in ["root/out.ply", "disk.ply"] {
            std::fs::write(log.path(name), "").unwrap();
        }
        let script = format!(
            "mount --bind root root; mount --bind disk.ply root/out.ply; {lock}
            $PSKEL convert clouds/background.npy --out root/out.ply; ls -A root"
        );
        let Some(output) = in_namespace(&log, &script) else { return };
        assert_success(&output, lock);
        assert!(std::fs::read(log.path("disk.ply")).unwrap() == expected, "{lock}");
        assert!(String::from_utf8_lossy(&output.stdout).ends_with("\nout.ply\n"), "{output:?}");
    }
}
