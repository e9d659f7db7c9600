use std::fmt;
use std::hash::Hasher as _;
use std::path::Path;
use std::str::FromStr;

use bytemuck::{NoUninit, Pod, Zeroable};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use twox_hash::XxHash3_64;

use crate::error::FileError;

/// 64-bit XXH3 of values in their file representation. It detects damage, not forgery.
#[repr(transparent)]
#[derive(Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct Checksum(u64);

impl Checksum {
    /// Hashes the bytes of consecutive values.
    pub fn of<T: NoUninit>(values: &[T]) -> Self {
        Self(XxHash3_64::oneshot(bytemuck::cast_slice(values)))
    }

    /// Validates values read from a file against this checksum; `name` describes them in the message.
    ///
    /// # Errors
    /// Fails if the values have another checksum.
    pub(crate) fn check<T: NoUninit>(
        self,
        values: &[T],
        name: impl FnOnce() -> String,
        path: &Path,
    ) -> Result<(), FileError> {
        let found = Self::of(values);
        if found == self {
            return Ok(());
        }
        Err(FileError::content(format!("{} with checksum {self}", name()), found.to_string(), path))
    }
}

/// A checksum of values that are passed part by part.
#[derive(Clone, Default)]
pub(crate) struct Hasher(XxHash3_64);

impl Hasher {
    pub(crate) fn add<T: NoUninit>(&mut self, values: &[T]) {
        self.0.write(bytemuck::cast_slice(values));
    }

    pub(crate) fn checksum(&self) -> Checksum {
        Checksum(self.0.finish())
    }
}

impl fmt::Debug for Hasher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Hasher").field(&self.checksum()).finish()
    }
}

/// Formats as 16 hexadecimal digits.
impl fmt::Display for Checksum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl fmt::Debug for Checksum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for Checksum {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.len() == 16 && text.bytes().all(|b| b.is_ascii_hexdigit());
        let value = digits.then(|| u64::from_str_radix(text, 16).ok()).flatten();
        value.map(Self).ok_or_else(|| format!("expected a checksum of 16 hexadecimal digits, found {text:?}"))
    }
}

/// Serializes as text, because not every JSON reader preserves all bits of a number.
impl Serialize for Checksum {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Checksum {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Point;

    /// Reference values from xxHash 0.8.
    #[test]
    fn the_checksum_is_xxh3() {
        assert_eq!(Checksum::of::<u8>(&[]).to_string(), "2d06800538d394c2");
        assert_eq!(Checksum::of(b"a").to_string(), "e6c632b61e964e1f");
    }

    #[test]
    fn checksum_depends_on_every_bit() {
        let points: Vec<Point> = (0..50).map(|i| Point::new([i as f32, 0.5, -1.0], [i; 3], i)).collect();
        let whole = Checksum::of(&points);
        for bit in 0..8 * size_of_val(points.as_slice()) {
            let mut damaged = points.clone();
            bytemuck::cast_slice_mut::<Point, u8>(&mut damaged)[bit / 8] ^= 1 << (bit % 8);
            assert_ne!(Checksum::of(&damaged), whole, "bit {bit}");
        }
        assert_ne!(Checksum::of(&points[1..]), whole);
    }

    #[test]
    fn text_round_trips() {
        let checksum = Checksum(0x00ab_cdef_0123_4567);
        let json = serde_json::to_string(&checksum).unwrap();
        assert_eq!(json, "\"00abcdef01234567\"");
        assert_eq!(serde_json::from_str::<Checksum>(&json).unwrap(), checksum);
        for text in ["", "1", "+0abcdef01234567", "00abcdef0123456g", "00abcdef012345678"] {
            assert!(text.parse::<Checksum>().unwrap_err().contains("16 hexadecimal digits"), "{text}");
        }
    }
}
