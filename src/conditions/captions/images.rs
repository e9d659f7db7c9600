use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::files::FileName;

/// Captions by scene token and channel, then by time in microseconds. Source: the caption files that OpenDWM
/// publishes for nuScenes, whose keys are `SCENE_TOKEN|CHANNEL|TIME_US`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct ImageCaptions(BTreeMap<(String, String), BTreeMap<i64, ImageCaption>>);

/// Parts of an image's caption, in the order of [`FIELDS`]; empty if absent.
type ImageCaption = [String; FIELDS.len()];

const FIELDS: [&str; 5] = ["time", "weather", "environment", "objects", "image_description"];
/// Number of the first fields, which all cameras of a frame have in common.
const COMMON: usize = 2;

impl ImageCaptions {
    /// Adds the caption of an image. `None` if the key is of another kind.
    pub(super) fn add(&mut self, key: &str, value: &Value) -> Option<Result<(), String>> {
        let mut parts = key.rsplitn(3, '|');
        let (time, channel, scene) = (parts.next()?, parts.next()?, parts.next()?);
        let t_us: i64 = time.parse().ok()?;
        Some(caption(value).map(|caption| {
            let camera = (scene.to_owned(), channel.to_owned());
            self.0.entry(camera).or_default().insert(t_us, caption);
        }))
    }

    /// Returns the texts of cameras at the times of their images; `None` without a caption of the scene. Each
    /// is of the caption nearest in time; most cameras decide on time of day and weather.
    pub(super) fn of_cameras(&self, scene: &str, cameras: &[(&FileName, i64)]) -> Option<Vec<String>> {
        let nearest = |(channel, t_us): &(&FileName, i64)| {
            let captions = self.0.get(&(scene.to_owned(), channel.to_string()))?;
            let before = captions.range(..=t_us).next_back();
            let after = captions.range(t_us..).next();
            let both = before.into_iter().chain(after);
            both.min_by_key(|(found_us, _)| found_us.abs_diff(*t_us)).map(|(_, caption)| caption)
        };
        let found: Vec<Option<&ImageCaption>> = cameras.iter().map(nearest).collect();
        let common: [&str; COMMON] = std::array::from_fn(|field| {
            most_common(found.iter().flatten().map(|caption| caption[field].as_str()))
        });
        let text = |caption: &ImageCaption| {
            let own = caption[COMMON..].iter().map(String::as_str);
            let parts = common.into_iter().chain(own).filter(|part| !part.is_empty());
            parts.collect::<Vec<_>>().join(". ")
        };
        let texts = || found.iter().map(|caption| caption.map(text).unwrap_or_default()).collect();
        found.iter().any(Option::is_some).then(texts)
    }

    /// Returns the entries of the file.
    pub(super) fn entries(&self) -> impl Iterator<Item = (String, Value)> {
        self.0.iter().flat_map(|((scene, channel), captions)| {
            captions.iter().map(move |(t_us, caption)| {
                let fields = FIELDS.iter().zip(caption).filter(|(_, text)| !text.is_empty());
                let fields: Map<String, Value> =
                    fields.map(|(name, text)| ((*name).to_owned(), json!(text))).collect();
                (format!("{scene}|{channel}|{t_us}"), Value::Object(fields))
            })
        })
    }
}

/// Parses a caption. Returns a description of the value if it is none.
fn caption(value: &Value) -> Result<ImageCaption, String> {
    let Value::Object(fields) = value else { return Err(value.to_string()) };
    if let Some(other) = fields.keys().find(|name| !FIELDS.contains(&name.as_str())) {
        return Err(format!("a field {other:?}"));
    }
    let mut caption = ImageCaption::default();
    for (name, text) in FIELDS.iter().zip(&mut caption) {
        match fields.get(*name) {
            None | Some(Value::Null) => {}
            Some(Value::String(found)) => text.clone_from(found),
            Some(other) => return Err(format!("{name} {other}")),
        }
    }
    Ok(caption)
}

/// Returns the text that occurs most often, the first of several; empty without any.
fn most_common<'a>(texts: impl Iterator<Item = &'a str> + Clone) -> &'a str {
    let count = |text: &str| texts.clone().filter(|other| *other == text).count();
    let mut most = ("", 0);
    for text in texts.clone().filter(|text| !text.is_empty()) {
        let count = count(text);
        if count > most.1 {
            most = (text, count);
        }
    }
    most.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_caption_with_the_time_and_weather_of_most_cameras() {
        let mut captions = ImageCaptions::default();
        let mut add = |key: &str, time: &str, weather: &str, text: &str| {
            let value =
                json!({"image_description": text, "time": time, "weather": weather, "objects": "cars"});
            captions.add(key, &value).unwrap().unwrap();
        };
        add("s|CAM_A|100", "day", "rain", "first");
        add("s|CAM_A|200", "day", "rain", "second");
        add("s|CAM_B|110", "night", "rain", "b");
        add("s|CAM_C|90", "night", "sun", "c");
        add("t|CAM_A|150", "dusk", "fog", "other scene");
        let names = ["CAM_A", "CAM_B", "CAM_C", "CAM_D"].map(|name| name.parse::<FileName>().unwrap());
        let [a, b, _, d] = &names;
        let at = |t_us| captions.of_cameras("s", &names.each_ref().map(|name| (name, t_us))).unwrap();
        let expected = ["night. rain. cars. first", "night. rain. cars. b", "night. rain. cars. c", ""];
        assert_eq!(at(149), expected);
        assert_eq!(at(151)[0], "night. rain. cars. second");
        assert_eq!((&at(-1000)[0], &at(1000)[0]), (&expected[0].to_owned(), &at(151)[0]));
        // Two cameras each: the first of several.
        assert_eq!(captions.of_cameras("s", &[(a, 100), (b, 110)]).unwrap()[1], "day. rain. cars. b");
        assert_eq!(captions.of_cameras("u", &[(a, 100)]), None);
        assert_eq!(captions.of_cameras("s", &[(d, 100)]), None);
    }

    #[test]
    fn keys_and_fields_of_others_are_refused() {
        let mut captions = ImageCaptions::default();
        assert_eq!(captions.add("scene-0061", &json!({})), None);
        assert_eq!(captions.add("a|b|c", &json!({})), None);
        for (value, found) in [
            (json!("text"), "\"text\""),
            (json!({"time": 5}), "time 5"),
            (json!({"season": "fall"}), "a field \"season\""),
        ] {
            assert_eq!(captions.add("s|CAM_A|5", &value), Some(Err(found.to_owned())));
        }
        assert_eq!(captions, ImageCaptions::default());
    }
}
