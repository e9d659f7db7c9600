use glam::Vec3;

use super::*;
use crate::mesh::{Skin, Surface};
use crate::model::BodyKind;

const GREY: Skin = Skin::new([128; 3], Surface::Plaster);
const LIDAR_Z: f64 = 1.9;

/// Returns a ground of 400 m and a wall whose face is at x = 30.
fn ground_and_wall() -> Mesh {
    let mut mesh = Mesh::default();
    mesh.block(DVec3::new(-200.0, -200.0, -1.0), DVec3::new(200.0, 200.0, 0.0), GREY);
    mesh.block(DVec3::new(30.0, -200.0, 0.0), DVec3::new(31.0, 200.0, 50.0), GREY);
    mesh
}

fn stationary(pose: Pose) -> Motion {
    Motion { poses: vec![pose], travelled_m: vec![0.0] }
}

fn rig() -> Pose {
    Pose::from_yaw(0.0, DVec3::Z * LIDAR_Z)
}

fn points(sweep: &[SweepPoint]) -> impl Iterator<Item = DVec3> {
    sweep.iter().map(|p| Vec3::from(p.position).as_dvec3())
}

#[test]
fn beams_have_expected_angles_and_count() {
    for (beams, hz, lowest, highest) in [(32, 10.0, -30.67, 10.67), (64, 20.0, -24.9, 2.0_f64)] {
        let lidar = Lidar::new(beams, hz);
        // A box all around: every beam hits.
        let mut room = Mesh::default();
        room.block(DVec3::splat(-50.0), DVec3::splat(50.0), GREY);
        let scanner = Scanner::new(&[room], &BTreeMap::new());
        // Off its middle, so that no beam runs along an edge.
        let shift = DVec3::new(1.3, 2.7, 0.4);
        let town_from_lidar = |_| Pose::from_yaw(0.0, shift);
        let sweep = scanner.sweep(&Turn { lidar, end_s: 0.0, town_from_lidar, movers: &[], seed: None });
        assert_eq!(sweep.len(), usize::from(beams) * if hz > 15.0 { 1080 } else { 1800 });
        for (point, at) in sweep.iter().zip(points(&sweep)) {
            // On a side of the box, up to rounding of the stored values.
            assert!(((at + shift).abs().max_element() - 50.0).abs() < 1e-5);
            let elevation = at.z.atan2(at.truncate().length()).to_degrees();
            let share = f64::from(point.ring) / f64::from(beams - 1);
            assert!((elevation - (lowest + (highest - lowest) * share)).abs() < 1e-4);
        }
        // Clockwise from behind, evenly spaced.
        let azimuth = |i: usize| {
            let at = points(&sweep[i * usize::from(beams)..]).next().unwrap();
            at.y.atan2(at.x)
        };
        let step = TAU / lidar.columns as f64;
        assert!((azimuth(0) - (PI - step)).abs() < 1e-6);
        assert!((azimuth(lidar.columns / 4 - 1) - PI / 2.0).abs() < 1e-6);
        assert!((azimuth(lidar.columns / 2 - 1)).abs() < 1e-6);
    }
}

#[test]
fn points_lie_on_the_ground_and_on_the_wall() {
    let scanner = Scanner::new(&[ground_and_wall()], &BTreeMap::new());
    let turn = |seed| Turn {
        lidar: Lidar::new(32, 10.0),
        end_s: 0.0,
        town_from_lidar: |_| rig(),
        movers: &[],
        seed,
    };
    let exact = scanner.sweep(&turn(None));
    let (mut ground, mut wall) = (0, 0);
    for at in points(&exact) {
        let (off_ground, off_wall) = ((at.z + LIDAR_Z).abs(), (at.x - 30.0).abs());
        assert!(off_ground.min(off_wall) < 1e-4, "{at}");
        ground += usize::from(off_ground < 1e-4);
        wall += usize::from(off_wall < 1e-4);
        assert!(at.length() <= RANGE_M[1] + 1e-3);
    }
    assert!(ground > 20_000 && wall > 5_000, "{ground} {wall}");
    // The forward column hits the wall at the expected heights.
    let level = exact.iter().filter(|p| p.position[1].abs() < 1e-3 && (p.position[0] - 30.0).abs() < 1e-3);
    let heights: Vec<f32> = level.map(|p| p.position[2]).collect();
    // From the lowest beam that clears the ground to the highest.
    let rings = (0..32).map(|r| (-30.67 + 41.34 * f64::from(r) / 31.0).to_radians().tan() * 30.0);
    let expected: Vec<f64> = rings.filter(|z| *z > -LIDAR_Z).collect();
    assert_eq!(heights.len(), expected.len());
    assert!(heights.iter().zip(&expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-3));
    // Noise drops the expected share of beams and depends on the seed.
    let noisy = scanner.sweep(&turn(Some(4)));
    let share = noisy.len() as f64 / exact.len() as f64;
    assert!((share - (1.0 - echo::LOST)).abs() < 0.004, "{share}");
    assert!(noisy != scanner.sweep(&turn(Some(5))));
}

