use glam::DVec3;
use rayon::prelude::*;
use rstar::RTree;
use rustc_hash::FxHashMap;

use super::cluster::Cluster;
use super::instance::Instance;
use super::thin::{neighbourhood, poisson_thin};
use super::{ClusterReport, TemplateCloud, TemplateKind, TemplateOptions, TemplateSummary};
use crate::cloud::{Bounds, Point};
use crate::dataset::Class;
use crate::files::Checksum;
use crate::skeleton::Template;

/// Superimposes the members of a kind's clusters in their mean box. Returns no cloud if that gives too few
/// points.
pub(super) fn aggregate(
    kind: TemplateKind,
    clusters: &[Cluster],
    instances: &[Instance],
    options: &TemplateOptions,
) -> (TemplateSummary, Option<TemplateCloud>) {
    let members: Vec<&Instance> =
        clusters.iter().flat_map(|c| c.members.iter().map(|i| &instances[*i])).collect();
    let size_m = members.iter().map(|m| m.size_m).sum::<DVec3>() / members.len().max(1) as f64;
    let mirror = kind.class() == Class::MotorVehicle;
    let mut spacing_m = options.spacing_m(size_m);
    let each: Vec<Vec<Point>> = members.iter().map(|m| in_box(m, size_m, kind, mirror)).collect();
    let all: usize = each.iter().map(Vec::len).sum();
    let laid = agreed(&each, spacing_m, options);
    let ranked = without_outliers(&laid, mirror, spacing_m, options);
    let mut points = thinned(&ranked, mirror, spacing_m);
    while points.len() > options.max_points {
        spacing_m *= 1.2;
        points = thinned(&ranked, mirror, spacing_m);
    }
    let bounds = Bounds::of(&points);
    let summary = TemplateSummary {
        kind,
        clusters: clusters.iter().map(|c| cluster_report(c, instances, true)).collect(),
        instances: members.len(),
        points_in: members.iter().map(|m| m.points_in).sum(),
        outliers: laid.len() - ranked.len(),
        not_agreed: all - laid.len(),
        points: points.len(),
        spacing_m,
        size: size_m.to_array(),
        bounds,
    };
    let enough = bounds.filter(|_| points.len() >= options.min_points);
    let cloud = enough.map(|bounds| {
        let (class, size) = (kind.class(), size_m.to_array());
        let xxh3 = Checksum::of(&points);
        (Template { kind, class, size, points: points.len(), bounds, xxh3 }, points)
    });
    (summary, cloud)
}

/// Returns the report on a cluster.
pub(super) fn cluster_report(cluster: &Cluster, instances: &[Instance], used: bool) -> ClusterReport {
    let members = || cluster.members.iter().map(|i| &instances[*i]);
    ClusterReport {
        used,
        size: cluster.size_m.to_array(),
        members: members().map(|m| m.name.clone()).collect(),
        points_in: members().map(|m| m.points_in).sum(),
    }
}

/// Scales an actor's points along each axis to a box; mirrored kinds have their right side reflected to the
/// left.
fn in_box(actor: &Instance, size_m: DVec3, kind: TemplateKind, mirror: bool) -> Vec<Point> {
    let scale = size_m / actor.size_m;
    let place = |point: &Point| {
        let mut local = DVec3::from(point.position.map(f64::from)) * scale;
        if mirror {
            local.y = local.y.abs();
        }
        Point::new(local.as_vec3().to_array(), point.rgb(), kind.class() as u8)
    };
    actor.points.iter().map(place).collect()
}

/// Minimum share of a template's target points for an actor to count as well observed.
const SEEN_WELL: f64 = 0.05;

