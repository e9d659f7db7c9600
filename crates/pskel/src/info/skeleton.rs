//! Description of a skeleton as text and as JSON.

use std::collections::BTreeMap;
use std::fmt::Write;

use glam::{DVec3, Vec3};
use point_skeleton::cloud::Bounds;
use point_skeleton::files::text::printable_line;
use point_skeleton::skeleton::{BuildReport, Manifest, Skeleton, TemplateKind};
use serde_json::{Value, json};

/// Assets of one category.
#[derive(Default)]
struct Tally {
    actors: usize,
    points: usize,
    sweeps: usize,
}

/// Describes a skeleton as JSON.
pub(super) fn describe(skeleton: &Skeleton) -> Value {
    let manifest = &skeleton.manifest;
    let categories: BTreeMap<&str, Value> = tallies(manifest)
        .into_iter()
        .map(|(name, t)| (name, json!({"actors": t.actors, "points": t.points, "sweeps": t.sweeps})))
        .collect();
    let templates: BTreeMap<&str, Value> = manifest
        .templates
        .iter()
        .map(|t| (kind_name(t.kind), json!({"points": t.points, "size": t.size})))
        .collect();
    json!({
        "kind": "skeleton",
        "path": skeleton.path(),
        "sources": manifest.sources,
        "background": {
            "points": background_points(manifest),
            "chunks": manifest.background.len(),
            "bounds": bounds(manifest).map(|[min, max]| json!({"min": min.to_array(), "max": max.to_array()})),
        },
        "actors": {"count": manifest.actors.len(), "points": actor_points(manifest), "categories": categories},
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
        format!("{} points in {} chunks", background_points(manifest), manifest.background.len()),
    );
    if let Some([min, max]) = bounds(manifest) {
        let [x, y, z] = (max - min).to_array();
        line("bounds", format!("{x:.1} x {y:.1} x {z:.1} m, {min:.1} to {max:.1}"));
    }
    line("actors", format!("{} with {} points", manifest.actors.len(), actor_points(manifest)));
    for (category, t) in tallies(manifest) {
        line("", format!("{category}: {} with {} points from {} sweeps", t.actors, t.points, t.sweeps));
    }
    let of = |t: &point_skeleton::skeleton::Template| format!("{} ({} points)", kind_name(t.kind), t.points);
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
    let Ok(Value::Object(report)) = serde_json::to_value(report) else { return String::new() };
    let reasons = report.iter().filter_map(|(name, count)| Some((name.strip_prefix("dropped_")?, count)));
    reasons.map(|(name, count)| format!("{count} {}", name.replace('_', " "))).collect::<Vec<_>>().join(", ")
}

/// Counts assets by category.
fn tallies(manifest: &Manifest) -> BTreeMap<&str, Tally> {
    let mut tallies: BTreeMap<&str, Tally> = BTreeMap::new();
    for asset in &manifest.actors {
        let tally = tallies.entry(&asset.category).or_default();
        tally.actors += 1;
        tally.points += asset.points;
        tally.sweeps += asset.sweeps;
    }
    tallies
}

fn background_points(manifest: &Manifest) -> usize {
    manifest.background.iter().map(|c| c.points).sum()
}

fn actor_points(manifest: &Manifest) -> usize {
    manifest.actors.iter().map(|a| a.points).sum()
}

fn kind_name(kind: TemplateKind) -> &'static str {
    TemplateKind::NAMES.iter().find(|(_, k)| *k == kind).map_or("", |(name, _)| name)
}

/// Returns minimum and maximum global coordinates of the background.
fn bounds(manifest: &Manifest) -> Option<[DVec3; 2]> {
    let global = |origin: [f64; 3], local: [f32; 3]| DVec3::from(origin) + Vec3::from(local).as_dvec3();
    let of = |origin: [f64; 3], b: &Bounds| [global(origin, b.min), global(origin, b.max)];
    let all = manifest.background.iter().map(|c| of(c.origin, &c.bounds));
    all.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}
