use super::{LibraryManifest, TemplateCloud};
use crate::cloud::Point;

/// A [`TemplateLibrary`](super::TemplateLibrary), written by `cargo run -p pskel-town --example
/// default_templates`.
const MANIFEST: &str = include_str!("../../../shipped/templates/templates.json");
const POINTS: &[u8] = include_bytes!("../../../shipped/templates/templates.points");

/// Returns the built-in templates, in the order of kinds: sedan, SUV, pickup or van, pedestrian and bike.
/// Other kinds vary too much.
///
/// # Panics
/// Never, since a test reads the built-in files.
pub fn default_templates() -> Vec<TemplateCloud> {
    let manifest: LibraryManifest = serde_json::from_str(MANIFEST).expect("the built-in templates are valid");
    let mut rest: Vec<Point> = bytemuck::pod_collect_to_vec(POINTS);
    let mut clouds = Vec::new();
    for template in manifest.templates {
        let tail = rest.split_off(template.points);
        clouds.push((template, std::mem::replace(&mut rest, tail)));
    }
    clouds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::TemplateKind as Kind;
    use crate::skeleton::entry::Entry;

    #[test]
    fn the_built_in_files_are_a_library_of_five_kinds() {
        let templates = default_templates();
        let kinds: Vec<Kind> = templates.iter().map(|(t, _)| t.kind).collect();
        assert_eq!(kinds, [Kind::Sedan, Kind::Suv, Kind::Pickup, Kind::Pedestrian, Kind::Bike]);
        for (index, (template, points)) in templates.iter().enumerate() {
            assert_eq!(template.points, points.len());
            template.check(index, points, "templates.points".as_ref()).unwrap();
        }
        let total: usize = templates.iter().map(|(t, _)| t.points).sum();
        assert_eq!(total * size_of::<Point>(), POINTS.len());
    }
}
