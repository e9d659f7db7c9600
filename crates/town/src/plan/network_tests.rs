use glam::DVec2;

use super::line::{contains, curvature, polyline};
use super::*;

/// All stations of a path.
const WHOLE: std::ops::Range<f64> = f64::NEG_INFINITY..f64::INFINITY;

fn networks() -> impl Iterator<Item = (u64, Network)> {
    (0..20).map(|seed| (seed, Network::new(seed)))
}

fn last_direction(line: &[DVec2]) -> DVec2 {
    (line[line.len() - 1] - line[line.len() - 2]).normalize()
}

#[test]
fn junction_outlines_are_star_shaped_and_meet_roads() {
    for (seed, network) in networks() {
        for (index, junction) in network.junctions.iter().enumerate() {
            let n = junction.outline.len();
            assert_eq!(n, junction.edges.len());
            for i in 0..n {
                let [a, b] = [junction.outline[i], junction.outline[(i + 1) % n]];
                assert!((a - junction.centre).perp_dot(b - junction.centre) > 0.0, "{seed} {index} {i}");
                let JunctionEdge::Road(road) = junction.edges[i] else { continue };
                let road = &network.roads[road];
                let [left, right] = Side::BOTH.map(|side| road.kerb(side));
                // Seen from the junction, the right kerb is on the right at a road's start, on the left at
                // its end.
                let wanted = if road.junctions[0] == index {
                    [right[0], left[0]]
                } else {
                    [left[left.len() - 1], right[right.len() - 1]]
                };
                assert!(a.distance(wanted[0]) < 1e-9 && b.distance(wanted[1]) < 1e-9, "{seed} {index} {i}");
            }
            let roads = network.roads.iter().filter(|r| r.junctions.contains(&index)).count();
            assert_eq!(junction.roads().len(), roads, "{seed} {index}");
            let kerbs: usize = junction.kerbs().iter().map(|kerb| kerb.len() - 1).sum();
            assert_eq!(kerbs + roads, n, "{seed} {index}");
        }
    }
}

#[test]
fn roads_and_junctions_do_not_overlap() {
    for (seed, network) in networks() {
        let outlines: Vec<Vec<DVec2>> = network.roads.iter().map(Road::outline).collect();
        let areas: Vec<&Vec<DVec2>> =
            outlines.iter().chain(network.junctions.iter().map(|j| &j.outline)).collect();
        for (i, area) in areas.iter().enumerate() {
            for (j, other) in areas.iter().enumerate().filter(|(j, _)| *j != i) {
                // A road's end is also an edge of a junction, so shared points are neither inside nor
                // outside.
                let centre = other.iter().sum::<DVec2>() / other.len() as f64;
                let inside = other.iter().map(|p| *p + (centre - *p).normalize() * 1e-3);
                let inside = inside.filter(|p| contains(other, *p));
                assert!(inside.clone().count() > other.len() / 3, "{seed} {j}");
                assert_eq!(inside.filter(|p| contains(area, *p)).count(), 0, "{seed} {i} {j}");
            }
        }
    }
}

#[test]
fn lanes_continue_their_predecessors() {
    for (seed, network) in networks() {
        let mut ids: Vec<&str> = network.lanes.iter().map(|lane| lane.id.as_str()).collect();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), network.lanes.len());
        for lane in &network.lanes {
            let sharpest = curvature(&lane.centerline).iter().fold(0.0, |most: f64, k| most.max(k.abs()));
            assert!(sharpest < 1.0 / 4.5, "{seed} {} {sharpest}", lane.id);
            let steps = lane.centerline.windows(2).map(|p| p[0].distance(p[1]));
            assert!(steps.clone().all(|s| (0.1..1.6).contains(&s)), "{seed} {}", lane.id);
            let (end, ahead) = (lane.centerline.last().unwrap(), last_direction(&lane.centerline));
            for next in lane.successors.iter().map(|i| &network.lanes[*i]) {
                assert!(end.distance(next.centerline[0]) < 1e-3, "{seed} {} {}", lane.id, next.id);
                let on = (next.centerline[1] - next.centerline[0]).normalize();
                assert!(ahead.angle_to(on).abs() < 2.0_f64.to_radians(), "{seed} {} {}", lane.id, next.id);
            }
            let LaneKind::Road(road) = lane.kind else {
                assert_eq!(lane.successors.len(), 1);
                continue;
            };
            let road = &network.roads[road];
            let forward = end.distance(*road.centerline.last().unwrap()) < end.distance(road.centerline[0]);
            let junction = road.junctions[usize::from(forward)];
            let alone = network.junctions[junction].roads().len() == 1;
            assert_eq!(lane.successors.is_empty(), alone, "{seed} {}", lane.id);
        }
    }
}

