//! MessagePack values that JSON cannot express: bytes, and keys that are not texts.

use serde::ser::{Serialize, Serializer};

/// MessagePack value.
#[derive(Clone, Debug)]
pub enum Pack {
    Nil,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
    List(Vec<Pack>),
    Map(Vec<(Pack, Pack)>),
}

impl Pack {
    pub fn text(text: &str) -> Self {
        Self::Text(text.to_owned())
    }

    pub fn ints(values: &[i64]) -> Self {
        Self::List(values.iter().copied().map(Self::Int).collect())
    }

    /// Returns a map with texts as keys.
    pub fn map(entries: &[(&str, Pack)]) -> Self {
        Self::Map(entries.iter().map(|(key, value)| (Self::text(key), value.clone())).collect())
    }

    /// Returns a NumPy array of a shape, as `msgpack-numpy` writes it: keys are bytes.
    pub fn array(dtype: &str, shape: &[i64], numbers: &[f64]) -> Self {
        let data = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let entries = [
            ("__ndarray__", Self::Bool(true)),
            ("dtype", Self::text(dtype)),
            ("shape", Self::ints(shape)),
            ("data", Self::Bytes(data)),
        ];
        Self::Map(entries.into_iter().map(|(key, value)| (Self::Bytes(key.into()), value)).collect())
    }

    /// Returns the NumPy array of points.
    pub fn points<const N: usize>(points: &[[f64; N]]) -> Self {
        Self::array("<f8", &[points.len() as i64, N as i64], points.as_flattened())
    }
}

impl Serialize for Pack {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Nil => serializer.serialize_none(),
            Self::Bool(value) => serializer.serialize_bool(*value),
            Self::Int(value) => serializer.serialize_i64(*value),
            Self::Float(value) => serializer.serialize_f64(*value),
            Self::Text(text) => serializer.serialize_str(text),
            Self::Bytes(bytes) => serializer.serialize_bytes(bytes),
            Self::List(values) => serializer.collect_seq(values),
            Self::Map(entries) => serializer.collect_map(entries.iter().map(|(key, value)| (key, value))),
        }
    }
}

/// Returns a value as MessagePack.
pub fn packed(value: &impl Serialize) -> Vec<u8> {
    rmp_serde::to_vec_named(value).unwrap()
}
