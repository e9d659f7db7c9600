//! What a JSON document is that should be an array of records.

use std::borrow::Cow;

/// Maximum length of a key in a message, characters.
const MAX_KEY: usize = 40;

/// Describes an object in place of an array, by its beginning, which may be cut anywhere.
pub(crate) fn object_instead_of_array(text: &[u8]) -> String {
    let start = skip_blanks(text, 0);
    let end = end_of_value(text, start);
    let is_followed = matches!(text.get(skip_blanks(text, end)), Some(b'{' | b','));
    let mut members = members(text, start).take_while(|_| !is_followed).peekable();
    let first = members.peek().map(|(_, at)| *at);
    let begin = |at: usize| text.get(at).copied();
    let is_array_of = |at: usize, is: fn(u8) -> bool| {
        begin(at) == Some(b'[') && begin(skip_blanks(text, at + 1)).is_some_and(is)
    };
    let holder = members.find(|(_, at)| is_array_of(*at, |byte| byte == b'{'));
    let reason = match (holder, first) {
        (Some((key, _)), _) => {
            format!("its field {} holds the records? write that array alone", shortened(key))
        }
        (None, Some(at)) if begin(at) == Some(b'{') => "records by a key? write an array of them".to_owned(),
        (None, Some(at)) if is_array_of(at, |byte| byte != b'{') => {
            "columns? write an object per record".to_owned()
        }
        _ => "JSON lines? write one array".to_owned(),
    };
    format!("an object instead of an array ({reason})")
}

/// Returns the beginning of a key.
fn shortened(key: &[u8]) -> Cow<'_, str> {
    // A character has at most 4 bytes.
    let text = String::from_utf8_lossy(&key[..key.len().min(4 * MAX_KEY + 4)]);
    if text.chars().count() <= MAX_KEY {
        return text;
    }
    let beginning: String = text.chars().take(MAX_KEY).collect();
    format!("{beginning}..").into()
}

/// Returns the keys of an object, and where their values begin. A value is read when the next key is asked
/// for.
fn members(text: &[u8], object: usize) -> impl Iterator<Item = (&[u8], usize)> {
    let mut value = None;
    std::iter::from_fn(move || {
        let before = match value {
            None => Some(object),
            Some(value) => {
                let comma = skip_blanks(text, end_of_value(text, value));
                (text.get(comma) == Some(&b',')).then_some(comma)
            }
        };
        let start = skip_blanks(text, before? + 1);
        if text.get(start) != Some(&b'"') {
            return None;
        }
        let end = super::end_of_string(text, start);
        let key = text.get(start + 1..end - 1).unwrap_or_default();
        let colon = skip_blanks(text, end);
        let next = skip_blanks(text, colon + 1);
        if text.get(colon) != Some(&b':') || next >= text.len() {
            return None;
        }
        value = Some(next);
        Some((key, next))
    })
}

/// Returns the index after the value that begins at an index; the length of the text if it does not end.
fn end_of_value(text: &[u8], start: usize) -> usize {
    let (mut at, mut depth) = (start, 0_usize);
    while let Some(byte) = text.get(at) {
        match byte {
            b'"' => {
                at = super::end_of_string(text, at);
                if depth == 0 {
                    return at;
                }
                continue;
            }
            b'{' | b'[' => depth += 1,
            b'}' | b']' if depth <= 1 => return at + depth,
            b'}' | b']' => depth -= 1,
            b',' if depth == 0 => return at,
            _ => {}
        }
        at += 1;
    }
    text.len()
}

fn skip_blanks(text: &[u8], from: usize) -> usize {
    let blanks = text.get(from..).unwrap_or_default().iter();
    from + blanks.take_while(|byte| byte.is_ascii_whitespace()).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_documents_are_described() {
        for (text, reason) in [
            ("{\"token\": \"a\"}\n{\"token\": \"b\"}", "JSON lines? write one array"),
            ("{\"sizes\": [{}]}\n{\"token\": \"b\"}", "JSON lines? write one array"),
            ("{\"a\": \"}\"}", "JSON lines? write one array"),
            ("{}", "JSON lines? write one array"),
            ("{", "JSON lines? write one array"),
            (" {\"data\": [{\"token\": \"a\"}]}", "its field data holds the records? write that array alone"),
            (
                "{\"v\": 1, \"w\": \"x\", \"data\": [ {\"tok",
                "its field data holds the records? write that array alone",
            ),
            ("{\"a\": {\"token\": \"a\"}, \"b\": {", "records by a key? write an array of them"),
            ("{\"token\": [\"a\", \"b\"], \"size\": [[1", "columns? write an object per record"),
        ] {
            let found = object_instead_of_array(text.as_bytes());
            assert_eq!(found, format!("an object instead of an array ({reason})"), "{text}");
        }
        // Keys are shortened.
        for (key, shown) in
            [("k".repeat(40), "k".repeat(40)), ("é".repeat(41), format!("{}..", "é".repeat(40)))]
        {
            let found = object_instead_of_array(format!("{{\"{key}\": [{{}}]}}").as_bytes());
            assert!(found.contains(&format!("(its field {shown} holds")), "{found}");
        }
    }
}
