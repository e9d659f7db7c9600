//! Captions of logs, images and frames.

mod images;

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Serialize, Serializer};
use serde_json::Value;

use self::images::ImageCaptions;
use super::write::meta::PromptParts;
use crate::dataset::{ImageRecord, Recording};
use crate::error::FileError;
use crate::files::{FileName, json};

/// Captions by name of a log, token of an image, or scene, camera and time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Captions {
    named: BTreeMap<String, Caption>,
    of_images: ImageCaptions,
}

/// Texts of a frame for a text encoder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Prompts {
    /// Text for all cameras; may be empty.
    Frame(String),
    /// Texts of the cameras, in the order of the log's.
    Cameras(Vec<String>),
}

impl Default for Prompts {
    fn default() -> Self {
        Self::Frame(String::new())
    }
}

impl Prompts {
    const NONE: &Self = &Self::Frame(String::new());
}

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
    const EXPECTED: &str = concat!(
        r#"{"LOG or TOKEN": "caption"}, {"LOG": {"time": "daytime", "weather": "clear"}} "#,
        r#"or {"SCENE_TOKEN|CHANNEL|TIME_US": {"time": "daytime", ..}}"#,
    );

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
    /// Keys `SCENE_TOKEN|CHANNEL|TIME_US`, as in the files of OpenDWM, have `time`, `weather`, `environment`,
    /// `objects` and `image_description`, each optional.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let wrong = |found: String| FileError::content(Caption::EXPECTED, found, path);
        let values: BTreeMap<String, Value> = json::read(path, Caption::EXPECTED)?;
        let mut captions = Self::default();
        for (name, value) in values {
            let added = captions.of_images.add(&name, &value).unwrap_or_else(|| {
                captions.named.insert(name.clone(), Caption::new(value)?);
                Ok(())
            });
            added.map_err(|found| wrong(format!("{found} for {name:?}")))?;
        }
        Ok(captions)
    }

    /// Returns the caption of a log: its own, else the prompt, or the data set's description; empty without
    /// any.
    pub fn of_log(&self, log: &Recording, prompt: &PromptParts) -> String {
        let given = self.named.get(&log.name).map(|caption| caption.text(log));
        given.or_else(|| prompt.prompt()).unwrap_or_else(|| log.description.clone())
    }

    /// Returns the captions of cameras at a time, absolute microseconds: the image's own, else the log's.
    /// `cameras` has names and the images at that time, if there are any.
    pub fn of_cameras(
        &self,
        log: &Recording,
        t_us: i64,
        cameras: &[(&FileName, Option<&ImageRecord>)],
        prompt: &PromptParts,
    ) -> Vec<String> {
        let mut captions = self.of_images(log, t_us, cameras).unwrap_or_default();
        captions.resize(cameras.len(), String::new());
        for ((_, image), caption) in cameras.iter().zip(&mut captions) {
            if let Some(own) = image.and_then(|image| self.named.get(&image.token)) {
                *caption = own.text(log);
            } else if caption.is_empty() {
                *caption = self.of_log(log, prompt);
            }
        }
        captions
    }

    /// Returns captions by scene, camera and time; `None` if there is none of this log.
    fn of_images(
        &self,
        log: &Recording,
        t_us: i64,
        cameras: &[(&FileName, Option<&ImageRecord>)],
    ) -> Option<Vec<String>> {
        let timed = cameras.iter().map(|(name, image)| (*name, image.map_or(t_us, |image| image.t_us)));
        self.of_images.of_cameras(&log.token, &timed.collect::<Vec<_>>())
    }

    /// Returns the captions of a log's frames: by scene, camera and time, else the first one among a frame's
    /// images by token in camera order, else the log's. A frame without any has the captions of the frame
    /// before, or none. `None` if no caption is of this log.
    pub fn of_frames(&self, log: &Recording) -> Option<FrameCaptions> {
        let of_log = self.named.get(&log.name);
        let mut captions: Vec<(i64, Prompts)> = Vec::new();
        for frame in &log.frames {
            let image_of = |channel| frame.images.iter().find(|image| image.channel == channel);
            let rig = log.rig.iter().map(|camera| camera.channel);
            let cameras: Vec<_> = rig.map(|channel| (&log.cameras[channel], image_of(channel))).collect();
            let of_cameras = self.of_images(log, frame.t_us, &cameras).map(Prompts::Cameras);
            let found = of_cameras.or_else(|| {
                let of_token = frame.images.iter().find_map(|image| self.named.get(&image.token));
                of_token.or(of_log).map(|caption| Prompts::Frame(caption.text(log)))
            });
            if let Some(found) = found
                && captions.last().map(|(_, last)| last) != Some(&found)
            {
                captions.push((frame.t_us, found));
            }
        }
        (!captions.is_empty()).then_some(FrameCaptions(captions))
    }
}

impl Serialize for Captions {
    /// Writes the entries of the file.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let value = |caption: &Caption| serde_json::to_value(caption).map_err(serde::ser::Error::custom);
        let named = self.named.iter().map(|(name, caption)| Ok((name.clone(), value(caption)?)));
        let entries: Result<BTreeMap<String, Value>, S::Error> =
            named.chain(self.of_images.entries().map(Ok)).collect();
        entries?.serialize(serializer)
    }
}

/// Captions of a log by time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FrameCaptions(Vec<(i64, Prompts)>);

