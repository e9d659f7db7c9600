//! Places of paths that need not exist.

use std::path::{Component, Path, PathBuf};

/// Maximum number of links that are followed, as on Linux, so that links in a circle end.
const MAX_LINKS: usize = 40;

/// Returns the absolute place of a path, which need not exist. Links are followed, also those that lead
/// nowhere; `..` leaves the folder before it, even if that does not exist yet.
pub fn resolved(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut links = MAX_LINKS;
    follow(&absolute, &mut links)
}

/// Returns whether a path is a folder or something below it. Neither need exist.
pub fn is_inside(path: &Path, folder: &Path) -> bool {
    resolved(path).starts_with(resolved(folder))
}

/// Returns whether two paths are one file or folder. Neither need exist.
pub fn is_one_file(a: &Path, b: &Path) -> bool {
    resolved(a) == resolved(b)
}

/// Resolves a path part by part; `links` is the number of links that may still be followed.
fn follow(path: &Path, links: &mut usize) -> PathBuf {
    let mut place = PathBuf::new();
    for part in path.components() {
        if part == Component::ParentDir {
            place.pop(); // the root is above itself
            continue;
        }
        place.push(part);
        if *links > 0
            && let Ok(target) = std::fs::read_link(&place)
        {
            *links -= 1;
            place.pop();
            place = follow(&place.join(target), links);
        }
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn paths_may_not_exist() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let at = |name: &str| root.join(name);
        std::fs::create_dir_all(at("data/sub")).unwrap();
        for (target, link) in [
            ("data/sub", "link"),
            ("data/new", "dangling"),
            ("dangling", "second"),
            ("../x", "data/up"),
            ("circle", "circle"),
        ] {
            symlink(target, at(link)).unwrap();
        }
        symlink(at("data"), at("absolute")).unwrap();
        for (path, place) in [
            ("data", "data"),
            ("new/../x", "x"),
            ("new/a/../../x", "x"),
            ("link/../x", "data/x"),
            ("link/./new", "data/sub/new"),
            ("dangling", "data/new"),
            ("second/a/../b", "data/new/b"),
            ("absolute/up/y", "x/y"),
            ("circle", "circle"),
        ] {
            assert_eq!(resolved(&at(path)), at(place), "{path}");
        }
        assert_eq!(resolved(Path::new("/../a")), Path::new("/a"));
        for (path, folder, expected) in [
            ("data", "data", true),
            ("none/../data/a", "absolute", true),
            ("dangling/a", "data", true),
            ("link/../../a", "data", false),
            ("data2", "data", false),
        ] {
            assert_eq!(is_inside(&at(path), &at(folder)), expected, "{path}");
        }
    }

    #[test]
    fn one_file_has_many_names() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("a")).unwrap();
        let at = |name: &str| folder.path().join(name);
        symlink("x", at("link")).unwrap();
        for _ in 0..2 {
            for name in ["a/../x", "new/../x", "link"] {
                assert!(is_one_file(&at("x"), &at(name)), "{name}");
            }
            assert!(!is_one_file(&at("x"), &at("a/x")));
            std::fs::write(at("x"), "").unwrap();
        }
    }
}
