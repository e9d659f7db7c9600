//! JSON files of other programs: strict parsing first, then with the deviations that common writers make,
//! then a message with field and record.
//!
//! Python and C++ write `NaN` and `inf`, Windows a byte order mark. A file with these opens as long as no
//! number that is read is missing. The second attempt is only made after the first has failed, so files that
//! follow the standard are parsed once.

use std::borrow::Cow;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_json::error::Category;
use serde_path_to_error::{Deserializer as PathDeserializer, Path as FieldPath, Segment, Track};

use super::input::read_table;
use super::sniff;
use crate::error::FileError;

mod identity;
mod shape;
mod wording;

#[cfg(feature = "nuscenes")]
pub(crate) use shape::object_instead_of_array;

/// UTF-8 byte order mark.
pub(crate) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Reads and parses a JSON file; `expected` describes its content in messages.
///
/// # Errors
/// Fails as [`read_table`] and [`parse`].
pub fn read<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T, FileError> {
    parse(&read_table(path)?, expected, path)
}

/// Parses the bytes of a JSON file; `expected` and `path` are for messages.
///
/// # Errors
/// Fails if the bytes are not JSON or have other fields or values. The message names the field and the
/// record.
pub fn parse<T: DeserializeOwned>(bytes: &[u8], expected: &str, path: &Path) -> Result<T, FileError> {
    parsed(bytes).map_err(|found| FileError::content(expected, found, path))
}

/// Parses JSON as [`parse`] does.
///
/// # Errors
/// Returns a description of what was found.
pub fn parsed<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    serde_json::from_slice(bytes).or_else(|_| parse_repaired(bytes))
}

/// First difference between two documents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Keys to the place, separated by dots.
    pub place: String,
    /// Both values as JSON, `none` where one is missing.
    pub values: [String; 2],
}

/// Returns the first difference between two documents: for objects, the error of the first key whose values
/// differ.
pub fn difference(a: &Value, b: &Value) -> Option<Difference> {
    if a == b {
        return None;
    }
    if let (Value::Object(a), Value::Object(b)) = (a, b) {
        let key = a.keys().chain(b.keys()).find(|key| a.get(*key) != b.get(*key))?;
        let inner = difference(a.get(key).unwrap_or(&Value::Null), b.get(key).unwrap_or(&Value::Null));
        let text = |value: Option<&Value>| value.map_or_else(|| "none".to_owned(), Value::to_string);
        return Some(match inner {
            Some(inner) if a.contains_key(key) && b.contains_key(key) => {
                let place =
                    if inner.place.is_empty() { key.clone() } else { format!("{key}.{}", inner.place) };
                Difference { place, ..inner }
            }
            _ => Difference { place: key.clone(), values: [text(a.get(key)), text(b.get(key))] },
        });
    }
    Some(Difference { place: String::new(), values: [a.to_string(), b.to_string()] })
}

/// Parses JSON with deviations from the standard.
#[cold]
fn parse_repaired<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    if let Some(found) = sniff::marked(bytes) {
        return Err(found.to_owned());
    }
    let text = repaired(bytes);
    let mut track = Track::new();
    let mut json = serde_json::Deserializer::from_slice(&text);
    let result = T::deserialize(PathDeserializer::new(&mut json, &mut track));
    result.and_then(|value| json.end().map(|()| value)).map_err(|error| {
        let path = track.path();
        let place = place(&text, &path, &error);
        match error.classify() {
            // The document itself, whose fields belong to no record.
            Category::Data if path.iter().len() == 0 && !error.to_string().contains(" field ") => {
                wording::document(&error, &text)
            }
            Category::Data => wording::data(&error, &place),
            Category::Syntax if matches!(&text, Cow::Owned(_)) => {
                wording::syntax(&error, &text, &place, false)
            }
            Category::Syntax => wording::syntax(&error, &text, &place, true),
            Category::Eof | Category::Io => {
                format!("the end of the file after {} bytes{place} (cut off)", bytes.len())
            }
        }
    })
}

