//! Validation of names in data that become names of files and folders.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Deref;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::text::{acts, printable};
use crate::error::FileError;

/// Name that is a single path component: joined to a folder, it stays in that folder and does not collide
/// with the files that commands write there.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FileName(String);

/// Error for a text that is not a valid [`FileName`], or not the name of a file below a data set's folder.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {}", printable(found))]
pub struct NameError {
    /// Description of a valid name.
    pub expected: String,
    /// The rejected text in quotes.
    pub found: String,
}

/// File and folder names that commands write beside camera folders, in lower case.
const RESERVED: [&str; 16] = [
    "birdseye.png",
    "cache",
    "conditions.safetensors",
    "forecast",
    "generated",
    "generated.json",
    "generator.safetensors",
    "index.html",
    "index.json",
    "maps.npz",
    "meta.json",
    "rollout.json",
    "sheet.png",
    "state.json",
    "truth",
    "view",
];

impl FileName {
    /// Maximum length in bytes: file systems allow 255, and suffixes are appended.
    pub const MAX_BYTES: usize = 128;

    /// Validates a text.
    ///
    /// # Errors
    /// Fails if the text is empty or longer than [`Self::MAX_BYTES`], begins with a dot, contains `/`, `\` or
    /// a character that controls a terminal, or is the name of a file that commands write.
    pub fn new(text: &str) -> Result<Self, NameError> {
        let wrong =
            |expected: &str| Err(NameError { expected: expected.to_owned(), found: format!("{text:?}") });
        if text.is_empty() || text.len() > Self::MAX_BYTES {
            return wrong("a name of 1 to 128 bytes");
        }
        if text.starts_with('.') || text.contains(['/', '\\']) || text.chars().any(acts) {
            return wrong("a name without /, \\, control characters or a leading dot");
        }
        if RESERVED.contains(&text.to_lowercase().as_str()) {
            return wrong("a name other than those of the files that stand beside cameras");
        }
        Ok(Self(text.to_owned()))
    }

    /// Returns the text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl NameError {
    /// Adds to the error which item has the name.
    #[must_use]
    pub fn of(self, what: &str) -> Self {
        Self { expected: format!("{} as {what}", self.expected), ..self }
    }

    /// Adds the file that contains the name.
    pub fn in_file(self, path: &Path) -> FileError {
        FileError::content(self.expected, self.found, path)
    }
}

/// Returns the first repeated name, ignoring case, because some file systems ignore it too.
pub(crate) fn first_twice<'a>(names: impl IntoIterator<Item = &'a FileName>) -> Option<&'a FileName> {
    let mut seen = BTreeSet::new();
    names.into_iter().find(|name| !seen.insert(name.to_lowercase()))
}

/// Name of unnamed items.
impl Default for FileName {
    fn default() -> Self {
        Self("camera".to_owned())
    }
}

impl TryFrom<String> for FileName {
    type Error = NameError;

    fn try_from(text: String) -> Result<Self, NameError> {
        Self::new(&text)
    }
}

impl FromStr for FileName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl From<FileName> for String {
    fn from(name: FileName) -> Self {
        name.0
    }
}

impl Deref for FileName {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl AsRef<str> for FileName {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

impl AsRef<Path> for FileName {
    fn as_ref(&self) -> &Path {
        Path::new(&self.0)
    }
}

/// Formats like the inner string, so that values derived from debug output do not depend on the type.
impl fmt::Debug for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.0, f)
    }
}

impl fmt::Display for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl PartialEq<str> for FileName {
    fn eq(&self, other: &str) -> bool {
        self.0 == other
    }
}

impl PartialEq<&str> for FileName {
    fn eq(&self, other: &&str) -> bool {
        self.0 == *other
    }
}

impl PartialEq<String> for FileName {
    fn eq(&self, other: &String) -> bool {
        self.0 == *other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_their_folder() {
        for good in ["CAM_FRONT", "ring_front_center", "a", "Kamera vorn é", "a.b", "a..", &"x".repeat(128)]
        {
            assert_eq!(FileName::new(good).unwrap().as_str(), good);
        }
        let long = "x".repeat(129);
        for bad in [
            "",
            ".",
            "..",
            "...",
            ".hidden",
            "/",
            "/abs",
            "a/b",
            "../x",
            "a/",
            "\\",
            "a\\b",
            "a\0b",
            "a\nb",
            "\u{1b}[2J",
            "a\u{7f}",
            "a\u{85}",
            "\u{202e}a",
            "a\u{2028}",
            &long,
            "meta.json",
            "META.json",
            "sheet.png",
            "Birdseye.PNG",
            "generated",
            "truth",
            "view",
            "forecast",
            "state.json",
            "cache",
        ] {
            let error = FileName::new(bad).unwrap_err();
            let message = error.to_string();
            assert!(message.starts_with("expected a name ") && !message.chars().any(acts), "{message}");
            assert_eq!(serde_json::from_value::<FileName>(bad.into()).ok(), None);
            assert!(error.in_file(Path::new("sensor.json")).to_string().ends_with(": sensor.json"));
        }
    }

    #[test]
    fn case_is_ignored() {
        let names = ["a", "b", "É", "A", "é"].map(|name| FileName::new(name).unwrap());
        assert_eq!(first_twice(&names).map(FileName::as_str), Some("A"));
        assert_eq!(first_twice(&names[..3]), None);
    }
}
