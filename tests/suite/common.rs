//! Where test data lies, and skeletons made from it.

use std::io::Write;
use std::path::{Path, PathBuf};

use point_skeleton::dataset::Dataset;
use point_skeleton::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton};

/// The folder of recordings and fixtures: `PSKEL_SHARED`, else `../shared` from the project's root. Where neither
/// exists the skip is printed, counted in the file `PSKEL_SKIP_LOG` names, and the caller returns.
pub(crate) fn shared(what: &str) -> Option<PathBuf> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let folder = std::env::var_os("PSKEL_SHARED").map_or_else(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    let test = std::thread::current().name().unwrap_or("?").to_owned();
    eprintln!("skipped {test}: {what} is not at {} (set PSKEL_SHARED)", folder.display());
    if let Some(log) = std::env::var_os("PSKEL_SKIP_LOG") {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(log).unwrap();
        writeln!(file, "{test}").unwrap();
    }
    None
}

/// The folder of fixtures: `PSKEL_FIXTURES`, else `fixtures` in the shared folder.
pub(crate) fn fixtures(what: &str) -> Option<PathBuf> {
    std::env::var_os("PSKEL_FIXTURES").map(PathBuf::from).or_else(|| shared(what).map(|s| s.join("fixtures")))
}

/// A skeleton of some frames of a log, without templates.
pub(crate) fn skeleton_of(
    out: &Path,
    log: &dyn Dataset,
    frames: &[usize],
    options: &BuildOptions,
) -> Skeleton {
    let input = BuildInput { dataset: log, frames: frames.to_vec() };
    skeleton::build(out, &[input], options, &|_| Ok(Vec::new()), &BuildRun::default()).unwrap()
}
