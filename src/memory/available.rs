//! Memory that this process can still take, by the limits of the system.

use std::fmt;
use std::path::{Path, PathBuf};

use rustix::process::{Resource, getrlimit};

use crate::geometry::ParseOptionError;

/// Environment variable with the memory that the process may take in total, in place of all other limits:
/// bytes, or a number with the unit K, M, G or T.
pub const VARIABLE: &str = "PSKEL_MEMORY";

/// Memory that this process can still take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Available {
    /// Bytes.
    pub bytes: u64,
    /// The limit that allows the least.
    pub source: LimitSource,
}

/// A limit on memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitSource {
    /// [`VARIABLE`].
    Variable,
    /// Limit on the address space (`ulimit -v`).
    AddressSpace,
    /// Limit of a control group, which containers and batch systems set.
    ControlGroup,
    /// Memory and swap of the machine.
    System,
}

impl fmt::Display for LimitSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Variable => "limited by PSKEL_MEMORY",
            Self::AddressSpace => "limited by ulimit -v",
            Self::ControlGroup => "limited by the container or control group",
            Self::System => "free memory of the system",
        })
    }
}

impl Available {
    /// Returns what is left after other memory is taken.
    pub(super) fn less(self, bytes: u64) -> Self {
        Self { bytes: self.bytes.saturating_sub(bytes), ..self }
    }
}

/// Returns the memory that this process can still take. An invalid value of [`VARIABLE`] is ignored;
/// [`variable_limit`] reports it.
pub fn available() -> Available {
    let status = read("/proc/self/status");
    if let Ok(Some(limit)) = variable_limit() {
        return Available { bytes: limit, source: LimitSource::Variable }.less(taken(&status));
    }
    let address_space = address_space_by(&status);
    let group = control_group(&read("/proc/self/cgroup"), Path::new("/sys/fs/cgroup"), &|path| {
        std::fs::read_to_string(path).ok()
    });
    let group = group.map(|bytes| Available { bytes, source: LimitSource::ControlGroup });
    let system = system(&read("/proc/meminfo")).map(|bytes| Available { bytes, source: LimitSource::System });
    let unknown = Available { bytes: u64::MAX, source: LimitSource::System };
    [address_space, group, system]
        .into_iter()
        .flatten()
        .fold(unknown, |least, other| if other.bytes < least.bytes { other } else { least })
}

/// Returns the address space that this process can still take, also for reservations and mapped files; `None`
/// without a limit.
pub fn address_space() -> Option<Available> {
    address_space_by(&read("/proc/self/status"))
}

fn address_space_by(status: &str) -> Option<Available> {
    let limit = getrlimit(Resource::As).current?;
    let used = kib(status, "VmSize:").unwrap_or(0);
    Some(Available { bytes: limit, source: LimitSource::AddressSpace }.less(used))
}

/// Returns the memory that this process has taken, bytes, without mapped files.
pub(super) fn taken_bytes() -> u64 {
    taken(&read("/proc/self/status"))
}

/// Returns the limit that the environment variable [`VARIABLE`] sets, bytes; `None` if it is empty or not
/// set.
///
/// # Errors
/// Fails if its value is not a size.
pub fn variable_limit() -> Result<Option<u64>, ParseOptionError> {
    let text = std::env::var_os(VARIABLE).unwrap_or_default();
    let text = text.to_string_lossy();
    if text.is_empty() { Ok(None) } else { parse_size(&text).map(Some) }
}

/// Parses `512M`, `8G`, `8GiB` or a number of bytes.
fn parse_size(text: &str) -> Result<u64, ParseOptionError> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_lowercase().trim_end_matches("ib").trim_end_matches('b') {
        "" => Some(0),
        "k" => Some(10),
        "m" => Some(20),
        "g" => Some(30),
        "t" => Some(40),
        _ => None,
    };
    let number = digits.trim().parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
    let bytes = number.zip(shift).map(|(number, shift)| (number * f64::from(shift).exp2()) as u64);
    bytes.ok_or_else(|| ParseOptionError {
        expected: "a size in PSKEL_MEMORY, like 8G or 512M",
        found: text.to_owned(),
    })
}

fn read(path: &str) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// Returns the anonymous memory of a process from its `status`.
fn taken(status: &str) -> u64 {
    kib(status, "RssAnon:").unwrap_or(0) + kib(status, "RssShmem:").unwrap_or(0)
}

