//! Messages of the JSON parser in the words of this project: what was found, and where.

use std::borrow::Cow;

use serde::de::IgnoredAny;

use super::shape;
use crate::files::sniff;

/// Types as the parser names them, and in plain words.
const TYPES: [(&str, &str); 12] = [
    ("f64", "a number"),
    ("f32", "a number"),
    ("i64", "a whole number"),
    ("u8", "a whole number from 0 to 255"),
    ("u16", "a whole number from 0 to 65535"),
    ("u32", "a whole number from 0"),
    ("u64", "a whole number from 0"),
    ("usize", "a whole number from 0"),
    ("a string", "text"),
    ("a boolean", "true or false"),
    ("a sequence", "an array"),
    ("a map", "an object"),
];

/// Describes a value or field that does not fit; `place` follows it.
pub(super) fn data(error: &serde_json::Error, place: &str) -> String {
    let text = without_position(error);
    let quoted = |rest: &str| rest.split('`').nth(1).unwrap_or(rest).to_owned();
    for kind in ["invalid type: ", "invalid value: ", "invalid length "] {
        if let Some((found, expected)) =
            text.strip_prefix(kind).and_then(|rest| rest.rsplit_once(", expected "))
        {
            let count = if kind.contains("length") { " elements" } else { "" };
            return format!("{}{count} instead of {}{place}", value(found), plain(expected));
        }
    }
    if let Some(rest) = text.strip_prefix("missing field ") {
        return format!("no field {}{place}", quoted(rest));
    }
    if let Some(rest) = text.strip_prefix("duplicate field ") {
        return format!("field {} twice{place}", quoted(rest));
    }
    if let Some((name, others)) = text.strip_prefix("unknown field ").and_then(|rest| rest.split_once(", ")) {
        let others = others.replace("expected one of ", "instead of ").replace("expected ", "instead of ");
        return format!("the unknown field {}{place}, {}", quoted(name), others.replace('`', ""));
    }
    // Messages of this project's own types.
    if let Some((expected, found)) =
        text.strip_prefix("expected ").and_then(|rest| rest.split_once(", found "))
    {
        return format!("{found} instead of {expected}{place}");
    }
    format!("{text}{place}")
}

/// Describes a document of another kind.
pub(super) fn document(error: &serde_json::Error, text: &[u8]) -> String {
    let found = data(error, "");
    match found.as_str() {
        "an object instead of an array" => shape::object_instead_of_array(text),
        // Text may begin like JSON.
        _ if serde_json::from_slice::<IgnoredAny>(text).is_err() => sniff::described(text).unwrap_or(found),
        _ => found,
    }
}

/// Describes text that is not JSON; `place` follows it, and the beginning of the text where the parser
/// stopped.
pub(super) fn syntax(error: &serde_json::Error, text: &[u8], place: &str, with_position: bool) -> String {
    let message = without_position(error);
    let mut at = offset(text, error.line(), error.column());
    if message == "number out of range" {
        // The parser stops inside of it.
        let is_number = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-.".contains(byte);
        at -= text[..at].iter().rev().take_while(|byte| is_number(byte)).count();
    }
    let rest = &text[at..];
    let is_hex = matches!(rest.first(), Some(b'x' | b'X')) && text[..at].ends_with(b"0");
    let reason: Cow<'_, str> = match message.as_str() {
        _ if rest.starts_with(b"'") => "single quotes instead of double quotes".into(),
        _ if ["None", "True", "False"].iter().any(|word| rest.starts_with(word.as_bytes())) => {
            let word = &rest[..rest.iter().take_while(|b| b.is_ascii_alphabetic()).count()];
            let word = String::from_utf8_lossy(word);
            return format!(
                "{word}, a word of Python (JSON has null, true, false),{place}{}",
                near(rest, error, with_position)
            );
        }
        _ if rest.starts_with(b"//") || rest.starts_with(b"/*") || rest.starts_with(b"#") => {
            "a comment, which JSON lacks,".into()
        }
        _ if is_hex => "a hexadecimal number, which JSON lacks,".into(),
        "trailing comma" => "a comma before the closing bracket".into(),
        "trailing characters" => "further text after the end".into(),
        "number out of range" => "a number out of range".into(),
        "invalid unicode code point" => "text that is not UTF-8".into(),
        "expected value" | "expected ident" => "no JSON value".into(),
        other if other.starts_with("control character") => {
            "a control character in a string (write \\n, \\t or \\u00XX)".into()
        }
        other => match other.strip_prefix("expected ") {
            Some(expected) => format!("something else than {expected}").into(),
            None => other.into(),
        },
    };
    format!("{reason}{place}{}", near(rest, error, with_position))
}

/// Returns ` near TEXT (line L, column C)`.
fn near(rest: &[u8], error: &serde_json::Error, with_position: bool) -> String {
    let text = String::from_utf8_lossy(&rest[..rest.len().min(64)]);
    let text: String = text.chars().take(20).collect();
    let position = match with_position {
        true => format!(" (line {}, column {})", error.line(), error.column().max(1)),
        false => String::new(),
    };
    format!(" near {text:?}{position}")
}

/// Returns the parser's message without its position.
fn without_position(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let end = text.rfind(" at line ").filter(|_| error.line() > 0);
    text[..end.unwrap_or(text.len())].to_owned()
}

/// Returns the offset of a line and column, both from 1.
fn offset(text: &[u8], line: usize, column: usize) -> usize {
    let mut lines = text.split_inclusive(|byte| *byte == b'\n');
    let before: usize = lines.by_ref().take(line.saturating_sub(1)).map(<[u8]>::len).sum();
    (before + column.saturating_sub(1)).min(text.len())
}

/// Returns a value as the file has it.
fn value(found: &str) -> String {
    let bare = |kind: &str| found.strip_prefix(kind).map(|rest| rest.trim_matches('`').to_owned());
    if let Some(word) = found.strip_prefix("string \"").and_then(|rest| rest.strip_suffix('"'))
        && super::is_not_finite(word.as_bytes())
    {
        return word.to_owned();
    }
    let number = bare("integer ").or_else(|| bare("floating point ")).or_else(|| bare("boolean "));
    number.or_else(|| bare("string ")).unwrap_or_else(|| match found {
        "map" => "an object".to_owned(),
        "sequence" => "an array".to_owned(),
        "unit value" => "null".to_owned(),
        other => other.to_owned(),
    })
}

/// Returns an expected type in plain words.
fn plain(expected: &str) -> &str {
    match expected.split_once(' ') {
        Some(("struct", rest)) if !rest.contains(' ') => "an object",
        _ => TYPES.iter().find(|(name, _)| *name == expected).map_or(expected, |(_, plain)| plain),
    }
}
