//! Captions of logs and images.

use std::collections::BTreeMap;
use std::path::Path;

use point_skeleton::conditions::meta::PromptParts;
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use serde::Serialize;

/// Captions by name of a log or token of an image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Captions(BTreeMap<String, String>);

impl Captions {
    /// Reads `{"LOG or TOKEN": "caption"}`.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let parsed = serde_json::from_slice(&read_table(path)?).map(Self);
        parsed.map_err(|e| FileError::content(r#"{"LOG or TOKEN": "caption"}"#, e.to_string(), path))
    }

    /// Returns the caption of an image: its own, that of the log, the prompt, or the description in the data set; empty
    /// without any.
    pub(crate) fn of<'a>(
        &'a self,
        token: Option<&str>,
        log: &'a Recording,
        prompt: &'a PromptParts,
    ) -> String {
        let given = token.and_then(|token| self.0.get(token)).or_else(|| self.0.get(&log.name));
        given.cloned().or_else(|| prompt.prompt()).unwrap_or_else(|| log.description.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closest_caption_is_used() {
        let captions: BTreeMap<String, String> =
            [("t", "image"), ("log", "of the log")].map(|(k, v)| (k.into(), v.into())).into();
        let captions = Captions(captions);
        let log = Recording { name: "log".into(), description: "described".into(), ..Recording::default() };
        let prompt = PromptParts { weather: Some("Rainy".into()), city: None };
        let none = PromptParts::default();
        assert_eq!(captions.of(Some("t"), &log, &prompt), "image");
        assert_eq!(captions.of(Some("u"), &log, &prompt), "of the log");
        let other = Recording { name: "other".into(), ..log };
        assert_eq!(captions.of(None, &other, &prompt), "Rainy. A driving scene");
        assert_eq!(captions.of(None, &other, &none), "described");
    }
}
