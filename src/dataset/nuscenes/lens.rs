//! Lens distortion in the records of cameras: `camera_distortion` of the calibrated sensor, or another usual
//! name.
//!
//! Some data sets in this layout store images as the lens recorded them, others rectify them and leave the
//! coefficients of the lens. nuScenes itself has none. The tables do not say which, so an option does.

use std::path::Path;

use serde_json::{Map, Value};

use super::tables::{CalibratedSensor, Sensor};
use crate::dataset::ImageDistortion;
use crate::error::FileError;
use crate::files::text::printable;
use crate::geometry::Distortion;

/// Lens of a camera's images.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Lens {
    /// Distortion of the images.
    pub(super) distortion: Option<Distortion>,
    /// Field with coefficients that are ignored although nobody asked for it.
    pub(super) ignored: Option<String>,
}

/// Coefficients that are not all zero, and the name of their field.
#[derive(Clone, Debug, PartialEq)]
struct LensCoefficients<'a> {
    key: &'a str,
    value: Value,
}

/// Names of the field, as [`plain`] returns them.
const NAMES: [&str; 8] = [
    "distortion",
    "distortions",
    "distortioncoefficients",
    "distortioncoeffs",
    "distcoefficients",
    "distcoeffs",
    "dist",
    "d",
];

/// Names of the field with the model of the lens, as [`plain`] returns them: `camera_model` is `model`.
const MODEL: [&str; 2] = ["distortionmodel", "model"];

/// Names of fields with single coefficients, in OpenCV's order.
const SINGLE: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];

/// Names for the model of OpenCV's `projectPoints`, in lower case without separators. Coefficients of other
/// models differ.
const OPENCV_MODELS: [&str; 11] = [
    "",
    "brown",
    "brownconrady",
    "opencv",
    "perspective",
    "pinhole",
    "plumbbob",
    "radialtangential",
    "radtan",
    "rational",
    "rationalpolynomial",
];

/// Returns the lens of a calibrated camera; `record` and `path` are for messages.
///
/// # Errors
/// Fails if the coefficients apply and follow another model than OpenCV's: `k1 k2 p1 p2`, then `k3` or
/// further zeros, under a name in [`OPENCV_MODELS`]. Fails if two fields apply that contradict each other.
pub(super) fn lens(
    calibrated: &CalibratedSensor,
    sensor: &Sensor,
    option: ImageDistortion,
    record: &str,
    path: &Path,
) -> Result<Lens, FileError> {
    let mut all = [given(&calibrated.others), given(&sensor.others)].concat();
    let five =
        |given: &LensCoefficients<'_>| numbers(&given.value).as_deref().and_then(Distortion::first_five);
    all.dedup_by(|b, a| a.value == b.value || (five(a).is_some() && five(a) == five(b)));
    let Some(LensCoefficients { key, value }) = all.first().filter(|_| option != ImageDistortion::Ignore)
    else {
        return Ok(Lens::default());
    };
    if option == ImageDistortion::Usual {
        return Ok(Lens { distortion: None, ignored: Some((*key).to_owned()) });
    }
    if let Some(other) = all.get(1) {
        let found = format!("{key} {value} and {} {} in {record}", other.key, other.value);
        return Err(FileError::content("one list of distortion coefficients per camera", found, path));
    }
    let other = other_model([&calibrated.others, &sensor.others]);
    let coefficients = numbers(value).as_deref().and_then(Distortion::first_five);
    let five = coefficients.filter(|_| other.is_none()).ok_or_else(|| {
        let expected =
            format!("OpenCV's k1 k2 p1 p2 k3 as {key} (--image-distortion ignore reads images as rectified)");
        let model = other.map_or_else(String::new, |model| format!(" of model {model}"));
        FileError::content(expected, format!("{value}{model} in {record}"), path)
    })?;
    Ok(Lens { distortion: Distortion::from_opencv(five), ignored: None })
}

