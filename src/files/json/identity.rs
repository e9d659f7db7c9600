//! Name of the record that contains a place in a JSON document.

use std::fmt;

use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Value;
use serde_path_to_error::Segment;

/// Fields that identify a record, the first that it has.
#[derive(Deserialize)]
struct Identity {
    token: Option<Value>,
    id: Option<Value>,
    name: Option<Value>,
}

/// Returns the token, id or name of the innermost record around a place that has one.
pub(super) fn of(text: &[u8], place: &[&Segment]) -> Option<String> {
    // Only objects have fields: the place itself, or what is before a key.
    let is_object = |end: &usize| matches!(place.get(*end), None | Some(Segment::Map { .. }));
    (0..=place.len()).rev().filter(is_object).find_map(|end| {
        let mut found = None;
        let mut json = serde_json::Deserializer::from_slice(text);
        // The seed stops at the place, which is an error of the parser.
        let _ = At { place: &place[..end], found: &mut found }.deserialize(&mut json);
        let Identity { token, id, name } = found?;
        match token.or(id).or(name)? {
            Value::String(text) => Some(text),
            value @ Value::Number(_) => Some(value.to_string()),
            _ => None,
        }
    })
}

/// Parses the value at a place.
struct At<'a> {
    place: &'a [&'a Segment],
    found: &'a mut Option<Identity>,
}

impl<'de> DeserializeSeed<'de> for At<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<(), D::Error> {
        match self.place.first() {
            None => {
                *self.found = Some(Identity::deserialize(from)?);
                Ok(())
            }
            Some(Segment::Seq { .. }) => from.deserialize_seq(self),
            Some(_) => from.deserialize_map(self),
        }
    }
}

impl<'de> Visitor<'de> for At<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the path of an error")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<(), A::Error> {
        let Some((Segment::Seq { index }, rest)) = self.place.split_first() else { return Ok(()) };
        for _ in 0..*index {
            array.next_element::<IgnoredAny>()?;
        }
        array.next_element_seed(At { place: rest, found: self.found }).map(drop)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Some((Segment::Map { key }, rest)) = self.place.split_first() else { return Ok(()) };
        while let Some(other) = map.next_key::<String>()? {
            if other == *key {
                return map.next_value_seed(At { place: rest, found: self.found });
            }
            map.next_value::<IgnoredAny>()?;
        }
        Ok(())
    }
}
