use std::fmt;
use std::str::FromStr;

use point_skeleton::geometry::ImageSize;
use point_skeleton::hash;
use point_skeleton::named;

/// Options of a town and of its recording. Text form:
/// `seed=7,frames=40[,hz=5,beams=32,lidar_hz=10,size=450x800,light=day]` in any order; omitted keys take
/// their defaults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TownOptions {
    /// Seed that everything is derived from.
    pub seed: u64,
    /// Number of annotated frames.
    pub frames: usize,
    /// Annotated frames per second.
    pub hz: f64,
    /// LiDAR rotations per second: 10 or 20.
    pub lidar_hz: f64,
    /// Number of LiDAR beams: 32 or 64.
    pub beams: u16,
    /// Height and width of the images, pixels.
    pub size: [u32; 2],
    /// Daylight; `None` derives it from the seed.
    pub daylight: Option<Daylight>,
}

/// Time of day and sky.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Daylight {
    /// Sun in a blue sky.
    Day,
    /// Low sun, lamps lit.
    Dusk,
    /// Grey sky, soft shadows.
    Overcast,
}

named!(Daylight, "light" {
    Day => "day", "Sun in a blue sky";
    Dusk => "dusk", "Low sun, lamps lit";
    Overcast => "overcast", "Grey sky, soft shadows";
});

/// Error: invalid town options.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found:?}")]
pub struct TownOptionsError {
    /// Description of the accepted values.
    pub expected: String,
    /// The rejected value.
    pub found: String,
}

impl Default for TownOptions {
    fn default() -> Self {
        let (seed, frames) = (7, 40);
        Self { seed, frames, hz: 5.0, lidar_hz: 10.0, beams: 32, size: [450, 800], daylight: None }
    }
}

impl TownOptions {
    /// Maximum frame count of a recording.
    pub const MAX_FRAMES: usize = 10_000;
    /// Maximum duration of a recording, seconds: poses take memory ten times a second.
    pub const MAX_DURATION_S: f64 = 600.0;
    /// Maximum pixel count of an image.
    pub const MAX_PIXELS: usize = 1 << 25;
    const KEYS: [&str; 7] = ["seed", "frames", "hz", "beams", "lidar_hz", "size", "light"];

    /// Returns the time from the first frame to the last, seconds.
    pub fn duration_s(&self) -> f64 {
        self.frames.saturating_sub(1) as f64 / self.hz
    }

    /// Returns the requested daylight, or the one that the seed selects.
    pub fn light(&self) -> Daylight {
        let chosen =
            || Daylight::ALL[(hash::hash(self.seed, &[0x6c69]) % Daylight::ALL.len() as u64) as usize];
        self.daylight.unwrap_or_else(chosen)
    }

    /// Validates the ranges of all values.
    ///
    /// # Errors
    /// Returns an error for the first value that is out of range.
    pub fn check(&self) -> Result<(), TownOptionsError> {
        let wrong = |expected: &str, found: &dyn fmt::Display| {
            Err(TownOptionsError { expected: expected.to_owned(), found: found.to_string() })
        };
        if !(1..=Self::MAX_FRAMES).contains(&self.frames) {
            return wrong("1 to 10000 frames", &self.frames);
        }
        if ![10.0, 20.0].contains(&self.lidar_hz) {
            return wrong("lidar_hz of 10 or 20", &self.lidar_hz);
        }
        if !(0.5..=self.lidar_hz).contains(&self.hz) {
            return wrong("hz of 0.5 to lidar_hz", &self.hz);
        }
        if ![32, 64].contains(&self.beams) {
            return wrong("beams of 32 or 64", &self.beams);
        }
        let size = ImageSize { height: self.size[0], width: self.size[1] };
        if size.to_string().parse::<ImageSize>() != Ok(size) {
            return wrong("a size HxW of 1 to 16384 pixels a side", &size);
        }
        if size.pixels() > Self::MAX_PIXELS {
            return wrong(&format!("a size of at most {} pixels", Self::MAX_PIXELS), &size);
        }
        if self.duration_s() > Self::MAX_DURATION_S {
            let found = format!("{} frames at {} Hz", self.frames, self.hz);
            return wrong(&format!("a drive of at most {} s", Self::MAX_DURATION_S), &found);
        }
        Ok(())
    }

