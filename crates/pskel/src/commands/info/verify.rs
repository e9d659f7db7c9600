//! `pskel info --verify`: checks all points of a skeleton or of templates against their checksums.

use std::fmt::Write;
use std::path::Path;

use point_skeleton::skeleton::{Skeleton, TemplateLibrary};
use serde_json::{Value, json};

use crate::WrongUsage;

/// Result of the verification.
pub(super) struct Verified {
    clouds: usize,
    points: usize,
    /// A message for each cloud whose points do not match their checksum.
    damaged: Vec<String>,
}

/// Reads and verifies all points at a path.
///
/// # Errors
/// Fails if the path is neither a skeleton nor a folder of templates, if a file cannot be opened, or if a
/// template of a library is damaged.
pub(super) fn verify(target: &str) -> anyhow::Result<Verified> {
    let path = Path::new(target);
    if Skeleton::is_at(path) {
        let skeleton = Skeleton::open(path)?;
        let manifest = &skeleton.manifest;
        return Ok(Verified {
            clouds: manifest.background.len() + manifest.actors.len() + manifest.templates.len(),
            points: manifest.points(),
            damaged: skeleton.damage().iter().map(ToString::to_string).collect(),
        });
    }
    if TemplateLibrary::is_at(path) {
        // Opening a library verifies all checksums.
        let clouds = TemplateLibrary::open(path)?.clouds;
        let points = clouds.iter().map(|(_, points)| points.len()).sum();
        return Ok(Verified { clouds: clouds.len(), points, damaged: Vec::new() });
    }
    let message = format!("expected a folder of a skeleton or of templates for --verify, found {target}");
    Err(WrongUsage(message).into())
}

impl Verified {
    /// Formats the result as JSON.
    pub(super) fn json(&self) -> Value {
        let Self { clouds, points, damaged } = self;
        json!({"clouds": clouds, "points": points, "damaged": damaged})
    }

    /// Formats the result as lines for the terminal.
    pub(super) fn text(&self) -> String {
        let Self { clouds, points, damaged } = self;
        let found = match damaged.len() {
            0 => "all checksums match".to_owned(),
            count => format!("{count} damaged"),
        };
        let mut lines = format!("{:<10} {points} points in {clouds} clouds, {found}\n", "verified");
        for message in damaged {
            // Writing to a string cannot fail.
            let _ = writeln!(lines, "{:<10} {message}", "");
        }
        lines
    }

    /// Checks that no cloud is damaged.
    ///
    /// # Errors
    /// Fails if any cloud is damaged.
    pub(super) fn result(&self, target: &str) -> anyhow::Result<()> {
        let (clouds, damaged) = (self.clouds, self.damaged.len());
        anyhow::ensure!(damaged == 0, "{damaged} of {clouds} clouds are damaged: {target}");
        Ok(())
    }
}
