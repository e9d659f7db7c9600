//! Range of a file's colors: levels of 0 to 255, unit floats of 0 to 1, or 16-bit integers.

/// What a file says about its color values before they are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorValues {
    /// Integers of 8 bits: levels.
    Bytes,
    /// Integers of 16 bits or more: levels, or 0 to 65535 if any exceeds 255 (converters of LAS).
    Integers,
    /// Floats of a format without a defined range (PLY): levels, or 0 to 1 if none exceeds 1.
    Floats,
    /// Floats of a format that defines levels (arrays): 0 to 1 only if none exceeds 1 and some are fractions.
    Levels,
}

/// Largest unit float: writers round.
const UNIT_MAX: f64 = 1.001;
/// Brightness below which fractional levels are suspicious.
const DARK: f64 = 8.0;

/// Maximum of a file's colors, and whether any is a fraction.
#[derive(Clone, Copy, Debug)]
pub struct ColorRange {
    values: ColorValues,
    max: f64,
    fractions: bool,
}

impl ColorRange {
    /// Creates a range without colors.
    pub fn new(values: ColorValues) -> Self {
        Self { values, max: 0.0, fractions: false }
    }

    /// Adds the color of a point that has a position. Values that are negative or not finite do not count.
    pub fn add(&mut self, rgb: [f64; 3]) {
        for value in rgb.into_iter().filter(|value| value.is_finite() && *value >= 0.0) {
            self.max = self.max.max(value);
            self.fractions |= value.fract() != 0.0;
        }
    }

    /// Returns whether further colors cannot change the scale.
    pub fn is_settled(&self) -> bool {
        match self.values {
            ColorValues::Bytes => true,
            ColorValues::Integers => self.max > 255.0,
            ColorValues::Floats | ColorValues::Levels => self.max >= DARK,
        }
    }

    /// Returns the factor from a value to its level, and the maximum value.
    pub fn scale(&self) -> ColorScale {
        if self.is_unit() {
            return ColorScale { factor: 255.0, max: UNIT_MAX };
        }
        if self.values == ColorValues::Integers && self.max > 255.0 {
            return ColorScale { factor: 1.0 / 257.0, max: 65_535.0 };
        }
        ColorScale { factor: 1.0, max: 255.0 }
    }

    /// Returns a sentence on colors that are not plainly levels; `None` if they are.
    pub fn note(&self) -> Option<String> {
        let scale = self.scale();
        if scale.factor > 1.0 {
            return Some("colors of 0 to 1, scaled to 0 to 255".to_owned());
        }
        if scale.factor < 1.0 {
            return Some("colors of 0 to 65535, scaled to 0 to 255".to_owned());
        }
        let dark = self.max > 0.0 && (self.max <= 1.0 || (self.fractions && self.max < DARK));
        let floats = matches!(self.values, ColorValues::Floats | ColorValues::Levels);
        (dark && floats).then(|| format!("no color exceeds {} of 255: nearly black", self.max))
    }

    fn is_unit(&self) -> bool {
        let unit = self.max > 0.0 && self.max <= UNIT_MAX;
        match self.values {
            ColorValues::Bytes | ColorValues::Integers => false,
            ColorValues::Floats => unit,
            ColorValues::Levels => unit && self.fractions,
        }
    }
}

/// Conversion of color values to levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColorScale {
    factor: f64,
    max: f64,
}

impl ColorScale {
    /// Maximum value.
    pub fn max(&self) -> f64 {
        self.max.floor()
    }

    /// Returns the nearest level of a value; `None` if the value is out of range by more than half a level,
    /// or NaN.
    pub fn near_level(&self, value: f64) -> Option<u8> {
        let level = value * self.factor;
        self.level(value).or_else(|| (-0.5..255.5).contains(&level).then_some(level.round() as u8))
    }

    /// Returns the nearest level of a value; `None` outside the range.
    pub fn level(&self, value: f64) -> Option<u8> {
        // Conversion saturates.
        (0.0..=self.max).contains(&value).then(|| (value * self.factor).round() as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ColorValues::{Bytes, Floats, Integers, Levels};

    fn levels(values: ColorValues, colors: &[[f64; 3]]) -> (Vec<[Option<u8>; 3]>, Option<String>) {
        let mut range = ColorRange::new(values);
        colors.iter().for_each(|rgb| range.add(*rgb));
        let scale = range.scale();
        (colors.iter().map(|rgb| rgb.map(|value| scale.level(value))).collect(), range.note())
    }

    fn some(rgb: [u8; 3]) -> [Option<u8>; 3] {
        rgb.map(Some)
    }

    #[test]
    fn unit_floats_are_scaled() {
        let (found, note) = levels(Floats, &[[1.0, 0.5, 0.0], [0.0, 0.25, 1.000_000_1]]);
        assert_eq!(found, [some([255, 128, 0]), some([0, 64, 255])]);
        assert_eq!(note.as_deref(), Some("colors of 0 to 1, scaled to 0 to 255"));
        // A float file of full colors has no fractions.
        assert_eq!(levels(Floats, &[[1.0, 0.0, 0.0]]).0, [some([255, 0, 0])]);
        // Arrays define levels: only fractions can be unit floats.
        assert_eq!(levels(Levels, &[[1.0, 0.5, 0.0]]).0, [some([255, 128, 0])]);
        let (found, note) = levels(Levels, &[[1.0, 0.0, 0.0]]);
        assert_eq!(found, [some([1, 0, 0])]);
        assert_eq!(note.as_deref(), Some("no color exceeds 1 of 255: nearly black"));
    }

    #[test]
    fn levels_are_unchanged() {
        for values in [Bytes, Integers, Floats, Levels] {
            let colors = [[0.0, 1.0, 0.0], [9.0, 255.0, 128.0]];
            assert_eq!(levels(values, &colors), (colors.map(|c| some(c.map(|v| v as u8))).to_vec(), None));
            assert_eq!(levels(values, &[[0.0; 3]]), (vec![some([0; 3])], None));
        }
        // A dark file.
        assert_eq!(levels(Bytes, &[[0.0, 1.0, 1.0]]), (vec![some([0, 1, 1])], None));
        assert_eq!(levels(Integers, &[[0.0, 1.0, 1.0]]), (vec![some([0, 1, 1])], None));
        let (found, note) = levels(Floats, &[[0.0, 1.7, 0.2]]);
        assert_eq!(found, [some([0, 2, 0])]);
        assert!(note.unwrap().starts_with("no color exceeds 1.7 of 255"));
    }

    #[test]
    fn sixteen_bit_colors_are_scaled() {
        let (found, note) = levels(Integers, &[[65_535.0, 0.0, 257.0], [32_768.0, 128.0, 129.0]]);
        assert_eq!(found, [some([255, 0, 1]), some([128, 0, 1])]);
        assert_eq!(note.as_deref(), Some("colors of 0 to 65535, scaled to 0 to 255"));
        assert_eq!(levels(Integers, &[[65_536.0, 0.0, 0.0]]).0[0][0], None);
    }

    #[test]
    fn values_out_of_range_have_no_level() {
        for value in [-0.1, 255.1, f64::NAN, f64::INFINITY] {
            assert_eq!(levels(Floats, &[[value, 20.0, 0.0]]).0[0][0], None, "{value}");
        }
        assert_eq!(levels(Floats, &[[-0.1, 0.5, 0.0]]).0[0][0], None);
    }
}
