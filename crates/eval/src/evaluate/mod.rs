//! Scores generated images of rollouts against ground truth. `rollout` reads a rollout and masks of its
//! vehicles, `report` has the results.

mod error;
mod picture;
mod report;
mod rollout;

pub use error::EvaluateError;
pub use report::{Report, SCORES};

use std::path::{Path, PathBuf};

use self::report::ScoredRollout;
use self::rollout::GeneratedRollout;
use crate::{MaskRule, RolloutScores, ScoredFrame, Scores};

/// Rollouts to score, and further inputs.
#[derive(Clone, Debug, Default)]
pub struct EvaluateOptions {
    /// Folders of rollouts with generated images.
    pub rollouts: Vec<PathBuf>,
    /// Folders with vehicle masks of a segmentor, `NNNNNN/CAM.png`: one per rollout, or none.
    pub masks: Vec<PathBuf>,
    /// How the masks of vehicles are computed from class maps.
    pub mask_rule: MaskRule,
    /// Scores only every N-th frame, N - 1, 2 N - 1, ..: those that a training with the same number left out.
    pub hold_out: Option<usize>,
    /// Folder that the report names rollouts relative to; those outside are named as given.
    pub root: Option<PathBuf>,
}

/// Scores all steps of all rollouts. `on_start` is called with the number of steps, then `on_step` with a
/// name after each one.
///
/// # Errors
/// Fails if a folder is not a rollout with generated images, if an image is missing or damaged, or if the
/// number of mask folders differs from the number of rollouts.
pub fn evaluate(
    options: &EvaluateOptions,
    on_start: &mut dyn FnMut(usize),
    on_step: &mut dyn FnMut(&str),
) -> Result<Report, EvaluateError> {
    let EvaluateOptions { rollouts, masks, mask_rule, hold_out, root } = options;
    if !masks.is_empty() && masks.len() != rollouts.len() {
        return Err(EvaluateError::Masks { rollouts: rollouts.len(), found: masks.len() });
    }
    let open = |folder: &PathBuf| GeneratedRollout::open(folder);
    let mut rollouts = rollouts.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    if let Some(every) = *hold_out {
        rollouts.iter_mut().try_for_each(|rollout| rollout.hold_out(every))?;
    }
    on_start(rollouts.iter().map(|rollout| rollout.steps.len()).sum());
    let mut scored = Vec::new();
    for (number, rollout) in rollouts.iter().enumerate() {
        let masks = masks.get(number).map(|folder| (folder.as_path(), *mask_rule));
        let scores = score(rollout, masks, on_step)?;
        scored.push(ScoredRollout::new(rollout, root.as_deref(), scores));
    }
    Ok(Report::new(scored))
}

/// Scores all steps of a rollout.
fn score(
    rollout: &GeneratedRollout,
    masks: Option<(&Path, MaskRule)>,
    on_step: &mut dyn FnMut(&str),
) -> Result<Scores, EvaluateError> {
    let mut scores = RolloutScores::new(masks.map_or(MaskRule::default(), |(_, rule)| rule));
    for step in &rollout.steps {
        let frame = rollout.read(step)?;
        let masks = masks.map(|(folder, _)| rollout.masks(step, folder)).transpose()?;
        let scored = ScoredFrame {
            t_s: step.t_s,
            generated: &frame.generated,
            truth: frame.truth.as_deref(),
            class: frame.class.as_deref(),
            moving: frame.moving.as_deref(),
            masks: masks.as_deref(),
        };
        scores.push(&scored).map_err(EvaluateError::at(&step.folder))?;
        on_step(&rollout.name_of(step));
    }
    Ok(scores.finish())
}
