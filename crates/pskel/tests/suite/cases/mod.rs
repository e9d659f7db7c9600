//! Data of strangers: inputs that other tools stumbled over, one module per kind of fault. Each must be read
//! with the right values, counted, or refused by a message that names the cause.

mod clocks;
mod columns;
mod early;
mod exports;
mod folders;
mod gaps;
mod limits;
mod messages;
mod outputs;
mod points;
mod recordings;
mod records;
mod sweeps;
mod words;

use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

use crate::untrusted::guarded::{self, Ended};
use pskel_testing::shared::shared;

/// Inputs of a shared case, in a folder that is removed on drop.
pub(crate) struct Case {
    folder: TempDir,
}

impl Case {
    /// Runs the generator of a case (`data/NAME`) on the shared recordings. Returns `None` where these are
    /// missing.
    pub(crate) fn new(name: &str) -> Option<Self> {
        let shared = shared("the case")?;
        let folder = tempfile::tempdir().unwrap();
        let script = shared.join("cases").join(name).join("make.py");
        let mut make = Command::new("python3");
        make.arg(&script).arg(shared.join("data")).arg(folder.path().join("in"));
        let output = make.env("PYTHONDONTWRITEBYTECODE", "1").output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Some(Self { folder })
    }

    /// Returns the working folder of commands; the inputs are in `in`, and `out` is free.
    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Runs `pskel` with arguments separated by spaces.
    pub(crate) fn run(&self, args: &str) -> Ended {
        guarded::run(self.path(), &args.split(' ').collect::<Vec<_>>())
    }

    /// Runs `pskel`, which must succeed. Returns its standard output and its standard error.
    #[track_caller]
    pub(crate) fn succeed(&self, args: &str) -> (String, String) {
        let ended = self.run(args);
        assert_eq!(ended.code, Some(0), "{args}: {}", ended.stderr);
        (ended.stdout, ended.stderr)
    }

    /// Reads a JSON file below the folder.
    #[track_caller]
    pub(crate) fn json(&self, path: &str) -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(self.path().join(path)).unwrap()).unwrap()
    }
}
