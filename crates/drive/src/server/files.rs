//! Files of saved drives.

use std::path::Path;

/// Maximum size of a file that is sent.
const MAX_BYTES: u64 = 1 << 30;

/// Returns type and content of a file in a folder; `None` if there is none, or if the path could lead out.
pub(super) fn read(folder: &Path, path: &str) -> Option<(&'static str, Vec<u8>)> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let is_name = |name: &str| !name.is_empty() && !name.starts_with('.') && name.chars().all(is_plain);
    if !path.split('/').all(is_name) {
        return None;
    }
    let (root, file) = (folder.canonicalize().ok()?, folder.join(path).canonicalize().ok()?);
    // A link may lead out.
    let meta = file.metadata().ok()?;
    if !file.starts_with(root) || !meta.is_file() || meta.len() > MAX_BYTES {
        return None;
    }
    let kind = match file.extension()?.to_str()? {
        "html" => "text/html; charset=utf-8",
        "json" | "jsonl" => "application/json",
        "png" => "image/png",
        "jpg" => "image/jpeg",
        "mp4" => "video/mp4",
        _ => "application/octet-stream",
    };
    Some((kind, std::fs::read(file).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_in_the_folder() {
        let scratch = tempfile::tempdir().unwrap();
        let out = scratch.path().join("out");
        std::fs::create_dir_all(out.join("a/b")).unwrap();
        std::fs::write(out.join("a/b/x.png"), "1").unwrap();
        std::fs::write(out.join("a/.hidden.png"), "1").unwrap();
        std::fs::write(scratch.path().join("secret.png"), "2").unwrap();
        std::os::unix::fs::symlink("../../secret.png", out.join("a/link.png")).unwrap();
        assert_eq!(read(&out, "a/b/x.png"), Some(("image/png", b"1".to_vec())));
        let secret = scratch.path().join("secret.png");
        for path in [
            "",
            "a",
            "a/b",
            "../secret.png",
            "a/../../secret.png",
            "a//b/x.png",
            "a/link.png",
            "a/.hidden.png",
        ]
        .into_iter()
        .chain(secret.to_str())
        {
            assert_eq!(read(&out, path), None, "{path}");
        }
    }
}