impl FrameCaptions {
    /// Returns the captions at a time, absolute microseconds, of the last frame up to then; an empty text
    /// before the first frame with some.
    pub fn at(&self, t_us: i64) -> &Prompts {
        let after = self.0.partition_point(|(begin_us, _)| *begin_us <= t_us);
        after.checked_sub(1).map_or(Prompts::NONE, |place| &self.0[place].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Frame, ImageRecord, RigCamera};
    use crate::geometry::{Camera, Pose};

    fn captions(entries: &[(&str, &str)]) -> Captions {
        let entry = |(key, text): &(&str, &str)| ((*key).to_owned(), Caption::Text((*text).to_owned()));
        Captions { named: entries.iter().map(entry).collect(), ..Captions::default() }
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
            assert_eq!(captions.of_log(&log, &prompt), expected);
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
        let log = Recording {
            name: "log".into(),
            description: "described".into(),
            cameras: vec!["a".parse().unwrap(), "b".parse().unwrap()],
            ..Recording::default()
        };
        let prompt = PromptParts { weather: Some("Rainy".into()), city: None };
        let none = PromptParts::default();
        let (own, none_of_its_own) = (image("t"), image("u"));
        let cameras = [(&log.cameras[0], Some(&own)), (&log.cameras[1], Some(&none_of_its_own))];
        assert_eq!(captions.of_cameras(&log, 0, &cameras, &prompt), ["image", "of the log"]);
        let other = Recording { name: "other".into(), ..log.clone() };
        assert_eq!(captions.of_log(&other, &prompt), "Rainy. A driving scene");
        assert_eq!(captions.of_cameras(&other, 0, &cameras, &none), ["image", "described"]);
    }

    fn image(token: &str) -> ImageRecord {
        ImageRecord {
            token: token.to_owned(),
            path: "a.jpg".into(),
            row: None,
            t_us: 0,
            channel: 0,
            global_from_ego: Pose::IDENTITY,
            ego_from_camera: Pose::IDENTITY,
            camera: Camera::new("c", 2, 2, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
                .unwrap()
                .into(),
        }
    }

    fn frame(t_us: i64, tokens: &[&str]) -> Frame {
        Frame {
            t_us,
            global_from_ego: Pose::IDENTITY,
            sweeps: Vec::new(),
            images: tokens.iter().map(|token| image(token)).collect(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        }
    }

    #[test]
    fn frames_have_the_captions_of_their_images() {
        let frames =
            vec![frame(10, &["x"]), frame(20, &["x", "rain"]), frame(30, &["y"]), frame(40, &["sun"])];
        let log = Recording { name: "log".into(), frames, ..Recording::default() };
        let found = captions(&[("rain", "Rainy"), ("sun", "Sunny")]).of_frames(&log).unwrap();
        let text = |text: &str| Prompts::Frame(text.to_owned());
        let seen = [5, 10, 19, 20, 35, 40, 99].map(|t_us| found.at(t_us).clone());
        assert_eq!(seen, ["", "", "", "Rainy", "Rainy", "Sunny", "Sunny"].map(text));
        let found = captions(&[("rain", "Rainy"), ("log", "Dry")]).of_frames(&log).unwrap();
        assert_eq!([10, 20, 30].map(|t_us| found.at(t_us).clone()), ["Dry", "Rainy", "Dry"].map(text));
        assert_eq!(captions(&[("other", "Rainy")]).of_frames(&log), None);
    }

    #[test]
    fn cameras_have_captions_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("captions.json");
        let text = r#"{"s|a|10": {"time": "Day", "image_description": "A bus"}, "log": "Dry",
            "s|b|10": {"time": "Day"}, "s|b|30": {"time": "Night", "objects": "cars"}}"#;
        std::fs::write(&path, text).unwrap();
        let captions = Captions::read(&path).unwrap();
        assert_eq!(serde_json::to_value(&captions).unwrap(), serde_json::from_str::<Value>(text).unwrap());
        let log = Recording {
            name: "log".into(),
            token: "s".into(),
            cameras: ["none", "a", "b"].map(|name| name.parse().unwrap()).to_vec(),
            // A camera without any image is not in the scenes.
            rig: [1, 2].map(|channel| RigCamera { channel, ..RigCamera::from(&image("x")) }).to_vec(),
            frames: vec![frame(10, &[]), frame(30, &[])],
            ..Recording::default()
        };
        let found = captions.of_frames(&log).unwrap();
        let cameras = |texts: [&str; 2]| Prompts::Cameras(texts.map(str::to_owned).to_vec());
        assert_eq!(found.at(10), &cameras(["Day. A bus", "Day"]));
        assert_eq!(found.at(30), &cameras(["Day. A bus", "Day. cars"]));
        assert_eq!(found.at(9), &Prompts::default());
        let none = PromptParts::default();
        let cameras = [(&log.cameras[1], None), (&log.cameras[2], None)];
        assert_eq!(captions.of_cameras(&log, 12, &cameras, &none), ["Day. A bus", "Day"]);
        // Logs of other data sets have no token.
        let other = Recording { token: String::new(), ..log.clone() };
        assert_eq!(captions.of_cameras(&other, 12, &cameras, &none), ["Dry", "Dry"]);
        std::fs::write(&path, r#"{"s|a|10": {"season": "fall"}}"#).unwrap();
        let message = Captions::read(&path).unwrap_err().to_string();
        assert!(message.contains("found a field \"season\" for \"s|a|10\""), "{message}");
    }
}
