//! Description of a skeleton as text and as JSON.

use std::collections::BTreeMap;
use std::fmt::Write;

use point_skeleton::files::text::printable_line;
use point_skeleton::skeleton::{BuildReport, Skeleton, Template};
use serde_json::{Value, json};

/// Describes a skeleton as JSON.
pub(super) fn describe(skeleton: &Skeleton) -> Value {
    let manifest = &skeleton.manifest;
    let templates: BTreeMap<&str, Value> = manifest
        .templates
        .iter()
        .map(|t| (t.kind.name(), json!({"points": t.points, "size": t.size})))
        .collect();
    json!({
        "kind": "skeleton",
        "path": skeleton.path(),
        "sources": manifest.sources,
        "background": {
            "points": manifest.background_points(),
            "chunks": manifest.background.len(),
            "bounds": manifest.background_bounds().map(|[min, max]| json!({"min": min.to_array(),
            "max": max.to_array()})),
        },
        "actors": {"count": manifest.actors.len(), "points": manifest.actor_points(),
            "categories": manifest.categories()},
        "templates": templates,
        "report": manifest.report,
        "options": manifest.options,
    })
}

/// Formats the description as lines for the terminal.
pub(super) fn text(skeleton: &Skeleton) -> String {
    let manifest = &skeleton.manifest;
    let report = &manifest.report;
    let mut lines = format!("skeleton   {}\n", skeleton.path().display());
    // Writing to a string cannot fail.
    let mut line = |name: &str, rest: String| {
        let _ = writeln!(lines, "{name:<10} {}", printable_line(&rest));
    };
    for source in &manifest.sources {
        let seconds = (source.t_us[1] - source.t_us[0]) as f64 * 1e-6;
        let what =
            format!("{} ({}), {} frames over {seconds:.1} s", source.log, source.location, source.frames);
        line("log", what);
    }
    line(
        "background",
        format!("{} points in {} chunks", manifest.background_points(), manifest.background.len()),
    );
    if let Some([min, max]) = manifest.background_bounds() {
        let [x, y, z] = (max - min).to_array();
        line("bounds", format!("{x:.1} x {y:.1} x {z:.1} m, {min:.1} to {max:.1}"));
    }
    line("actors", format!("{} with {} points", manifest.actors.len(), manifest.actor_points()));
    for (category, t) in manifest.categories() {
        line("", format!("{category}: {} with {} points from {} sweeps", t.actors, t.points, t.sweeps));
    }
    let of = |t: &Template| format!("{} ({} points)", t.kind.name(), t.points);
    match manifest.templates.iter().map(of).collect::<Vec<_>>() {
        none if none.is_empty() => line("templates", "none".to_owned()),
        some => line("templates", some.join(", ")),
    }
    line(
        "read",
        format!("{} points of {} sweeps, {} images", report.points_read, report.sweeps, report.images),
    );
    line("dropped", dropped(report));
    for (note, count) in &report.notes {
        line("note", format!("{count} {note}"));
    }
    lines
}

/// Lists the numbers of dropped points, by reason.
pub(crate) fn dropped(report: &BuildReport) -> String {
    report.dropped().map(|(reason, count)| format!("{count} {reason}")).join(", ")
}
