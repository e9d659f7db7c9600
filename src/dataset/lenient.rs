//! JSON fields whose damage costs their record only, and records whose damage does not cost the file.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, DeserializeOwned, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

use super::recording::degenerate::{Unreadable, note_missing};
use super::recording::notes::Counts;
use crate::files::json;

/// Coordinate or length; NaN for anything but a number, so that only its record is skipped.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coordinate(pub(super) f64);

impl Default for Coordinate {
    fn default() -> Self {
        Self(f64::NAN)
    }
}

impl<'de> Deserialize<'de> for Coordinate {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(AnyValue).map(Self)
    }
}

struct AnyValue;

impl<'de> Visitor<'de> for AnyValue {
    type Value = f64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    fn visit_f64<E>(self, value: f64) -> Result<f64, E> {
        Ok(value)
    }

    fn visit_i64<E>(self, value: i64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_u64<E>(self, value: u64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_str<E>(self, _: &str) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_bool<E>(self, _: bool) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_unit<E>(self) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<f64, A::Error> {
        while array.next_element::<IgnoredAny>()?.is_some() {}
        Ok(f64::NAN)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<f64, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(f64::NAN)
    }
}

/// Records of a layer, an array. Those that cannot be read are set apart.
#[derive(Debug)]
pub(super) struct Records<T> {
    /// In file order.
    known: Vec<T>,
    unreadable: Unreadable<String>,
}

impl<T> Default for Records<T> {
    fn default() -> Self {
        Self { known: Vec::new(), unreadable: Unreadable::default() }
    }
}

impl<T> Records<T> {
    /// Returns the records of a layer that can be read. Counts the others, or the layer if the map lacks it.
    ///
    /// # Errors
    /// Returns a description if no record can be read.
    pub(super) fn of_layer(layer: &str, records: Option<Self>, notes: &mut Counts) -> Result<Vec<T>, String> {
        let Some(Self { known, unreadable }) = records else {
            note_missing(notes, layer);
            return Ok(Vec::new());
        };
        let none = |first| format!("no record of {layer} that can be read ({first})");
        unreadable.note(layer, known.len(), notes).map_err(none)?;
        Ok(known)
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Records<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_seq(AnyRecords("an array of records", PhantomData))
    }
}

/// [`Records`] that are the values of an object by id.
#[derive(Debug)]
pub(super) struct ById<T>(pub(super) Records<T>);

impl<'de, T: DeserializeOwned> Deserialize<'de> for ById<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_map(AnyRecords("an object by id", PhantomData)).map(Self)
    }
}

/// Visitor of records; the text is for messages.
struct AnyRecords<T>(&'static str, PhantomData<T>);

impl<'de, T: DeserializeOwned> Visitor<'de> for AnyRecords<T> {
    type Value = Records<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<Records<T>, A::Error> {
        let mut records = Records::default();
        while let Some(record) = array.next_element()? {
            records.known.extend(readable(record, &mut records.unreadable));
        }
        Ok(records)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Records<T>, A::Error> {
        let mut records = Records::default();
        while let Some((_, record)) = map.next_entry::<IgnoredAny, _>()? {
            records.known.extend(readable(record, &mut records.unreadable));
        }
        Ok(records)
    }
}

/// Returns a record; `None` if it cannot be read, which is counted.
pub(super) fn readable<T: DeserializeOwned>(record: Value, unreadable: &mut Unreadable<String>) -> Option<T> {
    let read = T::deserialize(&record).ok();
    if read.is_none() {
        // Parsed again for the message.
        let found = || json::parsed::<T>(record.to_string().as_bytes()).err().unwrap_or_default();
        unreadable.add(found);
    }
    read
}

/// Text, or a whole number as text.
#[derive(Clone, Debug, serde::Deserialize)]
#[serde(untagged)]
pub(super) enum Id {
    Number(i64),
    Text(String),
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => number.fmt(f),
            Self::Text(text) => text.fmt(f),
        }
    }
}

/// Reads `null` as the default.
pub(super) fn or_default<'de, T: Deserialize<'de> + Default, D: Deserializer<'de>>(
    from: D,
) -> Result<T, D::Error> {
    Option::deserialize(from).map(Option::unwrap_or_default)
}
