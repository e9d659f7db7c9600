//! `camera_distortion` of calibrated sensors.
//!
//! Some data sets in this layout store images as the lens recorded them, others rectify them and leave the
//! coefficients of the lens. nuScenes itself has none. The tables do not say which, so an option does.

use std::path::Path;

use serde_json::Value;

use super::tables::CalibratedSensor;
use crate::dataset::ImageDistortion;
use crate::error::FileError;
use crate::geometry::Distortion;

/// Lens of a camera's images.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Lens {
    /// Distortion of the images.
    pub(super) distortion: Option<Distortion>,
    /// Whether there are coefficients that are ignored although nobody asked for it.
    pub(super) is_ignored: bool,
}

/// Words in names of models other than that of OpenCV's `projectPoints`.
const OTHER_MODELS: [&str; 6] = ["fish", "equi", "kannala", "omni", "mei", "ftheta"];

/// Returns the lens of a calibrated camera; `record` and `path` are for messages.
///
/// # Errors
/// Fails if the coefficients apply and are not those of OpenCV: `k1 k2 p1 p2`, and `k3` or further zeros.
pub(super) fn lens(
    calibrated: &CalibratedSensor,
    option: ImageDistortion,
    record: &str,
    path: &Path,
) -> Result<Lens, FileError> {
    let given = calibrated.camera_distortion.as_ref().unwrap_or(&Value::Null);
    let coefficients = numbers(given);
    let has_none = coefficients.as_ref().is_some_and(|all| all.iter().all(|v| *v == 0.0));
    if has_none || option == ImageDistortion::Ignore {
        return Ok(Lens::default());
    }
    if option == ImageDistortion::Usual {
        return Ok(Lens { distortion: None, is_ignored: true });
    }
    let model = calibrated.camera_distortion_model.as_ref().and_then(Value::as_str).unwrap_or_default();
    let is_other = OTHER_MODELS.iter().any(|word| model.to_lowercase().contains(word));
    let five = coefficients.as_deref().and_then(five).filter(|_| !is_other).ok_or_else(|| {
        let expected = "OpenCV's k1 k2 p1 p2 k3 as camera_distortion (--image-distortion ignore reads images as rectified)";
        let model = if is_other { format!(" of model {model:?}") } else { String::new() };
        FileError::content(expected, format!("{given}{model} in {record}"), path)
    })?;
    Ok(Lens { distortion: Distortion::from_opencv(five), is_ignored: false })
}

/// Returns a list of numbers, where null is NaN; `None` for other values.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    match value {
        Value::Null => Some(Vec::new()),
        Value::Array(all) => {
            let number = |v: &Value| if v.is_null() { Some(f64::NAN) } else { v.as_f64() };
            all.iter().map(number).collect()
        }
        _ => None,
    }
}

/// Returns the first five of four or more coefficients if they are finite and the rest is zero.
fn five(all: &[f64]) -> Option<[f64; 5]> {
    let mut five = [0.0; 5];
    let used = all.len().min(5);
    five[..used].copy_from_slice(&all[..used]);
    let fits = used >= 4 && five.iter().all(|v| v.is_finite()) && all[used..].iter().all(|v| *v == 0.0);
    fits.then_some(five)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(value: Value, model: Value, option: ImageDistortion) -> Result<Lens, String> {
        let record = json!({"token": "c", "sensor_token": "s", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0],
            "camera_intrinsic": [], "camera_distortion": value, "camera_distortion_model": model});
        let calibrated = serde_json::from_value(record).unwrap();
        lens(&calibrated, option, "calibrated_sensor c", Path::new("a.json")).map_err(|e| e.to_string())
    }

    #[test]
    fn coefficients_are_applied_or_said_to_be_ignored() {
        let given = json!([-0.35, 0.14, 0.001, -0.002, -0.03]);
        let read = |option| read(given.clone(), Value::Null, option).unwrap();
        assert_eq!(read(ImageDistortion::Usual), Lens { distortion: None, is_ignored: true });
        assert_eq!(read(ImageDistortion::Ignore), Lens::default());
        let applied = read(ImageDistortion::Apply).distortion.unwrap();
        assert_eq!(applied.coefficients(), [-0.35, 0.14, 0.001, -0.002, -0.03]);
    }

    #[test]
    fn zeros_and_nothing_are_no_lens() {
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
    fn other_lengths_are_extended_or_refused() {
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
        for model in ["fisheye", "equidistant", "KannalaBrandt"] {
            let message = read(given.clone(), json!(model), ImageDistortion::Apply).unwrap_err();
            assert!(message.contains(&format!("of model {model:?}")), "{message}");
            assert!(read(given.clone(), json!(model), ImageDistortion::Usual).unwrap().is_ignored);
        }
    }
}
