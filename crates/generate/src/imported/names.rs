//! Names in the paths of images.

/// Returns whether names of scenes and cameras end at this character.
fn ends_name(character: char) -> bool {
    matches!(character, '/' | '_')
}

/// Finds `name` in a path, between its ends, `/` or `_`. Returns the position of its first byte.
pub(super) fn find(path: &str, name: &str) -> Option<usize> {
    let is_apart = |at: &usize| {
        let (before, after) = (&path[..*at], &path[at + name.len()..]);
        before.chars().next_back().is_none_or(ends_name) && after.chars().next().is_none_or(ends_name)
    };
    path.match_indices(name).map(|(at, _)| at).find(is_apart).filter(|_| !name.is_empty())
}

/// Returns the index of the longest name in a path.
pub(super) fn longest<'n>(path: &str, names: impl Iterator<Item = &'n str>) -> Option<usize> {
    let found = names.enumerate().filter(|(_, name)| find(path, name).is_some());
    found.max_by_key(|(_, name)| name.len()).map(|(number, _)| number)
}

/// Returns a path without all occurrences of a name.
pub(super) fn without(path: &str, name: &str) -> String {
    let mut rest = path.to_owned();
    while let Some(at) = find(&rest, name) {
        rest.replace_range(at..at + name.len(), "");
    }
    rest
}

/// Returns a path without the numbers of samples that MagicDrive appends to names: `_gen0` or `_gen_0`.
pub(super) fn without_samples(path: &str) -> String {
    let parts = path.split('/').map(|part| {
        let digits = part.len() - part.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        let (stem, number) = part.split_at(part.len() - digits);
        let stem = stem.strip_suffix("_gen_").or_else(|| stem.strip_suffix("_gen"));
        stem.filter(|_| !number.is_empty()).unwrap_or(part)
    });
    parts.collect::<Vec<_>>().join("/")
}

/// Returns the only number in a text; `None` without or with several.
pub(super) fn only_number(text: &str) -> Option<u64> {
    let mut numbers = numbers(text);
    numbers.next().filter(|_| numbers.next().is_none())?.parse().ok()
}

/// Returns the last number in a text.
pub(super) fn last_number(text: &str) -> Option<u64> {
    numbers(text).last()?.parse().ok()
}

fn numbers(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_ascii_digit()).filter(|digits| !digits.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_end_at_separators() {
        assert_eq!(find("a/scene-0103_CAM_FRONT/1", "scene-0103"), Some(2));
        assert_eq!(find("scene-01031/1", "scene-0103"), None);
        assert_eq!(find("scene-0103-010s/1", "scene-0103"), None);
        assert_eq!(find("xCAM/CAM", "CAM"), Some(5));
        assert_eq!(find("a", ""), None);
        let cameras = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK"];
        let camera = |path| longest(path, cameras.into_iter());
        assert_eq!(camera("CAM_FRONT_LEFT/n__CAM_FRONT_LEFT__1"), Some(1));
        assert_eq!([camera("s_CAM_FRONT/12_CAM_FRONT"), camera("CAM_SIDE/1")], [Some(0), None]);
        assert_eq!(without("s_CAM/12_CAM", "CAM"), "s_/12_");
    }

    #[test]
    fn numbers_of_samples_are_removed() {
        assert_eq!(without_samples("CAM/n__CAM__153_gen_0"), "CAM/n__CAM__153");
        assert_eq!(without_samples("ab12_gen0/ab12_CAM"), "ab12/ab12_CAM");
        assert_eq!(without_samples("a_gen/regen5/_gen"), "a_gen/regen5/_gen");
    }

    #[test]
    fn frames_have_one_number() {
        assert_eq!([only_number("/_0012_"), only_number("a"), only_number("1/2")], [Some(12), None, None]);
        assert_eq!([last_number("n015-2018__153"), last_number("a")], [Some(153), None]);
    }
}
