//! What a JSON document is that should be an array of records.

/// Describes an object in place of an array, by its beginning, which may be cut anywhere.
pub(crate) fn object_instead_of_array(text: &[u8]) -> String {
    let start = skip_blanks(text, 0);
    let end = end_of_value(text, start);
    let is_followed = matches!(text.get(skip_blanks(text, end)), Some(b'{' | b','));
    let members = if is_followed { Vec::new() } else { members(text, start) };
    let begin = |at: usize| text.get(at).copied();
    let is_array_of = |at: usize, is: fn(u8) -> bool| {
        begin(at) == Some(b'[') && begin(skip_blanks(text, at + 1)).is_some_and(is)
    };
    let holder = members.iter().find(|(_, at)| is_array_of(*at, |byte| byte == b'{'));
    let reason = match (holder, members.first()) {
        (Some((key, _)), _) => format!("its field {key} holds the records? write that array alone"),
        (None, Some((_, at))) if begin(*at) == Some(b'{') => {
            "records by a key? write an array of them".to_owned()
        }
        (None, Some((_, at))) if is_array_of(*at, |byte| byte != b'{') => {
            "columns? write an object per record".to_owned()
        }
        _ => "JSON lines? write one array".to_owned(),
    };
    format!("an object instead of an array ({reason})")
}

/// Returns the keys of an object, and where their values begin.
fn members(text: &[u8], object: usize) -> Vec<(String, usize)> {
    let mut members = Vec::new();
    let mut at = skip_blanks(text, object + 1);
    while text.get(at) == Some(&b'"') {
        let end = super::end_of_string(text, at);
        let key = text.get(at + 1..end - 1).unwrap_or_default();
        let colon = skip_blanks(text, end);
        let value = skip_blanks(text, colon + 1);
        if text.get(colon) != Some(&b':') || value >= text.len() {
            break;
        }
        members.push((String::from_utf8_lossy(key).into_owned(), value));
        let comma = skip_blanks(text, end_of_value(text, value));
        at = if text.get(comma) == Some(&b',') { skip_blanks(text, comma + 1) } else { text.len() };
    }
    members
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
    fn other_documents_are_named() {
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
    }
}