/// Returns all actors' points. With enough well-observed actors, points without points of another actor
/// nearby are dropped.
fn agreed(actors: &[Vec<Point>], spacing_m: f64, options: &TemplateOptions) -> Vec<Point> {
    let well = SEEN_WELL * options.target_points as f64;
    let seen_well = actors.iter().filter(|points| points.len() as f64 >= well).count();
    if options.agree_from_actors.is_none_or(|from| seen_well < from) {
        return actors.concat();
    }
    // For each cell: the first actor in it, and the first other actor.
    let mut cells: FxHashMap<[i32; 3], (usize, Option<usize>)> = FxHashMap::default();
    let side_m = options.neighbour_spacings * spacing_m;
    let cell = |p: &Point| p.position.map(|v| (f64::from(v) / side_m).floor() as i32);
    for (actor, points) in actors.iter().enumerate() {
        for point in points {
            let (first, other) = cells.entry(cell(point)).or_insert((actor, None));
            if *first != actor {
                other.get_or_insert(actor);
            }
        }
    }
    let has_other = |actor: usize, cell: &[i32; 3]| {
        cells.get(cell).is_some_and(|(first, other)| *first != actor || other.is_some())
    };
    let near_others = |actor: usize, p: &Point| neighbourhood(cell(p)).any(|c| has_other(actor, &c));
    let retained = |(actor, points): (usize, &Vec<Point>)| -> Vec<Point> {
        points.iter().filter(|p| near_others(actor, p)).copied().collect()
    };
    actors.iter().enumerate().flat_map(retained).collect()
}

/// Returns the points with enough near neighbors, densest first: among diverging surfaces, the one shared by
/// most actors wins. If all points are sparse, the distance limit is twice the median neighbor distance.
fn without_outliers(points: &[Point], mirror: bool, spacing_m: f64, options: &TemplateOptions) -> Vec<Point> {
    let distances = neighbour_distances_m(points, mirror, options.neighbours);
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    let usual_m = sorted.get(sorted.len() / 2).copied().unwrap_or_default();
    let near_m = (options.neighbour_spacings * spacing_m).max(2.0 * usual_m);
    let mut ranked: Vec<(f64, &Point)> =
        distances.into_iter().zip(points).filter(|(d, _)| d.is_finite() && *d <= near_m).collect();
    // A stable sort, so points of equal density keep their order.
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    ranked.into_iter().map(|(_, point)| *point).collect()
}

/// Returns the distance of each point to its `count`-th neighbor, meters; infinite if there are fewer.
fn neighbour_distances_m(points: &[Point], mirror: bool, count: usize) -> Vec<f64> {
    let mut rows: Vec<[f32; 3]> = points.iter().map(|p| p.position).collect();
    if mirror {
        let reflected: Vec<[f32; 3]> = rows.iter().map(|[x, y, z]| [*x, -y, *z]).collect();
        rows.extend(reflected);
    }
    let tree = RTree::bulk_load(rows);
    // The nearest result is the point itself.
    let distance = |p: &Point| {
        let mut near = tree.nearest_neighbor_iter_with_distance_2(p.position);
        near.nth(count).map_or(f64::INFINITY, |(_, squared_m)| f64::from(squared_m).sqrt())
    };
    points.par_iter().map(distance).collect()
}

