use glam::{DVec2, DVec3, Vec3};

use super::cells::Cells;
use super::ground::{self, GROUND_M};
use super::kerbside::furniture;
use super::lots::{Lot, frontages, lots};
use super::occupancy::Occupancy;
use super::street_strips::StreetStrips;
use super::style::Style;
use super::{house, kerbside, middle, paint, static_meshes};
use crate::mesh::{Mesh, Surface};
use crate::plan::{Actor, JunctionEdge, KERB_M, Motion, Network, Plan, Traffic};

const SEEDS: [u64; 6] = [0, 1, 2, 7, 8, 41];

fn plan(seed: u64) -> Plan {
    let traffic = Traffic {
        ego: Motion { poses: vec![point_skeleton::geometry::Pose::IDENTITY], travelled_m: vec![0.0] },
        actors: Vec::<Actor>::new(),
    };
    Plan { network: Network::new(seed), traffic }
}

/// Returns the distance from a segment, and the position of the nearest point on its line: 0 at its start, 1
/// at its end.
fn off(place: DVec2, a: DVec2, b: DVec2) -> (f64, f64) {
    let share = (place - a).dot(b - a) / (b - a).length_squared();
    (place.distance(a.lerp(b, share.clamp(0.0, 1.0))), share)
}

/// Returns the distance of a position beyond the kerb of the nearest road beside it, negative on the road,
/// and the width of the sidewalk there.
fn beyond_kerb(network: &Network, place: DVec2) -> Option<[f64; 2]> {
    let beside = network.roads.iter().flat_map(|road| {
        let last = road.centerline.len() - 2;
        let offs = road.centerline.windows(2).map(move |p| off(place, p[0], p[1])).enumerate();
        // Excludes positions beyond the road's ends.
        let offs = offs.filter(move |(i, (_, at))| (*at >= 0.0 || *i > 0) && (*at <= 1.0 || *i < last));
        offs.map(|(_, (off, _))| [off - road.half_width_m, road.sidewalk_m])
    });
    beside.min_by(|a, b| a[0].total_cmp(&b[0]))
}

fn in_polygon(place: DVec2, polygon: &[DVec2]) -> bool {
    let crosses = |i: &usize| {
        let (a, b) = (polygon[*i], polygon[(i + 1) % polygon.len()]);
        (a.y > place.y) != (b.y > place.y) && place.x < a.x + (b.x - a.x) * (place.y - a.y) / (b.y - a.y)
    };
    (0..polygon.len()).filter(crosses).count() % 2 == 1
}

fn in_junction(network: &Network, place: DVec2) -> bool {
    network.junctions.iter().any(|junction| in_polygon(place, &junction.outline))
}

/// Returns the distance from the nearest kerb of a junction.
fn off_junction_kerbs(network: &Network, place: DVec2) -> f64 {
    let kerbs = network.junctions.iter().flat_map(|junction| {
        let outline = &junction.outline;
        let kerbs = (0..outline.len()).filter(|i| junction.edges[*i] == JunctionEdge::Kerb);
        kerbs.map(|i| off(place, outline[i], outline[(i + 1) % outline.len()]).0)
    });
    kerbs.fold(f64::INFINITY, f64::min)
}

fn built_lots(network: &Network, seed: u64) -> Vec<Lot> {
    let (strips, style) = (StreetStrips::new(network), Style::new(seed));
    let mut occupancy = Occupancy::new(strips.areas(0.0));
    lots(&frontages(&strips), middle(network), &style, &mut occupancy)
}

/// Returns sample positions across a house's footprint, including its corners.
fn samples(lot: &Lot) -> impl Iterator<Item = DVec2> + '_ {
    let at = |i: i32, j: i32| lot.size_m * DVec2::new(f64::from(i), f64::from(j)) / 12.0;
    (0..=12).flat_map(move |i| (0..=12).map(move |j| lot.place.point(at(i, j))))
}

#[test]
fn houses_do_not_overlap_streets_or_houses() {
    for seed in SEEDS {
        let network = Network::new(seed);
        let lots = built_lots(&network, seed);
        assert!(lots.len() > 20, "{} houses, seed {seed}", lots.len());
        let narrowest = network.roads.iter().map(|road| road.sidewalk_m).fold(f64::INFINITY, f64::min);
        for (i, lot) in lots.iter().enumerate() {
            for place in samples(lot) {
                if let Some([off, sidewalk_m]) = beyond_kerb(&network, place) {
                    // Thinning of the roads' lines costs a few centimeters.
                    assert!(off > sidewalk_m - 0.05, "{off} from the kerb at {place}, seed {seed}");
                }
                assert!(!in_junction(&network, place), "{place}, seed {seed}");
                let off = off_junction_kerbs(&network, place);
                assert!(off > narrowest - 0.05, "{off} from a junction at {place}, seed {seed}");
            }
            for other in &lots[i + 1..] {
                if lot.place.at.distance(other.place.at) < 90.0 {
                    let inner = other.area(DVec2::splat(0.03), other.size_m - 0.03);
                    assert!(!samples(lot).any(|p| in_polygon(p, &inner)), "seed {seed}: {lot:?} {other:?}");
                }
            }
        }
    }
}

