//! Runs the command on untrusted data, with limits of time and memory, and lists files to detect changes.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::tiny_log::PSKEL;

/// Time limit of a run. Debug builds on busy machines are slow; a read from a FIFO never returns.
const MAX_TIME: Duration = Duration::from_secs(60);
/// Address space limit of a run, KiB. Threads and libraries need some of it; a device read as a file would
/// use all.
const MAX_MEMORY_KIB: u64 = 6 << 20;

/// Result of a run.
#[derive(Debug)]
pub(crate) struct Ended {
    /// Exit code; `None` if the process was killed, for its time or by a signal.
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs `pskel` in a folder.
pub(crate) fn run(folder: &Path, args: &[&str]) -> Ended {
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!("ulimit -v {MAX_MEMORY_KIB}; exec \"$@\"")).args(["sh", PSKEL]).args(args);
    command.current_dir(folder).env("RAYON_NUM_THREADS", "2");
    let (out, err) = (tempfile::tempfile().unwrap(), tempfile::tempfile().unwrap());
    command.stdin(Stdio::null()).stdout(out.try_clone().unwrap()).stderr(err.try_clone().unwrap());
    let (mut child, start) = (command.spawn().unwrap(), Instant::now());
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break Some(status);
        }
        if start.elapsed() > MAX_TIME {
            child.kill().unwrap();
            child.wait().unwrap();
            break None;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let status = status.filter(|status| status.signal().is_none());
    Ended { code: status.and_then(|status| status.code()), stdout: text(out), stderr: text(err) }
}

impl Ended {
    /// Asserts that the run was refused with a printable message that contains all of `parts`.
    #[track_caller]
    pub(crate) fn refused(&self, what: &str, parts: &[&str]) {
        let Self { code, stderr, .. } = self;
        assert!(matches!(code, Some(1 | 2)), "{what}: {code:?}, {stderr:.2000}");
        let acts = |c: char| c.is_control() && c != '\n';
        assert!(!stderr.contains(acts) && stderr.len() < 8192, "{what}: {stderr:.8192?}");
        for part in parts {
            assert!(stderr.contains(part), "{what}: {stderr}\nexpected {part}");
        }
    }
}

fn text(mut file: std::fs::File) -> String {
    use std::io::{Read, Seek};
    let mut bytes = Vec::new();
    file.rewind().unwrap();
    file.read_to_end(&mut bytes).unwrap();
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Lists the content of a folder: types, and sizes and hashes of files. Follows no links and opens only
/// regular files.
pub(crate) fn listing(folder: &Path) -> BTreeMap<String, String> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let about = std::fs::symlink_metadata(&path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if about.is_dir() {
            all.extend(listing(&path).into_iter().map(|(inner, what)| (format!("{name}/{inner}"), what)));
        }
        let what = if about.is_file() {
            let mut hasher = DefaultHasher::new();
            std::fs::read(&path).unwrap().hash(&mut hasher);
            format!("{} bytes {:x}", about.len(), hasher.finish())
        } else {
            format!("{:?}", about.file_type())
        };
        all.insert(name, what);
    }
    all
}
