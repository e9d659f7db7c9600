//! Recognizes what the bytes of a file are when they are not what a reader expects: an empty file, a pointer
//! of a version control system, an error page of a download server, an archive, another format.

/// Bytes at the beginning of a file that are examined.
pub(crate) const HEAD_BYTES: usize = 512;

/// Formats by their first bytes, and how to get what was expected.
const MAGIC: [(&[u8], &str); 27] = [
    (b"\x1f\x8b", "gzip-compressed data (unpack it)"),
    (b"PK\x03\x04", "a ZIP archive (unpack it)"),
    (b"BZh", "bzip2-compressed data (unpack it)"),
    (b"\xfd7zXZ\0", "xz-compressed data (unpack it)"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed data (unpack it)"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive (unpack it)"),
    (b"Rar!", "a RAR archive (unpack it)"),
    (b"\xff\xfe", "UTF-16 text (save it as UTF-8)"),
    (b"\xfe\xff", "UTF-16 text (save it as UTF-8)"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x89PNG\r\n\x1a\n", "a PNG image"),
    (b"GIF8", "a GIF image"),
    (b"II*\0", "a TIFF image"),
    (b"MM\0*", "a TIFF image"),
    (b"SQLite format 3\0", "a SQLite database"),
    (b"ARROW1", "an Arrow file (Feather)"),
    (b"FEA1", "a Feather file of version 1 (write version 2)"),
    (b"PAR1", "a Parquet file"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"\x93NUMPY", "an NPY array"),
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"#ROSBAG", "a ROS bag"),
    (b"LASF", "a LAS file"),
    (b"# .PCD", "a PCD file"),
    (b"\xef\xbb\xbf# .PCD", "a PCD file with a byte order mark (save it without one)"),
    (b"ply\n", "a PLY file"),
    (b"ply\r\n", "a PLY file"),
];

/// Beginnings of an HTML page, in lower case.
const HTML: [&str; 3] = ["<!doctype html", "<html", "<head"];

/// Names content that stands in for a file that was never downloaded. No format that this project reads
/// begins like it.
pub(crate) fn undownloaded(head: &[u8]) -> Option<&'static str> {
    let text = start_of_text(head);
    if text.starts_with("version https://git-lfs.github.com/spec/") {
        return Some("a Git LFS pointer (`git lfs pull` fetches the file)");
    }
    let line = text.lines().next().unwrap_or_default();
    if line.starts_with("/annex/objects/") || line.contains(".git/annex/objects/") {
        return Some("a git-annex pointer (`git annex get` fetches the file)");
    }
    let lower = text.to_ascii_lowercase();
    if HTML.iter().any(|begin| lower.starts_with(begin)) {
        return Some("an HTML page (a failed download?)");
    }
    // Object stores answer so.
    let is_xml = lower.starts_with("<?xml") || lower.starts_with("<error>");
    (is_xml && lower.contains("<error>")).then_some("an XML error page (a failed download?)")
}

/// Names the content of a file by its first bytes, [`HEAD_BYTES`] of them at most. `None` if they have no
/// mark, as with text and raw numbers.
pub(crate) fn marked(head: &[u8]) -> Option<&'static str> {
    let head = &head[..head.len().min(HEAD_BYTES)];
    if head.is_empty() {
        return Some("an empty file");
    }
    if let Some(found) = undownloaded(head) {
        return Some(found);
    }
    if let Some((_, found)) = MAGIC.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Some(found);
    }
    let has = |place: usize, mark: &[u8]| head.get(place..).is_some_and(|rest| rest.starts_with(mark));
    match head {
        _ if has(0, b"RIFF") && has(8, b"WEBP") => Some("a WebP image (convert it to JPEG or PNG)"),
        _ if has(4, b"ftypheic") || has(4, b"ftypmif1") || has(4, b"ftypavif") => {
            Some("a HEIC or AVIF image (convert it to JPEG or PNG)")
        }
        _ if has(257, b"ustar") => Some("a tar archive (unpack it)"),
        [b'[' | b'{' | b'"' | b' ' | b'\n', 0, _, 0, ..] => Some("UTF-16 text (save it as UTF-8)"),
        [0, b'[' | b'{' | b'"' | b' ' | b'\n', 0, _, ..] => Some("UTF-16 text (save it as UTF-8)"),
        _ if head.len() > 16 && head.iter().all(|byte| *byte == 0) => {
            Some("zero bytes (a download that was cut off?)")
        }
        _ if start_of_text(head).starts_with("<?xml") => Some("an XML file"),
        _ => None,
    }
}