#[test]
fn houses_have_fronts_and_few_triangles() {
    for seed in SEEDS {
        let (network, style) = (Network::new(seed), Style::new(seed));
        let lots = built_lots(&network, seed);
        let mut triangles = 0;
        for lot in &lots {
            let mesh = house::house(lot, &style);
            triangles += mesh.triangles.len();
            let [low, high] = mesh.bounds().unwrap();
            // Awnings and eaves extend over the sidewalk, walls do not.
            assert!(
                low.x > -1.2 && high.x < lot.size_m.x + 1.2 && high.y < lot.size_m.y + 1.0,
                "{low} {high}"
            );
            assert!(low.y > -lot.setback_m - 1.4 && high.z < 60.0 && high.z > 3.0, "{low} {high}");
            let has = |surface: Surface| mesh.vertices.iter().any(|v| v.surface & 255 == surface as u32);
            assert!(has(Surface::Window));
        }
        let mean = triangles / lots.len();
        assert!((80..=600).contains(&mean), "{mean} triangles a house, seed {seed}");
    }
}

#[test]
fn street_furniture_avoids_roads_and_crossings() {
    for seed in SEEDS {
        let network = Network::new(seed);
        let (strips, style) = (StreetStrips::new(&network), Style::new(seed));
        let mut cells = Cells::default();
        kerbside::furnish(&network, &frontages(&strips), &style, middle(&network), &mut cells);
        let meshes = cells.into_meshes();
        let mut feet = 0;
        for vertex in meshes.iter().flat_map(|mesh| &mesh.vertices) {
            let at = Vec3::from(vertex.position).as_dvec3();
            // Only the heights that cars occupy.
            if at.z > KERB_M + 0.05 && at.z < 2.2 {
                feet += 1;
                let place = at.truncate();
                assert!(!in_junction(&network, place), "{at}, seed {seed}");
                let [off, sidewalk_m] = beyond_kerb(&network, place).unwrap();
                assert!(off > 0.02 && off < sidewalk_m, "{off} from the kerb at {at}, seed {seed}");
                let crossing = network.crossings.iter().find(|crossing| in_polygon(place, &crossing.outline));
                assert!(crossing.is_none(), "{at}, seed {seed}");
            }
        }
        assert!(feet > 1000, "{feet}, seed {seed}");
    }
}

#[test]
fn posts_leave_the_outer_sidewalk_free() {
    let style = Style::new(3);
    let metal = crate::mesh::Skin::new(style.metal, Surface::Metal);
    for thing in [
        furniture::lamp(0, metal),
        furniture::lamp(1, metal),
        furniture::signal(Some(5.0), metal),
        furniture::sign(furniture::Sign::Stop, metal),
        furniture::hydrant(),
        furniture::bin(metal),
    ] {
        let upright = thing.vertices.iter().filter(|v| v.position[2] < 2.0);
        let reach = upright.map(|v| f64::from(v.position[1])).fold(0.0, f64::max);
        assert!(kerbside::POST_M + reach < 0.75, "{reach}");
    }
}

/// Returns the height of the highest horizontal surface at a position.
fn top(meshes: &[Mesh], place: DVec2) -> Option<f64> {
    let mut top: Option<f64> = None;
    for mesh in meshes {
        let near = mesh.bounds().is_some_and(|[low, high]| {
            place.cmpge(low.truncate()).all() && place.cmple(high.truncate()).all()
        });
        for triangle in mesh.triangles.iter().filter(|_| near) {
            let corners = triangle.map(|i| Vec3::from(mesh.vertices[i as usize].position).as_dvec3());
            let side = |i: usize| {
                let (a, b) = (corners[i].truncate(), corners[(i + 1) % 3].truncate());
                (b - a).perp_dot(place - a)
            };
            if (0..3).all(|i| side(i) >= 0.0) && corners.iter().all(|p| p.z == corners[0].z) {
                top = Some(top.map_or(corners[0].z, |z: f64| z.max(corners[0].z)));
            }
        }
    }
    top
}