/// The ego drives and turns during the rotation: points still lie on the wall, in the LiDAR's final frame.
#[test]
fn sweeps_are_motion_compensated() {
    let scanner = Scanner::new(&[ground_and_wall()], &BTreeMap::new());
    let town_from_lidar = |t_s: f64| Pose::from_yaw(0.8 * t_s, DVec3::new(15.0 * t_s, 0.4 * t_s, LIDAR_Z));
    let end_s = 0.7;
    let turn = Turn { lidar: Lidar::new(32, 10.0), end_s, town_from_lidar, movers: &[], seed: None };
    let sweep = scanner.sweep(&turn);
    let mut wall = 0;
    for at in points(&sweep) {
        let town = town_from_lidar(end_s).transform_point(at);
        assert!(town.z.abs().min((town.x - 30.0).abs()) < 1e-4, "{town}");
        wall += usize::from(town.z > 0.1);
    }
    assert!(wall > 5_000, "{wall}");
    // The first column was fired 1.5 m farther back, so it is not on the ray from the LiDAR's final position.
    let first = points(&sweep).next().unwrap();
    let step = TAU / 1800.0;
    assert!((first.y.atan2(first.x) - (PI - step)).abs() > 0.01);
}

#[test]
fn actors_move_while_the_lidar_turns() {
    let body = Body { kind: BodyKind::Sedan, seed: 1 };
    let size = DVec3::new(4.0, 2.0, 1.5);
    let mut block = Mesh::default();
    block.block(DVec3::new(-2.0, -1.0, 0.0), DVec3::new(2.0, 1.0, size.z), GREY);
    let bodies = BTreeMap::from([((body, 0), block)]);
    let scanner = Scanner::new(&[], &bodies);
    let scan = |motion: &Motion, end_s| {
        let movers = [Mover { body, limbs: 0, motion }];
        let lidar = Lidar::new(64, 10.0);
        scanner.sweep(&Turn { lidar, end_s, town_from_lidar: |_| rig(), movers: &movers, seed: None })
    };
    // A static body: all points lie on its sides.
    let still = stationary(Pose::from_yaw(0.3, DVec3::new(10.0, 6.0, 0.0)));
    let seen = scan(&still, 0.0);
    assert!(seen.len() > 500, "{}", seen.len());
    for at in points(&seen) {
        let local = still.poses[0].inverse().transform_point(at + DVec3::Z * LIDAR_Z);
        let off = (local - DVec3::Z * size.z / 2.0).abs() - size / 2.0;
        assert!(off.max_element().abs() < 1e-5, "{local}");
    }
    // It drives along y in front of the LiDAR at 20 m/s: the face at x = 9 stays, and the column at azimuth a
    // is fired when the rotation is at (PI - a) / TAU.
    let drives = |t: f64| Pose::from_yaw(0.0, DVec3::new(10.0 + 1.0, -1.0 + 20.0 * t, 0.0));
    let steps = 0..=20;
    let motion = Motion {
        poses: steps.clone().map(|i| drives(0.1 * f64::from(i))).collect(),
        travelled_m: steps.map(|i| 2.0 * f64::from(i)).collect(),
    };
    let seen = scan(&motion, 0.1);
    assert!(seen.len() > 500);
    for at in points(&seen) {
        let t = 0.1 * (PI - at.y.atan2(at.x)) / TAU;
        let local = drives(t).inverse().transform_point(at + DVec3::Z * LIDAR_Z);
        let off = (local - DVec3::Z * size.z / 2.0).abs() - size / 2.0;
        assert!(off.max_element().abs() < 1e-4, "{local}");
    }
    // A static wall hides it completely.
    let mut wall = Mesh::default();
    wall.block(DVec3::new(5.0, -50.0, 0.0), DVec3::new(6.0, 50.0, 50.0), GREY);
    let movers = [Mover { body, limbs: 0, motion: &still }];
    let scanner = Scanner::new(&[wall], &bodies);
    let lidar = Lidar::new(64, 10.0);
    let seen =
        scanner.sweep(&Turn { lidar, end_s: 0.0, town_from_lidar: |_| rig(), movers: &movers, seed: None });
    assert!(!seen.is_empty() && points(&seen).all(|at| at.x < 6.01));
}

#[test]
fn sweeps_do_not_depend_on_threads() {
    let scanner = Scanner::new(&[ground_and_wall()], &BTreeMap::new());
    let turn = || Turn {
        lidar: Lidar::new(32, 20.0),
        end_s: 0.0,
        town_from_lidar: |_| rig(),
        movers: &[],
        seed: Some(1),
    };
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scanner.sweep(&turn()))
    };
    assert_eq!(with(1), with(3));
}