/// Returns what to say about the lens of a calibrated camera whose images are read: coefficients that are
/// ignored, and fields that may hold some under a name that is not known.
pub(super) fn unread(calibrated: &CalibratedSensor, sensor: &Sensor, option: ImageDistortion) -> Vec<String> {
    // Coefficients that cannot be used are reported with their camera.
    let lens = lens(calibrated, sensor, option, "", Path::new("")).unwrap_or_default();
    let ignored = lens.ignored.map(|key| {
        let key = printable(&key);
        format!(
            "cameras with {key}, whose images are read as rectified (--image-distortion apply if they are \
                not)"
        )
    });
    let is_unknown = |(key, value): &(&String, &Value)| {
        let name = plain(key);
        let is_lens = name.contains("dist") && !name.contains("distance") && !MODEL.contains(&name.as_str());
        is_lens && !is_named(key) && !is_nothing(value)
    };
    let fields = calibrated.others.iter().chain(&sensor.others).filter(is_unknown);
    let fields = fields
        .map(|(key, _)| format!("cameras with {}, which is not read (lens distortion?)", printable(key)));
    ignored.into_iter().chain(fields).collect()
}

/// Returns the coefficients of a record under any of their names, unless they are zero.
fn given(record: &Map<String, Value>) -> Vec<LensCoefficients<'_>> {
    let named = record.iter().filter(|(key, _)| is_named(key));
    let named = named.map(|(key, value)| {
        let inner = value.as_object().and_then(single);
        LensCoefficients { key, value: inner.map_or_else(|| value.clone(), |inner| inner.value) }
    });
    named.chain(single(record)).filter(|given| !is_nothing(&given.value)).collect()
}

/// Returns whether a field is named as coefficients are.
fn is_named(key: &str) -> bool {
    NAMES.contains(&plain(key).as_str())
}

/// Returns the first model that is not one of [`OPENCV_MODELS`], from the fields of records or beside the
/// coefficients.
fn other_model(records: [&Map<String, Value>; 2]) -> Option<&Value> {
    let objects = records.into_iter().flatten().filter(|(key, _)| is_named(key));
    let inner = objects.filter_map(|(_, value)| value.as_object()).flatten();
    let models = records.into_iter().flatten().chain(inner);
    let mut models = models.filter(|(key, _)| MODEL.contains(&plain(key).as_str())).map(|(_, model)| model);
    models.find(|model| !is_opencv(model))
}

fn is_opencv(model: &Value) -> bool {
    let plain = |name: &str| name.to_lowercase().replace([' ', '-', '_'], "");
    model.is_null() || model.as_str().is_some_and(|name| OPENCV_MODELS.contains(&plain(name).as_str()))
}

/// Collects single coefficients in OpenCV's order; `None` if there are none.
fn single(record: &Map<String, Value>) -> Option<LensCoefficients<'_>> {
    let field = |name: &str| record.iter().find(|(key, _)| plain(key) == name);
    let key = SINGLE.iter().find_map(|name| field(name))?.0;
    let value = SINGLE.map(|name| field(name).map_or(Value::from(0), |(_, value)| value.clone()));
    Some(LensCoefficients { key, value: Value::from(value.to_vec()) })
}

/// Returns the name of a field without `camera`, in lower case and without other signs than letters and
/// digits.
fn plain(key: &str) -> String {
    let name: String = key.chars().filter(char::is_ascii_alphanumeric).collect();
    let name = name.to_ascii_lowercase();
    name.strip_prefix("camera").map_or(name.clone(), str::to_owned)
}

/// Returns whether a value is empty, or all of its numbers are zero.
fn is_nothing(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::String(text) => text.trim().is_empty(),
        Value::Object(fields) => fields.values().all(is_nothing),
        Value::Number(number) => number.as_f64() == Some(0.0),
        _ => numbers(value).is_some_and(|all| all.iter().all(|v| *v == 0.0)),
    }
}

