use pskel_network::train::{RECENT_STEPS, StepReport, recent_loss};

use super::{Curve, Plot};

/// Plots the loss of each training step, and its mean over the last ones.
pub fn loss_plot(losses: &[StepReport]) -> Plot<'static> {
    let each = losses.iter().map(|report| [report.step as f64, report.loss]);
    let mean = (1..=losses.len()).map(|end| [(end - 1) as f64, recent_loss(&losses[..end])]);
    let curve = |name: &str, points, is_faint| Curve { name: name.to_owned(), points, is_faint };
    Plot {
        title: "Training",
        axes: ["step", "loss"],
        curves: vec![
            curve("a step", each.collect(), true),
            curve(&format!("mean of {RECENT_STEPS} steps"), mean.collect(), false),
        ],
    }
}
