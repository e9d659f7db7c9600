//! Losses of a training, and their file.

use std::io::Write;
use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::files::input::read_text;
use point_skeleton::files::write_whole;

use super::StepReport;

/// Number of last steps in [`recent_loss`].
pub const RECENT_STEPS: usize = 100;

const HEADER: &str = "step,loss,gradient_norm,learning_rate";

/// Returns the mean loss of the last [`RECENT_STEPS`] steps.
pub fn recent_loss(losses: &[StepReport]) -> f64 {
    let last = &losses[losses.len().saturating_sub(RECENT_STEPS)..];
    last.iter().map(|report| report.loss).sum::<f64>() / last.len().max(1) as f64
}

/// Reads the first `done` steps.
pub(super) fn read(path: &Path, done: u64) -> Result<Vec<StepReport>, FileError> {
    if done == 0 {
        return Ok(Vec::new());
    }
    let text = read_text(path)?;
    let wrong = |line: &str| FileError::content(format!("lines of {HEADER}"), line, path);
    let lines = text.lines().skip(1).map(|line| parse(line).ok_or_else(|| wrong(line)));
    let losses: Vec<StepReport> = lines.collect::<Result<_, _>>()?;
    let known = losses.into_iter().filter(|report| report.step < done).collect::<Vec<_>>();
    if known.len() as u64 != done {
        return Err(FileError::content(format!("{done} steps"), known.len().to_string(), path));
    }
    Ok(known)
}

fn parse(line: &str) -> Option<StepReport> {
    let cells: Vec<&str> = line.split(',').collect();
    let &[step, loss, norm, rate] = cells.as_slice() else { return None };
    let number = |cell: &str| cell.parse::<f64>().ok();
    Some(StepReport {
        step: step.parse().ok()?,
        loss: number(loss)?,
        gradient_norm: number(norm)?,
        learning_rate: number(rate)?,
    })
}

pub(super) fn write(path: &Path, losses: &[StepReport]) -> Result<(), FileError> {
    write_whole(path, |out| {
        let mut line = |text: String| writeln!(out, "{text}").map_err(FileError::io("write", path));
        line(HEADER.to_owned())?;
        losses.iter().try_for_each(|report| {
            let StepReport { step, loss, gradient_norm, learning_rate } = report;
            line(format!("{step},{loss},{gradient_norm},{learning_rate}"))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("loss.csv");
        let report = |step: u64| StepReport {
            step,
            loss: 1.0 / (step + 3) as f64,
            gradient_norm: 0.1,
            learning_rate: 1e-3,
        };
        let losses: Vec<StepReport> = (0..5).map(report).collect();
        write(&path, &losses).unwrap();
        assert_eq!(read(&path, 5).unwrap(), losses);
        assert_eq!(read(&path, 3).unwrap(), losses[..3]);
        assert!(read(&path, 0).unwrap().is_empty());
        let error = read(&path, 6).unwrap_err().to_string();
        assert!(error.contains("expected 6 steps, found 5"), "{error}");
        std::fs::write(&path, "step,loss\n1,x\n").unwrap();
        assert!(read(&path, 1).unwrap_err().to_string().contains("found 1,x"));
    }
}
