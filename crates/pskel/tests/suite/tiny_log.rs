//! Runs the command on the tiny log.

use std::process::{Command, Output};

pub(crate) use pskel_testing::tiny_log::*;

pub(crate) const PSKEL: &str = env!("CARGO_BIN_EXE_pskel");

/// Runs of `pskel` in the folder of a log.
pub(crate) trait RunPskel {
    /// Runs `pskel` in the folder with validation; the arguments are separated by spaces.
    fn run(&self, args: &str) -> Output;

    fn run_with(&self, args: &str, threads: &str) -> Output;

    /// Returns the summary of a run, which must succeed.
    #[track_caller]
    fn succeed(&self, args: &str) -> String;

    /// Asserts that a run fails with a code and a message that has all of `parts`, and leaves `out` empty.
    #[track_caller]
    fn fail(&self, args: &str, code: i32, parts: &[&str]);

    #[track_caller]
    fn assert_out_is_empty(&self);
}

impl RunPskel for TinyLog {
    fn run(&self, args: &str) -> Output {
        self.run_with(args, "2")
    }

    fn run_with(&self, args: &str, threads: &str) -> Output {
        let mut command = Command::new(PSKEL);
        command.current_dir(self.path("")).args(args.split_whitespace()).env("PSKEL_VALIDATION", "1");
        command.env("RAYON_NUM_THREADS", threads).env("LP_NUM_THREADS", threads).output().unwrap()
    }

    #[track_caller]
    fn succeed(&self, args: &str) -> String {
        let output = self.run(args);
        assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
        let summary = String::from_utf8(output.stdout).unwrap();
        assert_eq!(summary.lines().count(), 1, "{summary}");
        summary
    }

    #[track_caller]
    fn fail(&self, args: &str, code: i32, parts: &[&str]) {
        assert_failed(&self.run(args), code, parts);
        self.assert_out_is_empty();
    }

    #[track_caller]
    fn assert_out_is_empty(&self) {
        assert_eq!(tree(&self.path("out")).into_keys().collect::<Vec<_>>(), [""; 0]);
        assert_eq!(std::fs::read_dir(self.path("out")).unwrap().count(), 0);
    }
}

/// Returns the command with default handling of signals, which a parent process may have set to be ignored
/// (nohup, a background job).
pub(crate) fn with_default_signals() -> Command {
    let mut command = Command::new("env");
    command.args(["--default-signal=HUP,INT,TERM", PSKEL]);
    command
}

#[track_caller]
pub(crate) fn assert_failed(output: &Output, code: i32, parts: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    for part in parts {
        assert!(stderr.contains(part), "{stderr}\nexpected {part}");
    }
}
