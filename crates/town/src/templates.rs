//! Category templates from the surfaces of the town's bodies; the core ships a copy of them as its defaults.

use glam::DVec3;
use point_skeleton::cloud::{Bounds, Point};
use point_skeleton::dataset::Class;
use point_skeleton::files::Checksum;
use point_skeleton::skeleton::{Template, TemplateCloud, TemplateKind, TemplateOptions, poisson_thin};
use rayon::prelude::*;

use crate::model::{BodyKind, SurfacePoint, surface, typical};

/// Returns templates of sedan, SUV, pickup or van, pedestrian and bike, in the order of kinds: the evenly
/// thinned surface of the median body. For pickups and vans this is a pickup with a lid, an outline between
/// both. The points are always the same. Trucks, buses and the like have none, since they vary too much.
pub fn templates() -> Vec<TemplateCloud> {
    TemplateKind::ALL.into_par_iter().filter_map(template).collect()
}

fn template(kind: TemplateKind) -> Option<TemplateCloud> {
    let mesh = typical(match kind {
        TemplateKind::Sedan => BodyKind::Sedan,
        TemplateKind::Suv => BodyKind::Suv,
        TemplateKind::Pickup => BodyKind::Pickup,
        TemplateKind::Pedestrian => BodyKind::Walker,
        TemplateKind::Bike => BodyKind::Cyclist,
        _ => return None,
    });
    let [low, high] = mesh.bounds()?;
    let (center, size_m): (DVec3, DVec3) = ((low + high) / 2.0, high - low);
    // People and riders fill only a small part of their boxes.
    let denser = if kind.class() == Class::MotorVehicle { 1.0 } else { 0.85 };
    let spacing_m = denser * TemplateOptions::default().spacing_m(size_m);
    let surface = surface(&mesh, spacing_m);
    let position = |p: &SurfacePoint| (p.position_m - center).as_vec3().to_array();
    let retained = poisson_thin(surface.iter().map(position), spacing_m);
    let class = kind.class();
    let point = |i: usize| Point::new(position(&surface[i]), surface[i].rgb, class as u8);
    let points: Vec<Point> = retained.into_iter().map(point).collect();
    let bounds = Bounds::of(&points)?;
    let (size, xxh3) = (size_m.to_array(), Checksum::of(&points));
    Some((Template { kind, class, size, points: points.len(), bounds, xxh3 }, points))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_fill_their_boxes_and_match_the_core_defaults() {
        let templates = templates();
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
        assert!(templates == point_skeleton::skeleton::default_templates());
    }
}
