//! Description of a template folder as text and as JSON.

use std::fmt::Write;
use std::path::Path;

use point_skeleton::files::text::printable_line;
use point_skeleton::skeleton::{TemplateLibrary, TemplateSummary};
use serde_json::{Value, json};

/// Describes a library of templates as JSON.
pub(super) fn describe(library: &TemplateLibrary, path: &Path) -> Value {
    let manifest = &library.manifest;
    json!({
        "kind": "templates",
        "path": path,
        "sources": manifest.sources,
        "templates": manifest.templates,
        "report": manifest.report,
        "options": manifest.options,
    })
}

/// Formats the description as lines for the terminal.
pub(super) fn text(library: &TemplateLibrary, path: &Path) -> String {
    let manifest = &library.manifest;
    let mut lines = format!("templates  {}\n", path.display());
    // Writing to a string cannot fail.
    let mut line = |name: &str, rest: String| {
        let _ = writeln!(lines, "{name:<10} {}", printable_line(&rest));
    };
    for log in &manifest.sources {
        line("log", format!("{} ({}), {} actors", log.source.log, log.source.location, log.actors));
    }
    for summary in &manifest.report.templates {
        line("template", of_template(summary));
        for cluster in &summary.clusters {
            let (count, points) = (cluster.members.len(), cluster.points_in);
            let unused = if cluster.used { "" } else { " (not used)" };
            let size = size_of(cluster.size);
            line("", format!("  {size}: {count} actors with {points} points{unused}"));
        }
    }
    for (note, count) in &manifest.report.notes {
        line("left out", format!("{count} {note}"));
    }
    lines
}

fn of_template(summary: &TemplateSummary) -> String {
    let extent = summary.bounds.map_or("nothing".to_owned(), |b| {
        size_of(std::array::from_fn(|a| f64::from(b.max[a]) - f64::from(b.min[a])))
    });
    format!(
        "{}: {} points of {extent} in a box of {}, {:.3} m apart, from {} points of {} actors, {} outliers, \
         {} of one actor alone",
        summary.kind.name(),
        summary.points,
        size_of(summary.size),
        summary.spacing_m,
        summary.points_in,
        summary.instances,
        summary.outliers,
        summary.not_agreed,
    )
}

fn size_of([x, y, z]: [f64; 3]) -> String {
    format!("{x:.2} x {y:.2} x {z:.2} m")
}
