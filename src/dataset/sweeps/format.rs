//! File formats recognized by their first bytes, in place of raw numbers.

use crate::files::sniff;

/// Absolute values of coordinates that occur, meters.
const COORDINATES_M: std::ops::Range<f32> = 1e-5..1e4;

/// Maximum length of a PCD header, bytes; real headers take a few hundred.
pub(super) const MAX_HEADER_BYTES: u64 = 1 << 16;

/// Returns whether a file begins with a PCD header.
pub(in crate::dataset) fn is_pcd(bytes: &[u8]) -> bool {
    // Comments of any length precede the first line.
    let head = &bytes[..bytes.len().min(MAX_HEADER_BYTES as usize)];
    let lines = head.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.into_iter().find(|line| !line.is_empty() && !line.starts_with(b"#"));
    let key = first.and_then(|line| line.split(u8::is_ascii_whitespace).next());
    matches!(key, Some(b"VERSION" | b"FIELDS" | b"COLUMNS")) || is_pcd_comment(head)
}

/// Returns whether the first line is the comment with which PCD files begin.
fn is_pcd_comment(head: &[u8]) -> bool {
    let line = head.split(|byte| *byte == b'\n').next().unwrap_or_default();
    line.to_ascii_uppercase().starts_with(b"# .PCD")
}

/// Returns the name of a format that is not a sweep's, for messages; `None` if the bytes may be numbers:
/// short marks also occur as coordinates.
pub(in crate::dataset) fn named_format(bytes: &[u8]) -> Option<String> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let first = bytes.first_chunk().map(|b| f32::from_le_bytes(*b));
    let may_be_first = first.is_none_or(|v| v == 0.0 || COORDINATES_M.contains(&v.abs()));
    let is_marked = || sniff::marked(bytes).is_some();
    if may_be_first && !sniff::has_long_mark(bytes) && is_marked() { None } else { sniff::described(bytes) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_recognized_by_their_first_bytes() {
        for (bytes, name) in [
            (&b"ply\nformat ascii 1.0\n"[..], "a PLY file"),
            (b"\x93NUMPY\x01\x00", "an NPY array"),
            (b"PK\x03\x04", "a ZIP archive"),
            (b"\x1f\x8b\x08\x00", "gzip-compressed data"),
            (b"\x89MCAP0\r\n", "an MCAP file"),
            (b"1.0 2.0 3.0 4.0 5.0\n1.5 2.0 3.0 4.0 5.0\n", "text that begins with"),
            // A small number can have the same bytes.
            (b"404: File not found\n", "text that begins with \"404: File not found\""),
            (b"\xef\xbb\xbf404: Not Found", "text that begins with \"404: Not Found\""),
        ] {
            let found = named_format(bytes).unwrap();
            assert!(found.starts_with(name), "{found}");
        }
        assert_eq!(named_format(b""), None);
    }

    /// Marks of two or three bytes may be the first bytes of a coordinate.
    #[test]
    fn numbers_are_not_a_format() {
        let numbers = [1.0_f32, -2.5, 0.0, 100.0, 31.0].map(f32::to_le_bytes);
        assert_eq!(named_format(numbers.as_flattened()), None);
        assert_eq!(named_format(&[0; 600]), None);
        for first in [[0x1f, 0x8b, 0x28, 0x41], [0xff, 0xfe, 0x9f, 0xc1], *b"BZh?", [0xff, 0xd8, 0xff, 0x40]]
        {
            let rest = numbers.as_flattened();
            assert_eq!(named_format(&[&first[..], rest].concat()), None, "{first:x?}");
        }
    }

    #[test]
    fn pcd_headers_are_recognized_with_any_comments() {
        let long = format!("# {}\nVERSION 0.7\n", "x".repeat(3000));
        for text in [
            "# .PCD v0.7\nVERSION",
            "# .pcd v.7 - made\r\n",
            "VERSION .7\nFIELDS x",
            "\nFIELDS x y z\n",
            &long,
        ] {
            assert!(is_pcd(text.as_bytes()), "{text}");
        }
        for text in ["", "#", "# other\n1 2 3", "VERSIONS 1", "ply\nVERSION"] {
            assert!(!is_pcd(text.as_bytes()), "{text}");
        }
    }
}
