//! Captions of logs, images and frames.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::write::meta::PromptParts;
use crate::dataset::Recording;
use crate::error::FileError;
use crate::files::json;

/// Captions by name of a log or token of an image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Captions(BTreeMap<String, Caption>);

/// A caption as written in a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
enum Caption {
    /// The whole text.
    Text(String),
    /// Parts of captions for the nuPlan networks of *Point as Skeleton*, in the format of `nuplan_text.json`.
    Parts {
        #[serde(skip_serializing_if = "Option::is_none")]
        time: Option<String>,
        #[serde(skip_serializing_if = "Option::is_none")]
        weather: Option<String>,
    },
}

impl Caption {
    /// Content of a caption file.
    const EXPECTED: &str =
        r#"{"LOG or TOKEN": "caption"} or {"LOG": {"time": "daytime", "weather": "clear"}}"#;

    /// Converts a JSON value. Returns a description of the value if it is no caption.
    fn new(value: Value) -> Result<Self, String> {
        let mut fields = match value {
            Value::String(text) => return Ok(Self::Text(text)),
            Value::Object(fields) => fields,
            other => return Err(other.to_string()),
        };
        let mut text = |name: &str| match fields.remove(name) {
            None | Some(Value::Null) => Ok(None),
            Some(Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(format!("{name} {other}")),
        };
        let (time, weather) = (text("time")?, text("weather")?);
        match fields.keys().next() {
            None => Ok(Self::Parts { time, weather }),
            Some(other) => Err(format!("a field {other:?}")),
        }
    }

    /// Returns the text for a log. Parts become the captions that the networks were trained with, `daytime.
    /// clear. This is a nuplan video clip from las_vegas`.
    fn text(&self, log: &Recording) -> String {
        let (time, weather) = match self {
            Self::Text(text) => return text.clone(),
            Self::Parts { time, weather } => (time, weather),
        };
        let clip = match log.location.as_str() {
            "" => "This is a nuplan video clip".to_owned(),
            location => format!("This is a nuplan video clip from {location}"),
        };
        let parts = [time.as_ref(), weather.as_ref(), Some(&clip)];
        parts.into_iter().flatten().map(String::as_str).collect::<Vec<_>>().join(". ")
    }
}

impl Captions {
    /// Reads `{"LOG or TOKEN": "caption"}`; a caption may also be `{"time": "daytime", "weather": "clear"}`.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let wrong = |found: String| FileError::content(Caption::EXPECTED, found, path);
        let caption = |(name, value): (String, Value)| match Caption::new(value) {
            Ok(caption) => Ok((name, caption)),
            Err(found) => Err(wrong(format!("{found} for {name:?}"))),
        };
        let values: BTreeMap<String, Value> = json::read(path, Caption::EXPECTED)?;
        values.into_iter().map(caption).collect::<Result<_, _>>().map(Self)
    }

    /// Returns the caption of an image: its own, else the log's, the prompt, or the data set's description;
    /// empty without any.
    pub fn of<'a>(&'a self, token: Option<&str>, log: &'a Recording, prompt: &'a PromptParts) -> String {
        let given = token.and_then(|token| self.0.get(token)).or_else(|| self.0.get(&log.name));
        let given = given.map(|caption| caption.text(log));
        given.or_else(|| prompt.prompt()).unwrap_or_else(|| log.description.clone())
    }

    /// Returns the captions of a log's frames: the first caption among a frame's images in camera order, else
    /// the log's. A frame without either has the caption of the frame before, or none. `None` if no caption
    /// is of this log.
    pub fn of_frames(&self, log: &Recording) -> Option<FrameCaptions> {
        let of_log = self.0.get(&log.name);
        let mut captions: Vec<(i64, String)> = Vec::new();
        for frame in &log.frames {
            let caption = frame.images.iter().find_map(|image| self.0.get(&image.token)).or(of_log);
            let last = captions.last().map(|(_, caption)| caption);
            if let Some(caption) = caption.map(|caption| caption.text(log))
                && last != Some(&caption)
            {
                captions.push((frame.t_us, caption));
            }
        }
        (!captions.is_empty()).then_some(FrameCaptions(captions))
    }
}

/// Captions of a log by time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FrameCaptions(Vec<(i64, String)>);

