//! Distortion of lenses against OpenCV's.

use glam::{DAffine3, DVec2, DVec3};
use point_skeleton::geometry::{Camera, Distortion, View};
use point_skeleton::skeleton::Projector;

#[derive(serde::Deserialize)]
struct Peers {
    cameras: Vec<PeerCamera>,
}

#[derive(serde::Deserialize)]
struct PeerCamera {
    name: String,
    width: u32,
    height: u32,
    intrinsics: [[f64; 3]; 3],
    distortion: [f64; 5],
    points: Vec<[f64; 3]>,
    pixels: Vec<[f64; 2]>,
}

#[test]
fn projected_points_are_opencvs() {
    const ALLOWED_PX: f64 = 1e-8;
    let peers: Peers = serde_json::from_str(include_str!("../peers/distortion.json")).unwrap();
    for peer in peers.cameras {
        let distortion = Distortion::from_opencv(peer.distortion);
        let camera = Camera::new(&peer.name, peer.width, peer.height, peer.intrinsics).unwrap();
        let camera = Camera { distortion, ..camera };
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        let project = Projector::new(&view, &DAffine3::IDENTITY);
        let size = DVec2::new(f64::from(peer.width), f64::from(peer.height));
        let (mut farthest, mut moved, mut inside) = (0.0_f64, 0.0_f64, 0);
        for (point, pixel) in peer.points.iter().zip(&peer.pixels) {
            let (point, expected) = (DVec3::from(*point), DVec2::from(*pixel));
            let (found, depth_m) = view.project_recorded(point).unwrap();
            assert_eq!(depth_m, point.z);
            farthest = farthest.max(found.distance(expected));
            moved = moved.max(view.project(point).unwrap().0.distance(expected));
            // What colors points agrees, and leaves out what the image does not show.
            let in_image = expected.cmpge(DVec2::ZERO).all() && expected.cmplt(size).all();
            let found = project.pixel(point).map(|(pixel, _)| pixel);
            assert_eq!(found.is_some(), in_image, "{}: {point}", peer.name);
            inside += usize::from(in_image);
            farthest = farthest.max(found.map_or(0.0, |found| found.distance(expected)));
        }
        println!("{}: {farthest:.1e} px off, {moved:.0} px moved, {inside} inside", peer.name);
        assert!(farthest < ALLOWED_PX, "{}: {farthest} px", peer.name);
        assert!(moved > 10.0 && inside > 30, "{}: {moved} px, {inside} inside", peer.name);
    }
}