/// Returns whether the first bytes are a mark that is so long that other data hardly begin with it.
pub(crate) fn has_long_mark(head: &[u8]) -> bool {
    const LONG: usize = 6;
    MAGIC.iter().any(|(magic, _)| magic.len() >= LONG && head.starts_with(magic))
}

/// Describes content: by its mark, or by its beginning if it is text. `None` for other bytes.
pub(crate) fn described(head: &[u8]) -> Option<String> {
    if let Some(found) = marked(head) {
        return Some(found.to_owned());
    }
    let head = &head[..head.len().min(HEAD_BYTES)];
    let is_text = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | b' '..=b'~');
    head.iter().all(is_text).then(|| {
        let line = start_of_text(head).lines().next().unwrap_or_default();
        format!("text that begins with {:?}", line.chars().take(40).collect::<String>())
    })
}

/// Returns the beginning of a text without a byte order mark and blanks; empty if it is not UTF-8.
fn start_of_text(head: &[u8]) -> &str {
    let head = &head[..head.len().min(HEAD_BYTES)];
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    // A character may be cut at the end.
    let text = str::from_utf8(head).or_else(|e| str::from_utf8(&head[..e.valid_up_to()]));
    // Numbers may look like text, but hardly without a zero byte.
    text.ok().filter(|text| !text.contains('\0')).unwrap_or_default().trim_start()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_were_not_downloaded_are_recognized() {
        let lfs = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n";
        let annex = b"/annex/objects/SHA256E-s42--0.jpg\n";
        let html = b"\xef\xbb\xbf\n <!DOCTYPE HTML><html><body>Sign in</body></html>";
        let s3 = b"<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Error><Code>AccessDenied</Code></Error>";
        for (bytes, part) in
            [(&lfs[..], "git lfs pull"), (annex, "git annex get"), (html, "HTML"), (s3, "XML error page")]
        {
            assert!(undownloaded(bytes).is_some_and(|found| found.contains(part)), "{part}");
            assert_eq!(marked(bytes), undownloaded(bytes));
        }
        let svg = b"<?xml version=\"1.0\"?><svg/>";
        assert_eq!((undownloaded(svg), marked(svg)), (None, Some("an XML file")));
        // Numbers may look like text.
        let numbers = b"   <error>r \x01\0 /p\xbe ";
        for other in [&b""[..], b"[]", b"ply\n", b"\0\0\0\0", b"version 1", b"\xff\xd8\xff\xe0", numbers] {
            assert_eq!(undownloaded(other), None);
        }
    }

    #[test]
    fn formats_are_recognized() {
        for (bytes, part) in [
            (&b""[..], "an empty file"),
            (b"\x1f\x8b\x08\0", "gzip"),
            (b"\xff\xfe[\0{\0", "UTF-16"),
            (b"[\0{\0\"\0", "UTF-16"),
            (b"\0[\0{\0\"", "UTF-16"),
            (b"\xff\xd8\xff\xe0\0", "a JPEG image"),
            (b"\xef\xbb\xbf# .PCD v0.7\n", "a PCD file with a byte order mark"),
            (b"RIFF\0\0\0\0WEBPVP8 ", "WebP"),
            (&[0; 40], "zero bytes"),
        ] {
            assert!(marked(bytes).is_some_and(|found| found.contains(part)), "{part}");
        }
        for raw in [&b"[{}]"[..], b"\x01\x02\x03", b"x,y\n1,2\n", b"\0\0\x80\x3f"] {
            assert_eq!(marked(raw), None);
        }
        assert_eq!(described(b"404: Not Found").unwrap(), "text that begins with \"404: Not Found\"");
        assert_eq!(described(b"\x01\x02\x03\xf0"), None);
        let cut = ["x".repeat(HEAD_BYTES - 1), "ä".to_owned()].concat();
        assert_eq!(start_of_text(cut.as_bytes()).len(), HEAD_BYTES - 1);
    }
}