#[test]
fn traffic_keeps_to_the_right() {
    for (_, network) in networks() {
        for index in 0..network.roads.len() {
            let road = &network.roads[index];
            let middle = polyline(&road.centerline);
            let [forward, back] = network.lanes_of(index);
            assert_eq!([forward.len(), back.len()], [road.lanes_each_way; 2]);
            for (lanes, along) in [(forward, 1.0), (back, -1.0)] {
                for (k, lane) in lanes.iter().enumerate() {
                    let line = &network.lanes[*lane].centerline;
                    let p = line[line.len() / 2];
                    let projection = middle.project(p, WHOLE);
                    let wanted = -along * (k as f64 + 0.5) * road.lane_width_m;
                    assert!((projection.offset_m - wanted).abs() < 0.02, "{projection:?} {wanted}");
                    let ahead = line[line.len() / 2 + 1] - p;
                    assert!(middle.at(projection.station_m).1.dot(ahead) * along > 0.0);
                }
            }
        }
    }
}

#[test]
fn crossings_and_stop_lines_precede_junctions() {
    for (seed, network) in networks() {
        for crossing in &network.crossings {
            let road = &network.roads[crossing.road];
            for corner in crossing.outline {
                let projection = polyline(&road.centerline).project(corner, WHOLE);
                assert!(
                    (projection.offset_m.abs() - road.half_width_m).abs() < 1e-6,
                    "{seed} {projection:?}"
                );
            }
            let [a, b, c, _] = crossing.outline;
            assert!((b - a).perp_dot(c - b) > 0.0 && (a.distance(b) - 3.0).abs() < 1e-9);
        }
        assert!(network.stop_lines.len() >= network.crossings.len());
        for (ends, lane) in &network.stop_lines {
            let lane = &network.lanes[*lane];
            let path = polyline(&lane.centerline);
            for (end, side) in ends.iter().zip([1.0, -1.0]) {
                let projection = path.project(*end, WHOLE);
                assert!((path.length_m() - projection.station_m - 6.7).abs() < 1e-6, "{seed} {projection:?}");
                assert!(
                    (projection.offset_m.abs() - lane.width_m / 2.0).abs() < 1e-6,
                    "{seed} {projection:?} {side}"
                );
            }
        }
    }
}

#[test]
fn conflicting_lights_are_never_both_green() {
    let (_, network) = networks().next().unwrap();
    let mut seen = [0; 3];
    for (index, junction) in network.junctions.iter().enumerate() {
        for t in 0..200 {
            let t_s = f64::from(t) * 0.3;
            let roads = junction.roads();
            let signals: Vec<_> = roads.iter().map(|road| network.signal_at(index, *road, t_s)).collect();
            assert!(signals.iter().all(|s| s.is_some() == (junction.kind == JunctionKind::Signals)));
            for (a, road) in roads.iter().enumerate() {
                let Some(signal) = signals[a] else { continue };
                seen[signal as usize] += 1;
                let [_, direction] = network.roads[*road].mouth(index).unwrap();
                for (b, other) in roads.iter().enumerate() {
                    let [_, across] = network.roads[*other].mouth(index).unwrap();
                    let crossed = direction.perp_dot(across).abs() > 0.9;
                    assert!(!crossed || signal == Signal::Red || signals[b] == Some(Signal::Red));
                }
            }
        }
    }
    assert!(seen.iter().all(|count| *count > 0));
}

#[test]
fn seeds_determine_distinct_networks() {
    let text = |seed: u64| format!("{:?}", Network::new(seed));
    let towns: Vec<String> = (0..20).map(text).collect();
    assert_eq!(towns[3], text(3));
    for (i, town) in towns.iter().enumerate() {
        assert!(towns[..i].iter().all(|other| other != town));
    }
}

#[test]
fn towns_have_bent_streets_and_an_avenue() {
    let bent = networks().filter(|(_, network)| {
        network.roads.iter().any(|road| curvature(&road.centerline).iter().any(|k| k.abs() > 0.008))
    });
    assert_eq!(bent.count(), 20);
    assert!(networks().all(|(_, network)| network.roads.iter().any(|r| r.lanes_each_way == 2)));
}
