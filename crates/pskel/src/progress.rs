use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use point_skeleton::memory::Bytes;
use point_skeleton::skeleton::{self, BuildNeeds};

use super::{print_progress, warn};

/// Maximum number of lines per stage without a terminal, so that logs of long runs stay readable.
const LINES: u64 = 10;

/// Progress of a stage on stderr: a bar on a terminal, lines otherwise.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    done: u64,
    total: u64,
    start: Instant,
}

impl Progress {
    /// Creates the progress of a stage with `total` steps.
    pub(super) fn new(total: usize) -> Self {
        let total = total as u64;
        let bar = std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{bar:40} {pos}/{len} {elapsed}, {eta} left, {msg}");
            ProgressBar::new(total).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        Self { bar, done: 0, total, start: Instant::now() }
    }

    /// Counts a finished step.
    pub(super) fn step(&mut self, name: &str) {
        self.done += 1;
        match &self.bar {
            Some(bar) => {
                bar.set_message(name.to_owned());
                bar.inc(1);
            }
            None if self.is_worth_a_line() => {
                print_progress(&format!("[{}/{}] {name}{}", self.done, self.total, time_left(self.left())));
            }
            None => {}
        }
    }

    /// Removes steps that need no work from the total.
    pub(super) fn skip(&mut self, steps: usize) {
        self.total = self.total.saturating_sub(steps as u64);
        if let Some(bar) = &self.bar {
            bar.set_length(self.total);
        }
    }

    /// Estimates the remaining time from the average time per step.
    fn left(&self) -> Duration {
        let rest = (self.total - self.done.min(self.total)) as f64 / self.done.max(1) as f64;
        self.start.elapsed().mul_f64(rest)
    }

    /// Returns whether to print a line: at every step of a short stage, at each tenth of a long one.
    fn is_worth_a_line(&self) -> bool {
        let part = |done: u64| done * LINES / self.total.max(LINES);
        self.total <= LINES || part(self.done) > part(self.done - 1)
    }
}

/// Formats the remaining time; empty if it is below 10 seconds.
fn time_left(left: Duration) -> String {
    match left.as_secs() {
        0..10 => String::new(),
        seconds => format!(", {} left", HumanDuration(Duration::from_secs(seconds))),
    }
}

/// Removes the bar.
impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Progress of work with several stages, updated from any thread.
#[derive(Default)]
pub(super) struct StageProgress(Mutex<StageState>);

#[derive(Default)]
struct StageState {
    stage: Option<(String, Progress)>,
    /// Number of skipped files.
    skipped: u64,
}

impl StageProgress {
    fn change(&self, change: impl FnOnce(&mut StageState)) {
        change(&mut self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    }
}

/// Describes what a build needs; the second sentence warns if there is less.
fn describe(needs: &BuildNeeds) -> (String, Option<String>) {
    let BuildNeeds { sweeps, points, disk_bytes, free_bytes, memory_bytes, .. } = *needs;
    let available = needs.available.bytes;
    let free = free_bytes.map_or_else(|| "unknown".to_owned(), |free| Bytes(free).to_string());
    let text = format!(
        "about {:.1} million points in {sweeps} sweeps: at most {} of disk while building ({free} free), \
         {} at the end; {} of memory ({} available)",
        points as f64 / 1e6,
        Bytes(disk_bytes),
        Bytes(needs.skeleton_bytes),
        Bytes(memory_bytes),
        Bytes(available)
    );
    let lacks_disk = free_bytes.is_some_and(|free| free < disk_bytes);
    let warning = match (lacks_disk, available < memory_bytes) {
        (true, _) => Some("the disk may become full; free some and continue with --resume then".to_owned()),
        (_, true) => {
            Some("the memory may not suffice: it holds the images and sweeps around a frame".to_owned())
        }
        _ => None,
    };
    (text, warning)
}

impl skeleton::Progress for StageProgress {
    fn needs(&self, estimate: &dyn Fn() -> BuildNeeds) {
        let (text, warning) = describe(&estimate());
        print_progress(&text);
        warning.iter().for_each(|text| warn(text));
    }

    fn start(&self, stage: &str, steps: usize) {
        self.change(|state| state.stage = Some((stage.to_owned(), Progress::new(steps))));
    }

    fn step(&self) {
        self.change(|state| {
            if let Some((stage, progress)) = &mut state.stage {
                progress.step(stage);
            }
        });
    }

    fn skipped(&self, message: &str) {
        self.change(|state| {
            state.skipped += 1;
            let text = match state.skipped {
                ..=LINES => format!("skipped a damaged file: {message}"),
                count if count == LINES + 1 => "skipped more damaged files, which are counted".to_owned(),
                _ => return,
            };
            match state.stage.as_ref().and_then(|(_, progress)| progress.bar.as_ref()) {
                Some(bar) => bar.suspend(|| warn(&text)),
                None => warn(&text),
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::memory::{Available, LimitSource};

    #[test]
    fn time_left_follows_progress() {
        let start = Instant::now() - Duration::from_secs(60);
        let progress = |done| Progress { bar: None, done, total: 40, start };
        let left = |done| progress(done).left().as_secs();
        assert_eq!([left(10), left(30), left(40)], [180, 20, 0]);
        assert_eq!(time_left(Duration::from_secs(9)), "");
        assert_eq!(time_left(Duration::from_secs(180)), ", 3 minutes left");
    }

    #[test]
    fn needs_are_compared_with_what_there_is() {
        let available = Available { bytes: 4 << 30, source: LimitSource::System };
        let needs = BuildNeeds {
            sweeps: 160,
            points: 10_600_000,
            skeleton_bytes: 1 << 27,
            disk_bytes: 3 << 29,
            free_bytes: Some(2 << 30),
            memory_bytes: 1 << 30,
            available,
        };
        let (text, warning) = describe(&needs);
        let expected = "about 10.6 million points in 160 sweeps: at most 1.5 GiB of disk while building \
                        (2.0 GiB free), 128.0 MiB at the end; 1.0 GiB of memory (4.0 GiB available)";
        assert_eq!((text.as_str(), warning), (expected, None));
        let warning = |needs: BuildNeeds| describe(&needs).1.unwrap_or_default();
        let full = warning(BuildNeeds { free_bytes: Some(1 << 30), ..needs.clone() });
        assert!(full.starts_with("the disk may become full"), "{full}");
        let small = warning(BuildNeeds { memory_bytes: 5 << 30, ..needs });
        assert!(small.starts_with("the memory may not suffice"), "{small}");
    }

    #[test]
    fn prints_few_lines_and_always_the_last() {
        for total in [1, 7, 10, 11, 38, 1000] {
            let mut progress = Progress { bar: None, done: 0, total, start: Instant::now() };
            let mut lines = 0;
            for _ in 0..total {
                progress.done += 1;
                lines += u64::from(progress.is_worth_a_line());
            }
            assert!(progress.is_worth_a_line(), "{total}");
            assert_eq!(lines, total.min(LINES), "{total}");
        }
    }
}