/// Returns where an error is: ` in FIELD of record ID`, as far as known.
fn place(text: &[u8], path: &FieldPath, error: &serde_json::Error) -> String {
    // Records before the place of a syntax error can be parsed, but not the one that contains it.
    let segments: Vec<&Segment> = path.iter().filter(|s| !matches!(s, Segment::Unknown)).collect();
    let id = error.is_data().then(|| identity::of(text, &segments)).flatten();
    let record = id.map_or_else(String::new, |id| format!(" of record {id}"));
    match (segments.is_empty(), record.is_empty()) {
        (true, true) => String::new(),
        (true, false) => record.replacen(" of", " in", 1),
        (false, _) => format!(" in {}{record}", shown(&segments)),
    }
}

/// Formats a place like `cameras[0].width`.
fn shown(segments: &[&Segment]) -> String {
    let part = |segment: &&Segment| match segment {
        Segment::Seq { index } => format!("[{index}]"),
        Segment::Map { key } => format!(".{key}"),
        Segment::Enum { variant } => format!(".{variant}"),
        Segment::Unknown => String::new(),
    };
    let text: String = segments.iter().map(part).collect();
    text.strip_prefix('.').map_or_else(|| text.clone(), str::to_owned)
}

/// Returns JSON without a byte order mark, with numbers that JSON lacks as strings. Those are refused where a
/// number is read, and skipped with the fields that are not.
fn repaired(bytes: &[u8]) -> Cow<'_, [u8]> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let mut result: Vec<u8> = Vec::new();
    let (mut copied, mut at) = (0, 0);
    while at < bytes.len() {
        match bytes[at] {
            b'"' => at = end_of_string(bytes, at),
            b'-' | b'A'..=b'Z' | b'a'..=b'z' => {
                let length =
                    bytes[at..].iter().take_while(|b| b.is_ascii_alphanumeric() || b"-+.()".contains(b));
                let end = at + length.count();
                if is_not_finite(&bytes[at..end]) {
                    result.extend_from_slice(&bytes[copied..at]);
                    result.push(b'"');
                    result.extend_from_slice(&bytes[at..end]);
                    result.push(b'"');
                    copied = end;
                }
                at = end;
            }
            _ => at += 1,
        }
    }
    if result.is_empty() {
        return Cow::Borrowed(bytes);
    }
    result.extend_from_slice(&bytes[copied..]);
    Cow::Owned(result)
}