#[test]
fn ground_is_closed_at_correct_heights() {
    for seed in [0, 7] {
        let network = Network::new(seed);
        let strips = StreetStrips::new(&network);
        let mut cells = Cells::default();
        ground::ground(&strips, &Style::new(seed), &mut cells);
        let meshes = cells.into_meshes();
        let mut seen = [0; 3];
        let middle = middle(&network);
        for i in 0..1500 {
            let draw = |k: i64| point_skeleton::hash::between(seed, &[i, k], -220.0, 220.0);
            let place = middle + DVec2::new(draw(0), draw(1));
            let kerb = beyond_kerb(&network, place);
            let junction_off = off_junction_kerbs(&network, place);
            // Close to an edge, either height is correct.
            let clear = |off: f64| off.abs() > 0.1;
            let expected = match kerb {
                _ if !clear(junction_off) => continue,
                _ if in_junction(&network, place) => 0,
                Some([off, _]) if off < -0.1 => 0,
                Some([off, sidewalk_m]) if off > 0.1 && off < sidewalk_m - 0.1 => 1,
                Some([off, sidewalk_m]) if off < sidewalk_m + 0.1 => continue,
                _ if junction_off < 5.0 => continue,
                _ => 2,
            };
            let found = top(&meshes, place).expect("ground everywhere");
            let heights = [0.0, KERB_M, GROUND_M].map(|z| f64::from(z as f32));
            assert_eq!(found, heights[expected], "{place}, seed {seed}");
            seen[expected] += 1;
        }
        assert!(seen.iter().all(|count| *count > 30), "{seen:?}");
    }
}

#[test]
fn paint_is_on_roads() {
    for seed in SEEDS {
        let network = Network::new(seed);
        let mut cells = Cells::default();
        paint::paint(&StreetStrips::new(&network), &Style::new(seed), &mut cells);
        let mut painted = 0;
        for vertex in cells.into_meshes().iter().flat_map(|mesh| &mesh.vertices) {
            let at = Vec3::from(vertex.position).as_dvec3();
            assert!(at.z > 0.0 && at.z < 0.01);
            let off = beyond_kerb(&network, at.truncate()).map_or(f64::INFINITY, |[off, _]| off);
            assert!(off < 0.05 || in_junction(&network, at.truncate()), "{at}, {off} beyond, seed {seed}");
            painted += usize::from(vertex.surface & 255 == Surface::Paint as u32);
        }
        assert!(painted > 1000, "{painted}, seed {seed}");
    }
}

#[test]
fn static_meshes_are_valid() {
    for seed in SEEDS {
        let meshes = static_meshes(&plan(seed), seed);
        let mut triangles = 0;
        for mesh in &meshes {
            let [low, high] = mesh.bounds().unwrap();
            let size = high - low;
            assert!(size.x < 72.0 && size.y < 72.0, "{size}");
            for vertex in &mesh.vertices {
                let floats = vertex.position.iter().chain(&vertex.normal).chain(&vertex.uv);
                assert!(floats.copied().all(f32::is_finite));
                assert!((Vec3::from(vertex.normal).length() - 1.0).abs() < 1e-3, "{vertex:?}");
                assert!(vertex.rgba[3] == 255 && vertex.surface & 255 <= Surface::Cloth as u32);
            }
            triangles += mesh.triangles.len();
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|i| Vec3::from(mesh.vertices[i as usize].position).as_dvec3());
                let out: DVec3 =
                    triangle.iter().map(|i| Vec3::from(mesh.vertices[*i as usize].normal).as_dvec3()).sum();
                let normal = (b - a).cross(c - a);
                // f32 positions a few hundred meters from the origin are slightly rounded.
                if normal.length() > 1e-3 {
                    assert!(normal.dot(out) > 0.0, "{a} {b} {c}: {out}");
                }
            }
        }
        assert!((10_000..600_000).contains(&triangles), "{triangles}, seed {seed}");
    }
}

#[test]
fn seed_determines_the_town() {
    let (a, b, other) = (static_meshes(&plan(7), 7), static_meshes(&plan(7), 7), static_meshes(&plan(7), 8));
    assert_eq!(a, b);
    let colors = |meshes: &[Mesh]| {
        let mut count = std::collections::BTreeMap::<[u8; 3], usize>::new();
        for vertex in meshes.iter().flat_map(|mesh| &mesh.vertices) {
            *count.entry([vertex.rgba[0] >> 4, vertex.rgba[1] >> 4, vertex.rgba[2] >> 4]).or_default() += 1;
        }
        count
    };
    // Overlap of two color histograms, as a share of 1.
    let (a, other) = (colors(&a), colors(&other));
    let shared: usize = a.iter().map(|(color, n)| *n.min(other.get(color).unwrap_or(&0))).sum();
    let share = shared as f64 / a.values().sum::<usize>() as f64;
    assert!(share < 0.8, "{share} of the colors are the same");
}
