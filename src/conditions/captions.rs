//! Captions of logs, images and frames.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::meta::PromptParts;
use crate::dataset::Recording;
use crate::error::FileError;
use crate::files::json;

/// Captions by name of a log or token of an image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Captions(BTreeMap<String, String>);

impl Captions {
    /// Reads `{"LOG or TOKEN": "caption"}`.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        json::read(path, r#"{"LOG or TOKEN": "caption"}"#).map(Self)
    }

    /// Returns the caption of an image: its own, that of the log, the prompt, or the description in the data set; empty
    /// without any.
    pub fn of<'a>(&'a self, token: Option<&str>, log: &'a Recording, prompt: &'a PromptParts) -> String {
        let given = token.and_then(|token| self.0.get(token)).or_else(|| self.0.get(&log.name));
        given.cloned().or_else(|| prompt.prompt()).unwrap_or_else(|| log.description.clone())
    }

    /// Returns the captions of the frames of a log: that of the first of a frame's images which has one, in the order of
    /// the cameras, or that of the log. A frame without either has the caption of the frame before, or none. `None` if no
    /// caption is of this log.
    pub fn of_frames(&self, log: &Recording) -> Option<FrameCaptions> {
        let of_log = self.0.get(&log.name);
        let mut captions: Vec<(i64, String)> = Vec::new();
        for frame in &log.frames {
            let caption = frame.images.iter().find_map(|image| self.0.get(&image.token)).or(of_log);
            let last = captions.last().map(|(_, caption)| caption);
            if let Some(caption) = caption
                && last != Some(caption)
            {
                captions.push((frame.t_us, caption.clone()));
            }
        }
        (!captions.is_empty()).then_some(FrameCaptions(captions))
    }
}

/// Captions of a log by time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FrameCaptions(Vec<(i64, String)>);

impl FrameCaptions {
    /// Returns the caption at a time, absolute microseconds: that of the last frame up to then; empty before the first
    /// frame with a caption.
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
        let captions = |entries: &[(&str, &str)]| {
            Captions(entries.iter().map(|(key, text)| ((*key).to_owned(), (*text).to_owned())).collect())
        };
        let found = captions(&[("rain", "Rainy"), ("sun", "Sunny")]).of_frames(&log).unwrap();
        let seen: Vec<&str> = [5, 10, 19, 20, 35, 40, 99].map(|t_us| found.at(t_us)).to_vec();
        assert_eq!(seen, ["", "", "", "Rainy", "Rainy", "Sunny", "Sunny"]);
        let found = captions(&[("rain", "Rainy"), ("log", "Dry")]).of_frames(&log).unwrap();
        assert_eq!([10, 20, 30].map(|t_us| found.at(t_us)), ["Dry", "Rainy", "Dry"]);
        assert_eq!(captions(&[("other", "Rainy")]).of_frames(&log), None);
    }
}