    fn set(&mut self, key: &str, value: &str) -> Result<(), TownOptionsError> {
        let wrong = |expected: &str| TownOptionsError {
            expected: format!("{expected} for {key} of the town"),
            found: value.to_owned(),
        };
        let rate = || value.parse().ok().filter(|hz: &f64| hz.is_finite()).ok_or_else(|| wrong("a number"));
        match key {
            "seed" => self.seed = value.parse().map_err(|_| wrong("a whole number below 2^64"))?,
            "frames" => self.frames = value.parse().map_err(|_| wrong("a whole number, 1 to 10000,"))?,
            "hz" => self.hz = rate()?,
            "lidar_hz" => self.lidar_hz = rate()?,
            "beams" => self.beams = value.parse().map_err(|_| wrong("32 or 64"))?,
            "size" => {
                let size: ImageSize = value.parse().map_err(|_| wrong("HxW of 1 to 16384 pixels a side"))?;
                self.size = [size.height, size.width];
            }
            "light" => {
                let light = value.parse::<Daylight>();
                self.daylight = Some(light.map_err(|error| wrong(&error.expected()))?);
            }
            _ => return Err(Self::unknown(key)),
        }
        Ok(())
    }

    fn unknown(found: &str) -> TownOptionsError {
        let expected = format!("the options of the town, KEY=VALUE with {}", Self::KEYS.join(", "));
        TownOptionsError { expected, found: found.to_owned() }
    }
}

impl FromStr for TownOptions {
    type Err = TownOptionsError;

    fn from_str(text: &str) -> Result<Self, TownOptionsError> {
        let mut options = Self::default();
        let mut seen = Vec::new();
        for part in text.split(',').map(str::trim).filter(|_| !text.is_empty()) {
            let (key, value) = part.split_once('=').ok_or_else(|| Self::unknown(part))?;
            if seen.contains(&key) {
                let expected = format!("{key} of the town once");
                return Err(TownOptionsError { expected, found: text.to_owned() });
            }
            seen.push(key);
            options.set(key, value)?;
        }
        options.check()?;
        Ok(options)
    }
}

/// Writes the complete text form.
impl fmt::Display for TownOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, frames, hz, lidar_hz, beams, size: [height, width], daylight } = self;
        write!(
            f,
            "seed={seed},frames={frames},hz={hz},beams={beams},lidar_hz={lidar_hz},size={height}x{width}"
        )?;
        daylight.map_or(Ok(()), |light| write!(f, ",light={light}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_round_trip() {
        let text = "seed=18446744073709551615,frames=3,hz=2.5,beams=64,lidar_hz=20,size=90x160,light=dusk";
        let options: TownOptions = text.parse().unwrap();
        assert_eq!((options.seed, options.frames, options.size), (u64::MAX, 3, [90, 160]));
        assert_eq!(options.daylight, Some(Daylight::Dusk));
        assert_eq!(options.to_string(), text);
        assert_eq!("".parse(), Ok(TownOptions::default()));
        assert_eq!("frames=40, seed=7".parse(), Ok(TownOptions::default()));
    }

    #[test]
    fn rejects_invalid_options() {
        for (text, expected, found) in [
            ("seed", "KEY=VALUE with seed, frames", "seed"),
            ("colour=red", "KEY=VALUE", "colour"),
            ("seed=-1", "whole number below 2^64 for seed", "-1"),
            ("seed=18446744073709551616", "below 2^64 for seed", "18446744073709551616"),
            ("seed=1,seed=2", "seed of the town once", "seed=1,seed=2"),
            ("seed=1@v1", "whole number below 2^64", "1@v1"),
            ("frames=0", "1 to 10000 frames", "0"),
            ("frames=-3", "1 to 10000, for frames", "-3"),
            ("frames=10001", "1 to 10000 frames", "10001"),
            ("frames=99999999999999999999", "1 to 10000, for frames", "99999999999999999999"),
            ("frames=1e3", "whole number", "1e3"),
            ("frames=9000", "at most 600 s", "9000 frames at 5 Hz"),
            ("hz=0", "hz of 0.5", "0"),
            ("hz=11", "to lidar_hz", "11"),
            ("hz=NaN", "a number for hz", "NaN"),
            ("hz=inf", "a number for hz", "inf"),
            ("lidar_hz=15", "10 or 20", "15"),
            ("beams=16", "32 or 64", "16"),
            ("beams=65568", "32 or 64", "65568"),
            ("size=0x4", "HxW", "0x4"),
            ("size=16384x16384", "at most 33554432 pixels", "16384x16384"),
            ("size=16385x1", "1 to 16384", "16385x1"),
            ("light=night", "day, dusk or overcast", "night"),
            ("seed=1,", "KEY=VALUE", ""),
        ] {
            let message = text.parse::<TownOptions>().unwrap_err().to_string();
            assert!(message.starts_with("expected ") && message.contains(expected), "{text}: {message}");
            assert!(message.ends_with(&format!("found {found:?}")), "{text}: {message}");
        }
        let narrow = TownOptions { size: [4, 0], ..TownOptions::default() };
        assert!(narrow.check().is_err());
    }
}
