//! Escapes and shortens text from data in messages, so that it can neither control a terminal nor flood it.

use std::borrow::Cow;
use std::path::Path;

/// Maximum length of a value in a message, characters.
const MAX_VALUE: usize = 400;
/// Maximum length of a path in a message, characters: more than usual folders need.
const MAX_PATH: usize = 1024;
/// Maximum length of a line, characters.
const MAX_LINE: usize = 8192;

/// Formats a value for a message, in one line: escapes control characters, and shortens a long value to its
/// beginning, its end and its length.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(shortened(text, MAX_VALUE), acts)
}

/// Formats a line with values from data like [`printable`], with a limit for long lines.
pub fn printable_line(text: &str) -> Cow<'_, str> {
    escaped(shortened(text, MAX_LINE), acts)
}

/// Formats a path for a message like [`printable`], with a limit for deep folders.
pub fn printable_path(path: &Path) -> String {
    let text = path.to_string_lossy();
    escaped(shortened(&text, MAX_PATH), acts).into_owned()
}

/// Escapes control characters in lines of a result with values from data. Nothing is shortened; line breaks
/// stay.
pub fn escaped_lines(text: &str) -> Cow<'_, str> {
    escaped(Cow::Borrowed(text), |c| c != '\n' && acts(c))
}

/// Formats the lines of a message like [`printable`], each with a limit for long lines. Line breaks stay.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    let long = |line: &str| line.len() > MAX_LINE;
    if !text.lines().any(long) {
        return escaped_lines(text);
    }
    Cow::Owned(text.split('\n').map(printable_line).collect::<Vec<_>>().join("\n"))
}

/// Returns whether a character controls a terminal or the layout: control characters, line and paragraph
/// separators, and marks that change the text direction.
pub(super) fn acts(c: char) -> bool {
    let turns =
        matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() || turns || matches!(c, '\u{2028}' | '\u{2029}')
}

fn escaped(text: Cow<'_, str>, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.chars().any(&is_escaped) {
        return text;
    }
    let mut result = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            _ if !is_escaped(c) => result.push(c),
            '\n' => result.push_str("\\n"),
            '\r' => result.push_str("\\r"),
            '\t' => result.push_str("\\t"),
            ..'\u{20}' => result.push_str(&format!("\\x{:02x}", u32::from(c))),
            // JSON's own syntax: its strings may hold these characters unescaped, and JSON text stays valid
            // when they are escaped here.
            _ => result.push_str(&format!("\\u{:04x}", u32::from(c))),
        }
    }
    Cow::Owned(result)
}

/// Shortens a text to `most` characters, two thirds of them from the beginning.
fn shortened(text: &str, most: usize) -> Cow<'_, str> {
    // A character has at least one byte.
    let count = if text.len() <= most { 0 } else { text.chars().count() };
    if count <= most {
        return Cow::Borrowed(text);
    }
    let tail = most / 3;
    let at = |place: usize| text.char_indices().nth(place).map_or(text.len(), |(byte, _)| byte);
    let (head, tail) = (&text[..at(most - tail)], &text[at(count - tail)..]);
    Cow::Owned(format!("{head} … {tail} ({count} characters)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terminal_controls_are_escaped() {
        assert_eq!(printable("CAM_FRONT é 😀"), "CAM_FRONT é 😀");
        assert_eq!(printable("\u{1b}[2J\u{7}a\nb\tc\r\0"), "\\x1b[2J\\x07a\\nb\\tc\\r\\x00");
        assert_eq!(printable("\u{9b}31m\u{202e}x\u{2028}"), "\\u009b31m\\u202ex\\u2028");
        assert_eq!(printable_path(Path::new("/a\u{1b}b/c")), "/a\\x1bb/c");
        assert_eq!(printable_lines("a\u{1b}\nb\r"), "a\\x1b\nb\\r");
        // Escaped text is not escaped again.
        assert_eq!(printable(&printable("\u{1b}")), "\\x1b");
    }

    #[test]
    fn escaped_json_is_the_same_json() {
        let name = "a\u{1b}[2J\u{7f}\u{9b}31m\u{202e}\u{2028}\u{61c}\n\"\\é😀";
        let json = serde_json::to_string_pretty(&serde_json::json!({ name: [name] })).unwrap();
        let printed = escaped_lines(&json).into_owned();
        assert!(!printed.contains(|c| c != '\n' && acts(c)), "{printed}");
        let read: serde_json::Value = serde_json::from_str(&printed).unwrap();
        assert_eq!(read[name][0], name);
    }

    #[test]
    fn long_text_keeps_its_beginning_and_its_end() {
        let text = format!("begin{}end", "ä".repeat(100_000));
        let short = printable(&text);
        assert!(short.starts_with("beginää") && short.ends_with("äend (100008 characters)"), "{short}");
        assert!(short.chars().count() < MAX_VALUE + 30);
        assert_eq!(printable(&"ä".repeat(MAX_VALUE)), "ä".repeat(MAX_VALUE));
        assert!(printable_path(Path::new(&text)).chars().count() < MAX_PATH + 30);
        let lines = printable_lines(&format!("a\n{}\nb", "x".repeat(MAX_LINE + 1))).into_owned();
        assert!(lines.starts_with("a\nxx") && lines.ends_with("(8193 characters)\nb"), "{lines}");
    }
}
