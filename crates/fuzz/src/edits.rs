//! Edits of JSON values; the result is always valid JSON.

use serde_json::{Map, Value};

use crate::choices::Choices;

/// Returns the JSON file for an input: after a first byte of 0, the input is edits of `base`; any other input
/// is the file itself.
pub fn json_file(data: &[u8], base: &Value) -> Vec<u8> {
    match data.split_first() {
        Some((0, edits)) => {
            let mut value = base.clone();
            edit(&mut value, edits);
            value.to_string().into_bytes()
        }
        _ => data.to_vec(),
    }
}

/// Edits a document: each edit descends to a value and changes it.
pub fn edit(document: &mut Value, edits: &[u8]) {
    let mut choices = Choices::new(edits);
    // Copies multiply: a few edits must not create a large file.
    let mut left = 64;
    while !choices.is_empty() && left > 0 {
        let copy = descend(document, &mut choices).clone();
        change(descend(document, &mut choices), copy, &mut choices);
        left -= 1;
    }
}

/// Returns a value somewhere in a document.
fn descend<'v>(mut value: &'v mut Value, choices: &mut Choices<'_>) -> &'v mut Value {
    loop {
        let children = match &*value {
            Value::Array(values) => values.len(),
            Value::Object(fields) => fields.len(),
            _ => 0,
        };
        if children == 0 {
            return value;
        }
        let child = choices.byte();
        if child == u8::MAX {
            return value;
        }
        let child = usize::from(child) % children;
        value = match value {
            Value::Array(values) => &mut values[child],
            Value::Object(fields) => match fields.values_mut().nth(child) {
                Some(field) => field,
                None => unreachable!("it has so many"),
            },
            _ => unreachable!("it has children"),
        };
    }
}

/// Maximum size of a copied value, bytes.
const MAX_COPY: usize = 4096;

fn change(value: &mut Value, copy: Value, choices: &mut Choices<'_>) {
    let kind = choices.byte();
    match (kind % 16, &mut *value) {
        (0, _) => *value = Value::Null,
        (1, _) => *value = choices.integer().into(),
        (2, _) => *value = choices.number().into(),
        (3, _) => *value = u64::from_le_bytes(choices.take()).into(),
        (4, _) => *value = String::from_utf8_lossy(choices.bytes()).into_owned().into(),
        (5, _) => *value = (choices.byte() > 127).into(),
        (6, _) => *value = Value::Array(Vec::new()),
        (7, _) => *value = Value::Object(Map::new()),
        (8, Value::Array(values)) => values.truncate(choices.below(values.len() + 1)),
        (9, Value::Array(values)) if copy.to_string().len() <= MAX_COPY => {
            let times = choices.below(16) + 1;
            values.extend(std::iter::repeat_n(copy, times));
        }
        (10, Value::Array(values)) => values.reverse(),
        (11, Value::Array(values)) if !values.is_empty() => {
            let (a, b) = (choices.below(values.len()), choices.below(values.len()));
            values.swap(a, b);
        }
        (8..=11, Value::Object(fields)) => {
            let key = fields.keys().nth(choices.below(fields.len())).cloned().unwrap_or_default();
            let removed = fields.remove(&key);
            if kind.is_multiple_of(2) {
                let name = String::from_utf8_lossy(choices.bytes()).into_owned();
                fields.insert(name, removed.unwrap_or_default());
            }
        }
        (12, _) => {
            for _ in 0..choices.byte() {
                *value = Value::Array(vec![std::mem::take(value)]);
            }
        }
        _ if copy.to_string().len() <= MAX_COPY => *value = copy,
        _ => *value = Value::Null,
    }
}
