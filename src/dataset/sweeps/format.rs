//! File formats recognized by their first bytes.

/// Formats by their first bytes. None of these is a plausible coordinate as a little-endian float.
const MAGIC: [(&[u8], &str); 19] = [
    (b"ply\n", "a PLY file"),
    (b"ply\r", "a PLY file"),
    (b"\x93NUMPY", "a NumPy array (NPY)"),
    (b"PK\x03\x04", "a ZIP archive (NPZ?)"),
    (b"ARROW1", "a Feather file"),
    (b"FEA1", "a Feather file of version 1"),
    (b"PAR1", "a Parquet file"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"LASF", "a LAS file"),
    (b"\x1f\x8b\x08", "a gzip file"),
    (b"\x28\xb5\x2f\xfd", "a Zstandard file"),
    (b"\xfd7zXZ\0", "an xz file"),
    (b"#ROSBAG", "a ROS bag"),
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"SQLite format 3\0", "an SQLite database"),
    (b"\x89PNG\r\n", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"version https://git-lfs", "a Git LFS pointer, not the file"),
    (b"<!DOCTYPE", "an HTML page"),
];

/// Name of anything that consists of printable bytes.
pub(super) const TEXT: &str = "text";

/// Bytes in which a header is recognized.
const HEAD: usize = 256;

/// Returns whether a file begins with a PCD header.
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
pub(in crate::dataset) fn is_pcd(bytes: &[u8]) -> bool {
    // Comments of any length precede the header.
    const COMMENTS: usize = 1 << 16;
    let head = &bytes[..bytes.len().min(COMMENTS)];
    let lines = head.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.into_iter().find(|line| !line.is_empty() && !line.starts_with(b"#"));
    let key = first.and_then(|line| line.split(u8::is_ascii_whitespace).next());
    matches!(key, Some(b"VERSION" | b"FIELDS" | b"COLUMNS")) || is_pcd_comment(head)
}

/// Returns whether the first line is the comment with which PCD files begin.
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
fn is_pcd_comment(head: &[u8]) -> bool {
    let line = head.split(|byte| *byte == b'\n').next().unwrap_or_default();
    line.to_ascii_uppercase().starts_with(b"# .PCD")
}

/// Returns the name of a format that is not a sweep's, for messages; `None` if the bytes may be numbers.
pub(in crate::dataset) fn named_format(bytes: &[u8]) -> Option<&'static str> {
    let known = MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic));
    known.map(|(_, name)| *name).or_else(|| is_text(bytes).then_some(TEXT))
}

/// Returns whether all of the first bytes are printable, as never in binary numbers.
fn is_text(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(HEAD)];
    head.len() >= 16 && head.iter().all(|byte| matches!(byte, b'\t' | b'\n' | b'\r' | b' '..=b'~'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_recognized_by_their_first_bytes() {
        for (bytes, name) in [
            (&b"ply\nformat ascii 1.0\n"[..], "a PLY file"),
            (b"\x93NUMPY\x01\x00", "a NumPy array (NPY)"),
            (b"PK\x03\x04", "a ZIP archive (NPZ?)"),
            (b"1.0 2.0 3.0 4.0 5.0\n1.5 2.0 3.0 4.0 5.0\n", "text"),
        ] {
            assert_eq!(named_format(bytes), Some(name));
        }
        let numbers = [1.0_f32, -2.5, 0.0, 100.0, 31.0].map(f32::to_le_bytes);
        assert_eq!(named_format(numbers.as_flattened()), None);
        assert_eq!(named_format(b""), None);
        for (magic, name) in MAGIC {
            if let Some(first) = magic.first_chunk().map(|b| f32::from_le_bytes(*b)) {
                let plausible = first.is_finite() && (1e-5..1e4).contains(&first.abs());
                assert!(!plausible, "{name} begins with {first}");
            }
        }
    }

    #[test]
    #[cfg(any(feature = "nuscenes", feature = "nuplan"))]
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