impl FrameCaptions {
    /// Returns the caption at a time, absolute microseconds: the caption of the last frame up to then; empty
    /// before the first frame with one.
    pub fn at(&self, t_us: i64) -> &str {
        let after = self.0.partition_point(|(begin_us, _)| *begin_us <= t_us);
        after.checked_sub(1).map_or("", |place| &self.0[place].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Frame, ImageRecord};
    use crate::geometry::{Camera, Pose};

    fn captions(entries: &[(&str, &str)]) -> Captions {
        let entry = |(key, text): &(&str, &str)| ((*key).to_owned(), Caption::Text((*text).to_owned()));
        Captions(entries.iter().map(entry).collect())
    }

    #[test]
    fn time_and_weather_become_training_captions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("captions.json");
        let text = r#"{"a": {"time": "daytime", "weather": "clear, sunny"}, "b": {"weather": "overcast"},
            "c": {}, "d": "Rain"}"#;
        std::fs::write(&path, text).unwrap();
        let (captions, prompt) = (Captions::read(&path).unwrap(), PromptParts::default());
        let log = |name: &str, location: &str| Recording {
            name: name.into(),
            location: location.into(),
            ..Recording::default()
        };
        for (log, expected) in [
            (log("a", "las_vegas"), "daytime. clear, sunny. This is a nuplan video clip from las_vegas"),
            (log("a", ""), "daytime. clear, sunny. This is a nuplan video clip"),
            (log("b", "sg"), "overcast. This is a nuplan video clip from sg"),
            (log("c", "sg"), "This is a nuplan video clip from sg"),
            (log("d", "sg"), "Rain"),
        ] {
            assert_eq!(captions.of(None, &log, &prompt), expected);
        }
        // Options of an export are compared as text.
        assert_eq!(serde_json::to_value(&captions).unwrap(), serde_json::from_str::<Value>(text).unwrap());
        for (text, found) in [
            (r#"{"a": 5}"#, "found 5 for \"a\""),
            (r#"{"a": {"time": 5}}"#, "found time 5 for \"a\""),
            (r#"{"a": {"season": "fall"}}"#, "found a field \"season\" for \"a\""),
            (r#"["a"]"#, "found an array instead of an object"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = Captions::read(&path).unwrap_err().to_string();
            assert!(message.contains(found) && message.ends_with("captions.json"), "{message}");
        }
    }

    #[test]
    fn most_specific_caption_is_used() {
        let captions = captions(&[("t", "image"), ("log", "of the log")]);
        let log = Recording { name: "log".into(), description: "described".into(), ..Recording::default() };
        let prompt = PromptParts { weather: Some("Rainy".into()), city: None };
        let none = PromptParts::default();
        assert_eq!(captions.of(Some("t"), &log, &prompt), "image");
        assert_eq!(captions.of(Some("u"), &log, &prompt), "of the log");
        let other = Recording { name: "other".into(), ..log };
        assert_eq!(captions.of(None, &other, &prompt), "Rainy. A driving scene");
        assert_eq!(captions.of(None, &other, &none), "described");
    }

    #[test]
    fn frames_have_the_captions_of_their_images() {
        let image = |token: &str| ImageRecord {
            token: token.to_owned(),
            path: "a.jpg".into(),
            t_us: 0,
            channel: 0,
            global_from_ego: Pose::IDENTITY,
            ego_from_camera: Pose::IDENTITY,
            camera: Camera::new("c", 2, 2, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).unwrap(),
        };
        let frame = |t_us: i64, tokens: &[&str]| Frame {
            t_us,
            global_from_ego: Pose::IDENTITY,
            sweeps: Vec::new(),
            images: tokens.iter().map(|token| image(token)).collect(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        let frames =
            vec![frame(10, &["x"]), frame(20, &["x", "rain"]), frame(30, &["y"]), frame(40, &["sun"])];
        let log = Recording { name: "log".into(), frames, ..Recording::default() };
        let found = captions(&[("rain", "Rainy"), ("sun", "Sunny")]).of_frames(&log).unwrap();
        let seen: Vec<&str> = [5, 10, 19, 20, 35, 40, 99].map(|t_us| found.at(t_us)).to_vec();
        assert_eq!(seen, ["", "", "", "Rainy", "Rainy", "Sunny", "Sunny"]);
        let found = captions(&[("rain", "Rainy"), ("log", "Dry")]).of_frames(&log).unwrap();
        assert_eq!([10, 20, 30].map(|t_us| found.at(t_us)), ["Dry", "Rainy", "Dry"]);
        assert_eq!(captions(&[("other", "Rainy")]).of_frames(&log), None);
    }
}
