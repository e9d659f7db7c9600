use rayon::prelude::*;

use super::thin::poisson_thin;
use super::{TemplateCloud, TemplateKind, TemplateOptions};
use crate::cloud::{Bounds, Point};
use crate::skeleton::Template;
use crate::town::{Model, SurfacePoint};

/// All templates that [`default_template`] knows, in the order of kinds.
pub fn default_templates() -> Vec<TemplateCloud> {
    TemplateKind::NAMES.par_iter().filter_map(|(_, kind)| default_template(*kind)).collect()
}

/// A template of sedan, SUV, pickup or van, pedestrian or bike: the evenly thinned surface of a model of the built-in street.
/// Always the same points. Trucks, buses and the like have none, since they differ too much.
pub fn default_template(kind: TemplateKind) -> Option<TemplateCloud> {
    let model = match kind {
        TemplateKind::Sedan => Model::Sedan,
        TemplateKind::Suv => Model::Suv,
        TemplateKind::Pickup => Model::Van,
        TemplateKind::Pedestrian => Model::Walker,
        TemplateKind::Bike => Model::Cyclist,
        _ => return None,
    };
    let size_m = model.size_m();
    let spacing_m = TemplateOptions::default().spacing_m(size_m);
    let surface = model.surface(spacing_m);
    let position = |p: &SurfacePoint| p.local_m.as_vec3().to_array();
    let kept = poisson_thin(surface.iter().map(position), spacing_m);
    let class = kind.class();
    let point = |i: usize| Point::new(position(&surface[i]), surface[i].rgb, class as u8);
    let points: Vec<Point> = kept.into_iter().map(point).collect();
    let bounds = Bounds::of(&points)?;
    Some((Template { kind, class, size: size_m.to_array(), points: points.len(), bounds }, points))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn the_defaults_fill_boxes_of_their_kind() {
        let templates = default_templates();
        let kinds: Vec<TemplateKind> = templates.iter().map(|(t, _)| t.kind).collect();
        use TemplateKind as Kind;
        assert_eq!(kinds, [Kind::Sedan, Kind::Suv, Kind::Pickup, Kind::Pedestrian, Kind::Bike]);
        for (template, points) in &templates {
            let category = match template.kind {
                Kind::Pedestrian => "pedestrian",
                Kind::Bike => "bicycle",
                _ => "vehicle.car",
            };
            assert_eq!(TemplateKind::of_actor(category, DVec3::from(template.size)), Some(template.kind));
            assert!((5_000..=20_000).contains(&points.len()), "{:?} {}", template.kind, points.len());
            assert_eq!(template.points, points.len());
            for axis in 0..3 {
                let (half, near) = (template.size[axis] / 2.0, 0.05);
                assert!((f64::from(template.bounds.max[axis]) - half).abs() < near, "{template:?}");
                assert!((f64::from(template.bounds.min[axis]) + half).abs() < near, "{template:?}");
            }
            assert!(points.iter().all(|p| p.class() == template.class as u8));
        }
        assert_eq!(templates, default_templates());
    }
}
