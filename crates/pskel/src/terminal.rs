//! Lines for the user: results on stdout, progress and warnings on stderr.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::OnceLock;

use point_skeleton::files::text::{escaped_lines, printable, printable_lines};

/// First error of writing the result.
static FAILURE: OnceLock<std::io::Error> = OnceLock::new();

/// Prints a line of the result. A closed pipe is not an error; other errors are reported by [`check`].
pub(super) fn print_result(line: &str) {
    let mut out = std::io::stdout().lock();
    note(writeln!(out, "{}", escaped_lines(line)).and_then(|()| out.flush()));
}

/// Records the first error of writing to stdout.
pub(super) fn note(written: std::io::Result<()>) {
    if let Err(error) = written
        && error.kind() != ErrorKind::BrokenPipe
    {
        let _ = FAILURE.set(error); // only the first one is recorded
    }
}

/// Prints a line of progress. A closed or full stderr does not stop the work.
pub(super) fn print_progress(line: &str) {
    let _ = writeln!(std::io::stderr(), "{}", printable_lines(line));
}

/// Prints a warning.
pub(super) fn warn(text: &str) {
    print_progress(&format!("warning: {text}"));
}

/// Warns of actors that only their boxes show. `tracks` are theirs; none gives no warning.
pub(super) fn warn_of_boxes_alone(tracks: &[&str]) {
    const SHOWN: usize = 5;
    let Some((first, others)) = tracks.split_first() else { return };
    let (count, actors, theirs) = match others {
        [] => (1, "actor has", "its box is"),
        _ => (tracks.len(), "actors have", "their boxes are"),
    };
    let shown = others
        .iter()
        .take(SHOWN - 1)
        .fold(printable(first).into_owned(), |list, track| format!("{list}, {}", printable(track)));
    let more = if count > SHOWN { format!(" and {} more", count - SHOWN) } else { String::new() };
    warn(&format!("{count} {actors} neither points nor a template, only {theirs} shown: {shown}{more}"));
}

/// Prints notes on the content of a file.
pub(super) fn print_notes(path: &Path, notes: &[String]) {
    notes.iter().for_each(|note| print_progress(&format!("note: {}: {note}", path.display())));
}

/// Checks that every line of the result was written.
///
/// # Errors
/// Returns the first error of writing to stdout.
pub(super) fn check() -> anyhow::Result<()> {
    match FAILURE.get() {
        None => Ok(()),
        Some(error) => Err(anyhow::anyhow!("cannot write the result to stdout: {error}")),
    }
}
