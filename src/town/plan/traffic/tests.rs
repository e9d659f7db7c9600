use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::*;
use crate::town::model::BodyKind;
use crate::town::plan::line::{Path, contains};
use crate::town::plan::{JunctionEdge, KERB_M, Side};

const SECONDS: f64 = 20.0;
/// Length and width of the ego, and from its rear axle to its middle, metres.
const EGO: [f64; 3] = [5.176, 2.297, 1.461];

fn towns() -> impl Iterator<Item = (u64, Network, Traffic, usize)> {
    (0..8).map(|seed| {
        let network = Network::new(seed);
        let (traffic, dropped) = Traffic::draw(&network, seed, SECONDS);
        (seed, network, traffic, dropped)
    })
}

/// Corners of a box on the ground, counter-clockwise.
fn corners(pose: &Pose, [length, width]: [f64; 2], ahead: f64) -> [DVec2; 4] {
    [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(x, y)| {
        pose.transform_point(DVec3::new(ahead + x * length / 2.0, y * width / 2.0, 0.0)).truncate()
    })
}

/// Whether the outlines of two boxes cross, or one lies within the other.
fn meet(a: &[DVec2; 4], b: &[DVec2; 4]) -> bool {
    let side = |p: DVec2, q: DVec2, r: DVec2| (q - p).perp_dot(r - p) > 0.0;
    let cross = (0..4).any(|i| {
        (0..4).any(|k| {
            let ([p, q], [r, s]) = ([a[i], a[(i + 1) % 4]], [b[k], b[(k + 1) % 4]]);
            side(p, q, r) != side(p, q, s) && side(r, s, p) != side(r, s, q)
        })
    });
    cross || contains(a, b[0]) || contains(b, a[0])
}

fn is_vehicle(actor: &Actor) -> bool {
    !matches!(actor.body.kind, BodyKind::Walker | BodyKind::Cone)
}

#[test]
fn nobody_meets_anybody() {
    let (mut all, mut taken_away) = (0, 0);
    for (seed, _, traffic, dropped) in towns() {
        (all, taken_away) = (all + traffic.actors.len() + dropped, taken_away + dropped);
        eprintln!("{seed}: {} dropped {dropped}", traffic.actors.len());
        for step in 0..=(SECONDS * 10.0) as usize {
            let t_s = step as f64 / 10.0;
            let mut boxes = vec![("ego", corners(&traffic.ego.pose(t_s), [EGO[0], EGO[1]], EGO[2]))];
            for actor in &traffic.actors {
                let size = actor.body.size_m();
                boxes.push((&actor.id, corners(&actor.motion.pose(t_s), [size.x, size.y], 0.0)));
            }
            for (i, (name, one)) in boxes.iter().enumerate() {
                for (other_name, other) in &boxes[i + 1..] {
                    let near = one[0].distance(other[0]) < 30.0;
                    assert!(!near || !meet(one, other), "{seed} {t_s} {name} {other_name}");
                }
            }
        }
    }
    assert!(all > 8 * 60, "{all}");
    assert!((taken_away as f64) < 0.03 * all as f64, "{taken_away} of {all}");
}
