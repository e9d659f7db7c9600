//! Meaning of the `vertex` properties.

use std::path::Path;

use ply_rs_bw::ply::{ElementDef, PropertyType, ScalarType};

use crate::cloud::ColorValues;
use crate::error::FileError;

/// Factor of the constant harmonic of Gaussian splats.
const HARMONIC: f64 = 0.282_094_791_773_878_14;

/// Meaning of a property.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Column {
    /// Coordinate: x, y, z.
    Position(usize),
    /// Channel: red, green, blue.
    Color(usize),
    /// Channel as the constant spherical harmonic of Gaussian splats.
    Harmonic(usize),
    /// All channels in the bits of a number, `0xRRGGBB` (PCL).
    Packed,
    /// Class.
    Class,
}

/// Meaning of all properties.
#[derive(Clone, Debug)]
pub(super) struct Columns {
    /// One for each property, in the order of the file; `None` for those that are skipped.
    pub(super) of: Vec<Option<Column>>,
    /// Whether any coordinate is a double.
    pub(super) double: bool,
    /// Range of the colors.
    pub(super) colors: ColorValues,
    /// Sentence on colors that are missing or have other names than `red green blue`.
    pub(super) note: Option<String>,
}

impl Columns {
    /// Finds coordinates, colors and class by the names of the properties, ignoring case.
    ///
    /// # Errors
    /// Fails if a coordinate is missing or has another type than float or double.
    pub(super) fn of(vertex: &ElementDef, path: &Path) -> Result<Self, FileError> {
        let properties: Vec<(String, &PropertyType)> =
            vertex.properties.iter().map(|(name, p)| (name.to_ascii_lowercase(), &p.data_type)).collect();
        let find = |wanted: &str| properties.iter().position(|(name, _)| name == wanted);
        let mut columns =
            Self { of: vec![None; properties.len()], double: false, colors: ColorValues::Bytes, note: None };
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let at = find(name);
            match at.map(|at| (at, properties[at].1)) {
                Some((at, PropertyType::Scalar(scalar @ (ScalarType::Float | ScalarType::Double)))) => {
                    columns.of[at] = Some(Column::Position(axis));
                    columns.double |= *scalar == ScalarType::Double;
                }
                other => {
                    let found = other.map_or("none".to_owned(), |(_, data_type)| format!("{data_type:?}"));
                    return Err(FileError::content(
                        format!("a float or double property {name}"),
                        found,
                        path,
                    ));
                }
            }
        }
        if let Some(at) = find("class") {
            columns.of[at] = Some(Column::Class);
        }
        columns.find_colors(&properties);
        Ok(columns)
    }

    fn find_colors(&mut self, properties: &[(String, &PropertyType)]) {
        let scalar = |name: &str| {
            let is_scalar = |(other, data_type): &(String, &PropertyType)| {
                other == name && matches!(data_type, PropertyType::Scalar(_))
            };
            properties.iter().position(is_scalar)
        };
        let all = |names: [String; 3]| -> Option<[usize; 3]> {
            let [r, g, b] = names.map(|name| scalar(&name));
            Some([r?, g?, b?])
        };
        let listed = |found: &[usize]| -> String {
            found.iter().map(|at| properties[*at].0.as_str()).collect::<Vec<_>>().join(", ")
        };
        let plain = ["red", "green", "blue"].map(scalar);
        if plain.iter().any(Option::is_some) {
            let found: Vec<usize> = plain.into_iter().flatten().collect();
            self.colors = values(found.iter().map(|at| properties[*at].1));
            for (channel, at) in plain.into_iter().enumerate() {
                if let Some(at) = at {
                    self.of[at] = Some(Column::Color(channel));
                }
            }
            if found.len() < 3 {
                self.note = Some(format!("of colors {} alone: the other channels are 128", listed(&found)));
            }
            return;
        }
        let renamed = properties.iter().find_map(|(name, _)| {
            let others = other_channels(name)?;
            all([name.clone(), others[0].clone(), others[1].clone()])
        });
        if let Some(found) = renamed {
            self.colors = values(found.iter().map(|at| properties[*at].1));
            self.note = Some(format!("colors from {}", listed(&found)));
            (0..3).for_each(|channel| self.of[found[channel]] = Some(Column::Color(channel)));
        } else if let Some(at) = scalar("rgb").or(scalar("rgba")) {
            self.note = Some(format!("colors from the bits of {}", properties[at].0));
            self.of[at] = Some(Column::Packed);
        } else if let Some(found) = all(["f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned)) {
            self.note = Some("colors from the constant harmonics f_dc_0, f_dc_1, f_dc_2".to_owned());
            (0..3).for_each(|channel| self.of[found[channel]] = Some(Column::Harmonic(channel)));
        } else {
            let rest: Vec<usize> = (0..properties.len()).filter(|at| self.of[*at].is_none()).collect();
            let rest = if rest.is_empty() { String::new() } else { format!(" among {}", listed(&rest)) };
            self.note = Some(format!("no red, green, blue{rest}: gray 128"));
        }
    }
}

/// Returns the level, 0 to 255, of a constant harmonic.
pub(super) fn harmonic_level(value: f64) -> f64 {
    (0.5 + HARMONIC * value).clamp(0.0, 1.0) * 255.0
}

/// Returns the names of green and blue if a name is one of red: a word `red` or `r` among words joined by
/// `_`, as in `diffuse_red`, `scalar_Red`, `red_f`, `r`. Properties of other light than diffuse are not
/// meant.
fn other_channels(name: &str) -> Option<[String; 2]> {
    let words: Vec<&str> = name.split('_').collect();
    if words.iter().any(|word| matches!(*word, "specular" | "ambient" | "emission" | "emissive")) {
        return None;
    }
    let renamed = |from: &str, to: &str| -> String {
        words.iter().map(|word| if *word == from { to } else { word }).collect::<Vec<_>>().join("_")
    };
    [("red", ["green", "blue"]), ("r", ["g", "b"])]
        .into_iter()
        .find(|(red, _)| words.contains(red))
        .map(|(red, others)| others.map(|other| renamed(red, other)))
}

fn values<'p>(types: impl Iterator<Item = &'p PropertyType>) -> ColorValues {
    let rank = |data_type: &PropertyType| match data_type {
        PropertyType::Scalar(ScalarType::Char | ScalarType::UChar) => 0,
        PropertyType::Scalar(ScalarType::Float | ScalarType::Double) => 2,
        _ => 1,
    };
    match types.map(rank).max() {
        Some(2) => ColorValues::Floats,
        Some(1) => ColorValues::Integers,
        _ => ColorValues::Bytes,
    }
}