/// Returns the memory and swap that new programs can take, from `/proc/meminfo`.
fn system(meminfo: &str) -> Option<u64> {
    Some(kib(meminfo, "MemAvailable:")? + kib(meminfo, "SwapFree:").unwrap_or(0))
}

/// Returns a value from a file with lines `NAME: N kB`, in bytes.
fn kib(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let number: u64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    number.checked_mul(1024)
}

/// Files of one control-group version: limit, usage, and the entry of `memory.stat` for cached files that can
/// be dropped.
const VERSION_1: [&str; 3] = ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"];
const VERSION_2: [&str; 3] = ["memory.max", "memory.current", "inactive_file"];

/// Returns the least memory that the control group of this process and its parents still allow; `None`
/// without a limit. `groups` is `/proc/self/cgroup`, `root` where the groups are mounted.
fn control_group(groups: &str, root: &Path, read: &dyn Fn(&Path) -> Option<String>) -> Option<u64> {
    let of_line = |line: &str| {
        let mut fields = line.splitn(3, ':').skip(1);
        let (controllers, path) = (fields.next()?, fields.next()?);
        let (folder, files) = match controllers {
            "" => (root.to_owned(), VERSION_2),
            all if all.split(',').any(|name| name == "memory") => (root.join("memory"), VERSION_1),
            _ => return None,
        };
        // Within a container, the path of the host may not exist: its root is the container's group.
        let parents = Path::new(path.trim_start_matches('/')).ancestors();
        parents.filter_map(|group| left(&folder.join(group), files, read)).min()
    };
    groups.lines().filter_map(of_line).min()
}

fn left(
    group: &Path,
    [limit, usage, cached]: [&str; 3],
    read: &dyn Fn(&Path) -> Option<String>,
) -> Option<u64> {
    let file = |name: &str| -> Option<String> { read(&PathBuf::from(group).join(name)) };
    let number = |name: &str| file(name)?.trim().parse::<u64>().ok();
    let (limit, usage) = (number(limit)?, number(usage)?);
    let stat = file("memory.stat").unwrap_or_default();
    let cached = stat.lines().find_map(|line| line.strip_prefix(cached)?.trim().parse::<u64>().ok());
    Some(limit.saturating_sub(usage.saturating_sub(cached.unwrap_or(0))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn sizes_have_units() {
        for (text, bytes) in
            [("1024", 1024), ("8G", 8 << 30), ("0.5g", 1 << 29), ("512MiB", 512 << 20), ("2 kB", 2048)]
        {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1G", "0", "8X", "many", "infG", "1G1"] {
            let message = parse_size(text).unwrap_err().to_string();
            assert!(message.starts_with("expected a size in PSKEL_MEMORY, like 8G or 512M"), "{message}");
        }
    }

    #[test]
    fn reads_fields_of_meminfo() {
        let meminfo = "MemTotal: 100 kB\nMemFree: 1 kB\nMemAvailable:   60 kB\nSwapFree: 4 kB\n";
        assert_eq!(system(meminfo), Some(64 << 10));
        assert_eq!((system("MemTotal: 5 kB"), system("")), (None, None));
        assert_eq!(taken("VmRSS: 9 kB\nRssAnon:\t 5 kB\nRssFile: 3 kB\nRssShmem: 1 kB\n"), 6 << 10);
    }

    #[test]
    fn the_tightest_control_group_counts() {
        let files: BTreeMap<&str, &str> = [
            ("/g/memory.max", "max"),
            ("/g/a/memory.max", "1000"),
            ("/g/a/memory.current", "700"),
            ("/g/a/memory.stat", "anon 5\ninactive_file 100\n"),
            ("/g/a/b/memory.max", "5000"),
            ("/g/a/b/memory.current", "600"),
            ("/g/memory/memory.limit_in_bytes", "900"),
            ("/g/memory/memory.usage_in_bytes", "800"),
        ]
        .into();
        let read = |path: &Path| files.get(path.to_str()?).map(|text| (*text).to_owned());
        let of = |groups: &str| control_group(groups, Path::new("/g"), &read);
        assert_eq!(of("0::/a/b\n"), Some(400));
        // A container on a host with version 1: the path is one of the host.
        assert_eq!(of("9:cpu,memory:/docker/1\n3:pids:/a\n0::/\n"), Some(100));
        assert_eq!((of("0::/none\n"), of("3:pids:/a\n"), of("")), (None, None, None));
    }

    #[test]
    fn some_memory_is_available() {
        let found = available();
        assert!(found.bytes > 1 << 20 && found.bytes < 1 << 50, "{found:?}");
        assert!(taken_bytes() > 0);
    }
}