/// Thins to an even density. Mirrored kinds get their other side back: points within half the spacing of the
/// center plane are moved onto it, so that no two are too near.
fn thinned(ranked: &[Point], mirror: bool, spacing_m: f64) -> Vec<Point> {
    let in_middle = |p: &Point| mirror && f64::from(p.position[1]) < spacing_m / 2.0;
    let place = |p: &Point| {
        let [x, y, z] = p.position;
        [x, if in_middle(p) { 0.0 } else { y }, z]
    };
    let retained = poisson_thin(ranked.iter().map(place), spacing_m);
    let half: Vec<Point> =
        retained.iter().map(|i| Point { position: place(&ranked[*i]), ..ranked[*i] }).collect();
    let reflected = |p: &Point| {
        let [x, y, z] = p.position;
        (mirror && y != 0.0).then_some(Point { position: [x, -y, z], ..*p })
    };
    half.iter().copied().chain(half.iter().filter_map(reflected)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Instances;
    use super::*;
    use crate::skeleton::Asset;

    /// Returns the points on the left, right, front, back and top of a box, and its asset.
    fn shell(track: &str, category: &str, size: [f64; 3], step_m: f64) -> (Asset, Vec<Point>) {
        let mut points = Vec::new();
        let steps = size.map(|s| (s / step_m) as i32);
        let at = |axis: usize, i: i32| (size[axis] * (f64::from(i) / f64::from(steps[axis]) - 0.5)) as f32;
        for x in 0..=steps[0] {
            for y in 0..=steps[1] {
                for z in 0..=steps[2] {
                    let outside = [(x, steps[0]), (y, steps[1])].iter().any(|(i, n)| *i == 0 || i == n);
                    if outside || z == steps[2] {
                        points.push(Point::new([at(0, x), at(1, y), at(2, z)], [9; 3], 1));
                    }
                }
            }
        }
        let asset = Asset {
            log: "log".into(),
            track: track.into(),
            category: category.into(),
            class: Class::from_category(category),
            size,
            sweeps: 1,
            points: points.len(),
            bounds: Bounds::of(&points).unwrap(),
            xxh3: Checksum::of(&points),
        };
        (asset, points)
    }

    fn made(
        assets: &[(Asset, Vec<Point>)],
        options: TemplateOptions,
    ) -> (Vec<TemplateCloud>, TemplateSummary) {
        let mut instances = Instances::new(options);
        let assets: Vec<(&Asset, &[Point])> = assets.iter().map(|(a, p)| (a, p.as_slice())).collect();
        instances.add(&assets);
        let (templates, report) = instances.templates();
        (templates, report.templates.into_iter().next().unwrap())
    }

    /// Returns the distance of a point to the surface of a centered box, meters.
    fn off_shell(p: &Point, size: [f64; 3]) -> f64 {
        let over: Vec<f64> = (0..3).map(|a| f64::from(p.position[a]).abs() - size[a] / 2.0).collect();
        over.iter().copied().fold(f64::NEG_INFINITY, f64::max).abs()
    }

    #[test]
    fn boxes_of_several_sizes_become_one_even_mirrored_box() {
        let (sizes, step) = ([[4.4, 1.8, 1.4], [4.8, 1.9, 1.5], [4.6, 1.85, 1.6]], 0.05);
        let mut assets: Vec<_> = sizes.iter().map(|s| shell("a", "vehicle.car", *s, step)).collect();
        // Only the left side of the second one was observed.
        assets[1].1.retain(|p| p.position[1] > 0.0);
        let (templates, summary) = made(&assets, TemplateOptions::default());
        let [(template, points)] = templates.as_slice() else { panic!("one template") };
        assert_eq!((template.kind, summary.instances), (TemplateKind::Sedan, 3));
        for axis in 0..3 {
            let mean = sizes.iter().map(|s| s[axis]).sum::<f64>() / 3.0;
            assert!((template.size[axis] - mean).abs() < 1e-12);
        }
        let moved = summary.spacing_m / 2.0;
        assert!(points.iter().all(|p| off_shell(p, template.size) < moved), "on the surface of the mean box");
        let positions: Vec<[f32; 3]> = points.iter().map(|p| p.position).collect();
        let mut mirrored: Vec<[f32; 3]> = positions.iter().map(|[x, y, z]| [*x, -y, *z]).collect();
        let mut sorted = positions.clone();
        let order = |a: &[f32; 3], b: &[f32; 3]| a.partial_cmp(b).unwrap();
        sorted.sort_by(order);
        mirrored.sort_by(order);
        assert_eq!(sorted, mirrored);
        // Thinning again retains all points: none are closer than the spacing.
        let rounding = 1.0 - 1e-6;
        assert_eq!(poisson_thin(positions, summary.spacing_m * rounding).len(), points.len());
        assert!((5_000..=50_000).contains(&points.len()), "{}", points.len());
        assert!(points.iter().all(|p| p.class() == 1));
    }

    #[test]
    fn only_outliers_are_removed() {
        let (asset, mut points) = shell("a", "human.pedestrian.adult", [0.7, 0.7, 1.75], 0.02);
        let surface = points.len();
        let outlier = |i: i32| [-0.2 + 0.1 * i as f32, 0.0, 0.05 * i as f32];
        points.extend((0..5).map(|i| Point::new(outlier(i), [0; 3], 2)));
        let options = TemplateOptions::default();
        let (templates, summary) = made(&[(asset.clone(), points)], options);
        assert_eq!(summary.outliers, 5);
        assert!(templates[0].1.iter().all(|p| off_shell(p, asset.size) < 1e-6));
        assert_eq!((summary.points, summary.points_in), (templates[0].1.len(), surface + 5));
    }

    #[test]
    fn features_of_a_single_actor_are_dropped_if_there_are_enough_actors() {
        let ladder = |i: i32| Point::new([0.01 * i as f32, 0.3, 1.2], [0; 3], 1);
        let cars = |count: usize| {
            let mut cars: Vec<_> =
                (0..count).map(|_| shell("a", "vehicle.car", [4.6, 1.9, 1.5], 0.05)).collect();
            cars[0].1.extend((0..100).map(ladder));
            cars
        };
        let high = |(_, points): &TemplateCloud| points.iter().filter(|p| p.position[2] > 1.0).count();
        let (few, summary) = made(&cars(3), TemplateOptions { neighbours: 2, ..TemplateOptions::default() });
        assert!(high(&few[0]) > 20 && summary.not_agreed == 0);
        let (enough, summary) =
            made(&cars(4), TemplateOptions { neighbours: 2, ..TemplateOptions::default() });
        assert_eq!(high(&enough[0]), 0);
        // Thinned to about 4 cm the ladder of 1 m has some 25 points.
        assert!((20..=40).contains(&summary.not_agreed), "{}", summary.not_agreed);
        assert_eq!(summary.outliers, 0);
    }

    #[test]
    fn pedestrians_are_not_mirrored_and_few_points_give_no_template() {
        let (asset, mut points) = shell("a", "pedestrian", [0.7, 0.7, 1.75], 0.02);
        points.retain(|p| p.position[1] > 0.0);
        let (templates, _) = made(&[(asset.clone(), points.clone())], TemplateOptions::default());
        assert!(templates[0].1.iter().all(|p| p.position[1] > 0.0));
        let (none, summary) = made(&[(asset, points[..900].to_vec())], TemplateOptions::default());
        assert!(none.is_empty() && summary.points == 0);
    }

    #[test]
    fn trucks_use_only_the_cluster_with_the_most_actors() {
        let (long, lone, tiny) = ([9.0, 2.5, 3.2], [12.0, 2.6, 3.8], [5.5, 2.0, 1.9]);
        let sizes = [lone, long, long, tiny, tiny, tiny];
        let mut trucks: Vec<_> = sizes.map(|size| shell("a", "vehicle.truck", size, 0.06)).into();
        // The long ones have fewer points than the lone one, the tiny ones hardly any.
        trucks[1..3].iter_mut().for_each(|truck| truck.1.truncate(6000));
        trucks[3..].iter_mut().for_each(|truck| truck.1.truncate(200));
        let (templates, summary) = made(&trucks, TemplateOptions::default());
        assert_eq!((templates[0].0.size, summary.instances), (long, 2));
        let reported: Vec<_> = summary.clusters.iter().map(|c| (c.used, c.size, c.members.len())).collect();
        assert_eq!(reported[..2], [(true, long, 2), (false, lone, 1)]);
        assert_eq!((reported[2].0, reported[2].2), (false, 3));
        // Cars of two sizes are merged.
        let cars = [[3.6, 1.6, 1.4], [4.8, 1.9, 1.5]].map(|size| shell("a", "vehicle.car", size, 0.06));
        let (templates, summary) = made(&cars, TemplateOptions::default());
        assert_eq!((summary.clusters.len(), summary.instances), (2, 2));
        assert!((templates[0].0.size[0] - 4.2).abs() < 1e-12);
    }

    #[test]
    fn points_stay_below_the_maximum() {
        let (asset, points) = shell("a", "vehicle.bus.rigid", [12.0, 2.5, 3.0], 0.06);
        let options = TemplateOptions { max_points: 3000, ..TemplateOptions::default() };
        let (templates, summary) = made(&[(asset, points)], options);
        assert!((1500..=3000).contains(&templates[0].1.len()) && summary.spacing_m > 0.1);
        assert_eq!(templates[0].0.kind, TemplateKind::Bus);
    }
}