/// Returns a list of numbers, where null is NaN; `None` for other values.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    let number = |v: &Value| if v.is_null() { Some(f64::NAN) } else { v.as_f64() };
    value.as_array()?.iter().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(value: Value, model: Value, option: ImageDistortion) -> Result<Lens, String> {
        let record = json!({"token": "c", "sensor_token": "s", "translation": [0, 0, 0], "rotation": [1, 0,
            0, 0],
            "camera_intrinsic": [], "camera_distortion": value, "camera_distortion_model": model});
        let calibrated = serde_json::from_value(record).unwrap();
        read_with(&calibrated, &json!({}), option)
    }

    fn read_with(
        calibrated: &CalibratedSensor,
        sensor: &Value,
        option: ImageDistortion,
    ) -> Result<Lens, String> {
        let mut record = json!({"token": "s", "channel": "CAM_FRONT", "modality": "camera"});
        record.as_object_mut().unwrap().extend(sensor.as_object().unwrap().clone());
        let sensor = serde_json::from_value(record).unwrap();
        let read = lens(calibrated, &sensor, option, "calibrated_sensor c", Path::new("a.json"));
        read.map_err(|e| e.to_string())
    }

    /// Returns a calibrated sensor with further fields.
    fn calibrated(fields: &Value) -> CalibratedSensor {
        let mut record =
            json!({"token": "c", "sensor_token": "s", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0]});
        record.as_object_mut().unwrap().extend(fields.as_object().unwrap().clone());
        serde_json::from_value(record).unwrap()
    }

    #[test]
    fn coefficients_have_many_names() {
        let five = json!([-0.35, 0.14, 0.0, 0.0, -0.03]);
        let applied = |fields: Value, sensor: Value| {
            let lens = read_with(&calibrated(&fields), &sensor, ImageDistortion::Apply)?;
            Ok::<_, String>(lens.distortion.unwrap().coefficients())
        };
        let expected = Ok([-0.35, 0.14, 0.0, 0.0, -0.03]);
        for key in [
            "distortion",
            "D",
            "camera_distortion_coefficients",
            "distortion_coefficients",
            "dist_coeffs",
            "camera_dist",
            "distCoeffs",
            "camera_distortions",
        ] {
            assert_eq!(applied(json!({ key: five }), json!({})), expected, "{key}");
            assert_eq!(applied(json!({}), json!({ key: five })), expected, "{key}");
            let usual = read_with(&calibrated(&json!({ key: five })), &json!({}), ImageDistortion::Usual);
            assert_eq!(usual.unwrap().ignored.as_deref(), Some(key));
        }
        let single = json!({"k1": -0.35, "k2": 0.14, "k3": -0.03});
        assert_eq!(applied(single.clone(), json!({})), expected);
        assert_eq!(applied(json!({"camera_distortion": single}), json!({})), expected);
        // The same twice, zeros beside it, and contradictions.
        assert_eq!(applied(json!({"D": five, "distortion": five}), json!({"D": five})), expected);
        assert_eq!(applied(json!({"camera_distortion": [0, 0, 0, 0, 0], "D": five}), json!({})), expected);
        let longer = json!([-0.35, 0.14, 0, 0, -0.03, 0]);
        assert_eq!(applied(json!({"D": five}), json!({"distortion": longer})), expected);
        let message = applied(json!({"D": [0.1, 0, 0, 0]}), json!({"distortion": five})).unwrap_err();
        assert!(message.contains("one list of distortion coefficients per camera"), "{message}");
        let fisheye = applied(json!({"k1": 0.1, "k2": 0.02, "k3": 0.01, "k4": 0.001}), json!({}));
        assert!(fisheye.unwrap_err().contains("k1 k2 p1 p2 k3 as k1"));
    }

    #[test]
    fn unknown_fields_are_noted() {
        let reported = |fields: Value| {
            let sensor = serde_json::from_value(json!({"token": "s", "channel": "C", "modality": "camera"}));
            unread(&calibrated(&fields), &sensor.unwrap(), ImageDistortion::Usual)
        };
        let one = reported(json!({"undistortion_map": "a.bin"}));
        assert_eq!(one, ["cameras with undistortion_map, which is not read (lens distortion?)"]);
        for fields in [
            json!({}),
            json!({"distance_m": 4, "camera_distortion_model": "plumb_bob"}),
            json!({"distorted": false, "dist_x": [], "k1": 0, "D": null}),
        ] {
            assert_eq!(reported(fields.clone()), [""; 0], "{fields}");
        }
    }

    #[test]
    fn coefficients_are_applied_or_noted_as_ignored() {
        let given = json!([-0.35, 0.14, 0.001, -0.002, -0.03]);
        let read = |option| read(given.clone(), Value::Null, option).unwrap();
        assert_eq!(
            read(ImageDistortion::Usual),
            Lens { distortion: None, ignored: Some("camera_distortion".to_owned()) }
        );
        assert_eq!(read(ImageDistortion::Ignore), Lens::default());
        let applied = read(ImageDistortion::Apply).distortion.unwrap();
        assert_eq!(applied.coefficients(), [-0.35, 0.14, 0.001, -0.002, -0.03]);
    }

    #[test]
    fn zeros_and_empty_values_are_not_a_lens() {
        for value in [
            json!([]),
            json!(null),
            json!([0, 0, 0, 0, 0]),
            json!([0.0, -0.0]),
            json!([0, 0, 0, 0, 0, 0, 0, 0]),
        ] {
            for option in [ImageDistortion::Usual, ImageDistortion::Apply, ImageDistortion::Ignore] {
                assert_eq!(read(value.clone(), Value::Null, option), Ok(Lens::default()), "{value}");
            }
        }
    }

    #[test]
    fn other_lengths_are_extended_or_rejected() {
        let read = |value| read(value, json!("plumb_bob"), ImageDistortion::Apply);
        let k3 = |value| read(value).unwrap().distortion.unwrap().coefficients()[4];
        assert_eq!(k3(json!([-0.3, 0.1, 0.0, 0.0])), 0.0);
        assert_eq!(k3(json!([-0.3, 0.1, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0])), 0.02);
        for value in [
            json!([-0.3]),
            json!([-0.3, 0.1, 0.0]),
            json!([-0.3, 0.1, 0.0, 0.0, 0.0, 0.4]),
            json!([-0.3, null, 0.0, 0.0, 0.0]),
            json!("none"),
            json!([[-0.3, 0.1, 0.0, 0.0, 0.0]]),
        ] {
            let message = read(value.clone()).unwrap_err();
            assert!(message.contains(&format!("found {value} in calibrated_sensor c: a.json")), "{message}");
        }
    }

    #[test]
    fn rejects_models_of_other_lenses() {
        let given = json!([-0.01, 0.02, 0.003, -0.001]);
        for model in
            ["fisheye", "equidistant", "KannalaBrandt", "double_sphere", "ds", "Scaramuzza", "div", "?", "鱼"]
        {
            let message = read(given.clone(), json!(model), ImageDistortion::Apply).unwrap_err();
            assert!(message.contains(&format!("of model {model:?}")), "{message}");
            assert!(read(given.clone(), json!(model), ImageDistortion::Usual).unwrap().ignored.is_some());
            let of_sensor = json!({"distortion": given, "distortion_model": model});
            let message = read_with(&calibrated(&json!({})), &of_sensor, ImageDistortion::Apply).unwrap_err();
            assert!(message.contains(&format!("of model {model:?}")), "{message}");
        }
    }

    /// The model may be a field of its own, or beside the coefficients.
    #[test]
    fn models_are_accepted_by_name() {
        let applied = |fields: Value, sensor: Value| {
            read_with(&calibrated(&fields), &sensor, ImageDistortion::Apply)
                .map(|lens| lens.distortion.is_some())
        };
        let both = |key: &str, model: Value| {
            let inner = json!({"k1": -0.01, "k2": 0.02, key: model});
            let outer = json!({"D": [-0.01, 0.02, 0.003, -0.001], key: model});
            [
                applied(outer.clone(), json!({})),
                applied(json!({}), outer),
                applied(json!({"camera_distortion": inner}), json!({})),
                applied(json!({}), json!({"distortion": inner})),
            ]
        };
        for key in ["distortion_model", "camera_model", "model", "cameraModel", "camera_distortion_model"] {
            for model in [
                json!(null),
                json!(""),
                json!("plumb_bob"),
                json!("Plumb Bob"),
                json!("radtan"),
                json!("radial-tangential"),
                json!("BROWN"),
                json!("Brown-Conrady"),
                json!("OPENCV"),
                json!("pinhole"),
                json!("rational_polynomial"),
            ] {
                assert!(both(key, model.clone()).into_iter().all(|found| found == Ok(true)), "{key} {model}");
            }
            for model in
                [json!("ds"), json!("inverse_brown_conrady"), json!("opencv_fisheye"), json!(4), json!({})]
            {
                for found in both(key, model.clone()) {
                    let message = found.unwrap_err();
                    assert!(message.contains(&format!("of model {model}")), "{key}: {message}");
                }
            }
        }
        // Of two fields, each excludes.
        let fields =
            json!({"D": [-0.01, 0.02, 0.003, -0.001], "camera_model": "omni", "distortion_model": "radtan"});
        assert!(applied(fields, json!({})).unwrap_err().contains("of model \"omni\""));
    }
}