/// Returns the index after the string that begins at an index.
fn end_of_string(bytes: &[u8], start: usize) -> usize {
    let mut at = start + 1;
    while at < bytes.len() {
        match bytes[at] {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    bytes.len()
}

/// Returns whether a word is a number that JSON lacks, as Python, C++ and Windows' C library write it.
fn is_not_finite(word: &[u8]) -> bool {
    let word = word.strip_prefix(b"-").unwrap_or(word).to_ascii_lowercase();
    matches!(&word[..], b"nan" | b"inf" | b"infinity" | b"nan(ind)" | b"nan(snan)")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use serde_json::json;

    #[derive(Debug, PartialEq, Deserialize)]
    struct Row {
        token: String,
        #[serde(default)]
        size: Vec<f64>,
        #[serde(default)]
        note: Option<String>,
    }

    fn rows(text: impl AsRef<[u8]>) -> Result<Vec<Row>, String> {
        parsed(text.as_ref())
    }

    #[track_caller]
    fn refused(text: impl AsRef<[u8]>, found: &str) {
        assert_eq!(rows(text).unwrap_err(), found);
    }

    #[test]
    fn numbers_that_json_lacks_are_skipped_in_unread_fields() {
        for word in ["NaN", "Infinity", "-Infinity", "nan", "-inf", "-nan(ind)"] {
            let text = format!(r#"[{{"token": "a", "velocity": [{word}, 1, {word}]}}, {{"token": "NaN"}}]"#);
            let tokens: Vec<String> = rows(&text).unwrap().into_iter().map(|row| row.token).collect();
            assert_eq!(tokens, ["a", "NaN"]);
        }
        refused(
            r#"[{"token": "a"}, {"size": [1, -Infinity], "token": "b\\\"NaN"}]"#,
            r#"-Infinity instead of a number in [1].size[1] of record b\"NaN"#,
        );
        refused(r#"{"token": NaN}"#, "an object instead of an array (JSON lines? write one array)");
    }

    #[test]
    fn byte_order_marks_are_accepted() {
        assert_eq!(rows(b"\xef\xbb\xbf[{\"token\": \"a\"}]").unwrap().len(), 1);
        refused(b"\xff\xfe[\0]\0", "UTF-16 text (save it as UTF-8)");
        refused(b"[\0]\0", "UTF-16 text (save it as UTF-8)");
        refused(b"\x1f\x8b\x08\0\0", "gzip-compressed data (unpack it)");
        refused("", "an empty file");
        refused("<html><body>Sign in", "an HTML page (a failed download?)");
    }

    #[test]
    fn errors_name_field_and_record() {
        refused(
            r#"[{"token": "a"}, {"token": "b", "size": [1, null]}]"#,
            "null instead of a number in [1].size[1] of record b",
        );
        refused(r#"[{"token": 5}]"#, "5 instead of text in [0].token of record 5");
        refused(r#"[{"size": [], "name": "car"}]"#, "no field token in [0] of record car");
        refused(r#"[{"token": "a", "token": "b"}]"#, "field token twice in [0]");
        refused(r#"[{"token": "a", "size": 3}]"#, "3 instead of an array in [0].size of record a");
        refused(
            r#"[{"token": "a", "size": [1e999]}]"#,
            "a number out of range in [0].size[0] near \"1e999]}]\" (line 1, column 30)",
        );
    }

    #[test]
    fn differences_are_named_by_their_keys() {
        let of = |a: Value, b: Value| difference(&a, &b).map(|d| (d.place, d.values));
        let options = json!({"steps": 3, "drop": {"all": 0.5, "map": 1}});
        assert_eq!(of(options.clone(), options.clone()), None);
        let other = json!({"steps": 3, "drop": {"all": 0.25, "map": 1}});
        assert_eq!(of(options.clone(), other), Some(("drop.all".into(), ["0.5".into(), "0.25".into()])));
        let other = json!({"drop": {"all": 0.5, "map": 1}, "warmup": null});
        assert_eq!(of(options.clone(), other.clone()), Some(("steps".into(), ["3".into(), "none".into()])));
        assert_eq!(of(json!([1]), json!([2])), Some((String::new(), ["[1]".into(), "[2]".into()])));
    }

    #[test]
    fn errors_of_writers_are_named() {
        refused(
            "[{'token': 'a'}]",
            "single quotes instead of double quotes in [0] near \"'token': 'a'}]\" (line 1, column 3)",
        );
        refused("[{\"token\": \"a\"},]", "a comma before the closing bracket near \"]\" (line 1, column 17)");
        refused(
            "[{\"token\": None}]",
            "None, a word of Python (JSON has null, true, false), in [0].token near \"None}]\" (line 1, \
                column 12)",
        );
        refused(
            "{\"token\": \"a\"}\n{\"token\": \"b\"}",
            "an object instead of an array (JSON lines? write one array)",
        );
        refused("[]\n[]", "further text after the end near \"[]\" (line 2, column 1)");
        refused("// a\n[]", "a comment, which JSON lacks, near \"// a\\n[]\" (line 1, column 1)");
        refused("[{\"token\": \"a\"", "the end of the file after 14 bytes in [0] (cut off)");
        refused(
            b"[{\"token\": \"\xe9\"}]",
            "text that is not UTF-8 in [0].token near \"\u{fffd}\\\"}]\" (line 1, column 13)",
        );
        refused("404: Not Found", "text that begins with \"404: Not Found\"");
        refused("5", "5 instead of an array");
        for (text, found) in [
            (
                "[{\"note\": \"a\tb\"}]",
                "a control character in a string (write \\n, \\t or \\u00XX) in [0].note near",
            ),
            ("[{\"other\": 0x1F}]", "a hexadecimal number, which JSON lacks, in [0]"),
            ("[{\"other\" 1}]", "something else than `:` in [0]"),
        ] {
            let message = rows(text).unwrap_err();
            assert!(message.starts_with(found), "{message}");
        }
    }
}
