use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use crate::geometry::{Camera, CameraError};

/// Mirror parameter of a fisheye camera of KITTI-360, in `image_02.yaml`.
const XI: f64 = 2.213_404_750_785_489;
const K1: f64 = 0.016_798_235_660_113_68;
const K2: f64 = 1.654_877_324_337_352_2;
const GAMMA: [f64; 2] = [1_336.322_082_584_997_1, 1_335.788_335_001_295_8];
const CENTER: [f64; 2] = [716.943_235_101_263_2, 705.764_983_082_215_8];

fn kitti_360() -> Camera {
    let projection = [GAMMA[0], GAMMA[1], CENTER[0], CENTER[1]];
    Camera::fisheye_mei("image_02", 1400, 1400, XI, [K1, K2, 0.0, 0.0], projection).unwrap()
}

/// Returns an f-theta camera of HD size with a forward polynomial.
fn f_theta(forward_px: [f64; 6]) -> Result<Camera, CameraError> {
    let mut calibration = [0.0; 14];
    calibration[..2].copy_from_slice(&[960.0, 540.0]);
    calibration[2..8].copy_from_slice(&forward_px);
    Camera::f_theta("front", 1920, 1080, calibration)
}

/// 120 degrees across.
const FORWARD_PX: [f64; 6] = [0.0, 900.0, 5.0, -30.0, 2.0, 0.0];

/// Returns the unit vector at an angle to the axis, in a direction of the image.
fn ray(angle: f64, direction: f64) -> DVec3 {
    (DVec2::from_angle(direction) * angle.sin()).extend(angle.cos())
}

/// Returns rays up to an angle, in all directions, with length 0.3 to 80.
fn rays(up_to: f64) -> impl Iterator<Item = DVec3> {
    let all = (0..=200).flat_map(move |i| (0..40).map(move |k| (f64::from(i) / 200.0 * up_to, f64::from(k))));
    all.map(|(angle, k)| ray(angle, 0.16 * k) * (0.3 + 2.0 * k))
}

/// Largest distances of a round trip: of the pixel, and of the unit ray.
fn round_trip(camera: &Camera, up_to: f64) -> (f64, f64) {
    let projection = camera.projection();
    rays(up_to).fold((0.0_f64, 0.0_f64), |(px, off), ray| {
        let pixel = projection.pixel(ray).unwrap();
        let back = projection.ray(pixel).unwrap();
        let again = projection.pixel(back).unwrap();
        (px.max(again.distance(pixel)), off.max(back.normalize().distance(ray.normalize())))
    })
}

#[test]
fn rays_return_from_the_image() {
    for (camera, degrees) in [
        (kitti_360(), 116.0),
        (f_theta(FORWARD_PX).unwrap(), 179.9),
        (f_theta([0.4, 900.0, 5.0, -30.0, 2.0, 0.0]).unwrap(), 170.0),
        (kitti_360().resized(500, 1000), 110.0),
        (Camera::fisheye_mei("c", 100, 100, 1.0, [0.0; 4], [200.0, 200.0, 50.0, 50.0]).unwrap(), 179.0),
        (
            Camera::fisheye_mei("c", 100, 100, 0.7, [-0.02, 0.0, 0.0, 0.0], [90.0, 91.0, 5.0, 5.0]).unwrap(),
            100.0,
        ),
    ] {
        let (px, off) = round_trip(&camera, f64::to_radians(degrees));
        // Rays near the limit of a mirror parameter above 1 touch its sphere, where a rounding error grows.
        assert!(px < 1e-8 && off < 1e-9, "{}: {px} px, {off}", camera.name);
    }
}

/// The image of a sphere's outline is a circle, as is that of rays at 90 degrees.
#[test]
fn pixels_inside_the_circle_of_a_fisheye_show_rays() {
    let projection = kitti_360().projection();
    let radius = |m: f64| m * (1.0 + K1 * m.powi(2) + K2 * m.powi(4));
    let (outline, beside) = (radius(1.0 / (XI * XI - 1.0).sqrt()), radius(1.0 / XI));
    let [mut shown, mut behind] = [0; 2];
    for (x, y) in (0..1400).step_by(20).flat_map(|x| (0..1400).step_by(20).map(move |y| (x, y))) {
        let pixel = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let across = pixel - DVec2::from(CENTER);
        let from_axis = (across / DVec2::from(GAMMA)).length();
        let ray = projection.ray(pixel);
        assert_eq!(ray.is_some(), from_axis < outline, "{pixel}");
        let Some(ray) = ray else { continue };
        assert!(projection.pixel(ray).unwrap().distance(pixel) < 1e-9, "{pixel}");
        assert_eq!(ray.z < 0.0, from_axis > beside, "{pixel}");
        (shown, behind) = (shown + 1, behind + i32::from(ray.z < 0.0));
    }
    assert!(shown > 4000 && shown < 4900 && behind > 900, "{shown} {behind}");
}

/// The formulas of the models, as their calibrations state them.
#[test]
fn pixels_follow_the_formulas() {
    let (fisheye, wide) = (kitti_360().projection(), f_theta(FORWARD_PX).unwrap().projection());
    for ray in rays(1.9) {
        let n = ray / ray.length();
        let (x, y) = (n.x / (n.z + XI), n.y / (n.z + XI));
        let r2 = x * x + y * y;
        let stretch = 1.0 + K1 * r2 + K2 * r2 * r2;
        let [u, v] = [GAMMA[0] * x * stretch, GAMMA[1] * y * stretch];
        let expected = DVec2::new(u + CENTER[0], v + CENTER[1]);
        assert!(fisheye.pixel(ray).unwrap().distance(expected) < 1e-9, "{ray}");

        let t = n.z.acos();
        let radius = 900.0 * t + 5.0 * t.powi(2) - 30.0 * t.powi(3) + 2.0 * t.powi(4);
        let expected = DVec2::new(960.0, 540.0) + radius * n.truncate().normalize_or_zero();
        assert!(wide.pixel(ray).unwrap().distance(expected) < 1e-6, "{ray}");
    }
}

#[test]
fn lenses_are_pinholes_near_the_axis() {
    for camera in [kitti_360(), f_theta(FORWARD_PX).unwrap(), f_theta(FORWARD_PX).unwrap().resized(300, 200)]
    {
        let pinhole = Camera { lens: None, ..camera.clone() }.projection();
        let off = |angle| {
            let pixels = [&camera.projection(), &pinhole].map(|p| p.pixel(ray(angle, 0.7)).unwrap());
            pixels[0].distance(pixels[1])
        };
        // The f-theta polynomial has a square term: 5 pixels by the square of the angle.
        assert!(off(0.0) < 1e-9 && off(1e-3) < 1e-5 && off(0.5) > 1.0, "{}", off(1e-3));
    }
}

#[test]
fn resizing_scales_pixels() {
    for camera in [kitti_360(), f_theta(FORWARD_PX).unwrap()] {
        let scale = DVec2::new(224.0 / f64::from(camera.width), 96.0 / f64::from(camera.height));
        let (full, small) = (camera.projection(), camera.resized(96, 224).projection());
        for ray in rays(1.8) {
            let [full, small] = [&full, &small].map(|projection| projection.pixel(ray).unwrap());
            assert!((full * scale).distance(small) < 1e-9);
        }
    }
}

#[test]
fn rays_beyond_the_lens_have_no_pixel() {
    // The sphere ends at cos(angle) = -1 / xi.
    let fisheye = kitti_360().projection();
    let limit = (-1.0_f64 / XI).acos();
    assert!((fisheye.lens().unwrap().max_angle() - limit).abs() < 1e-6);
    assert!(fisheye.pixel(ray(limit - 1e-6, 1.0)).is_some());
    assert_eq!([limit + 1e-6, 2.5, PI].map(|angle| fisheye.pixel(ray(angle, 1.0))), [None; 3]);
    // The radius of the image there, and beyond.
    let reach = fisheye.pixel(ray(limit - 1e-7, 0.0)).unwrap();
    assert_eq!([1e-3, 100.0, f64::NAN].map(|more| fisheye.ray(reach + DVec2::X * more)), [None; 3]);

    // 1 + 3 k1 m² = 0 at m = 1: 90 degrees for xi = 1.
    let narrow = Camera::fisheye_mei("c", 9, 9, 1.0, [-1.0 / 3.0, 0.0, 0.0, 0.0], [9.0, 9.0, 4.0, 4.0]);
    assert!((narrow.unwrap().projection().lens().unwrap().max_angle() - PI / 2.0).abs() < 1e-6);

    // 900 - 300 t² = 0.
    let wide = f_theta([0.0, 900.0, 0.0, -100.0, 0.0, 0.0]).unwrap().projection();
    let limit = 3.0_f64.sqrt();
    assert!((wide.lens().unwrap().max_angle() - limit).abs() < 1e-9);
    assert!(wide.pixel(ray(limit - 1e-6, 2.0)).is_some());
    assert_eq!([limit + 1e-6, PI].map(|angle| wide.pixel(ray(angle, 2.0))), [None; 2]);
    let reach = 960.0 + 600.0 * limit;
    assert!(wide.ray(DVec2::new(reach - 1e-3, 540.0)).is_some());
    assert_eq!(wide.ray(DVec2::new(reach + 1e-3, 540.0)), None);
    assert_eq!([DVec3::ZERO, DVec3::NAN].map(|ray| [&fisheye, &wide].map(|p| p.pixel(ray))), [[None; 2]; 2]);
}

#[test]
fn wrong_calibrations_are_refused() {
    let mei = |xi, k1, p2, gamma| {
        Camera::fisheye_mei("c", 9, 9, xi, [k1, 0.0, 0.0, p2], [gamma, 9.0, 4.0, 4.0]).unwrap_err()
    };
    assert_eq!(mei(-0.1, 0.0, 0.0, 9.0), CameraError::MirrorParameter(-0.1));
    let infinite = CameraError::NotFinite(f64::INFINITY);
    assert_eq!(mei(f64::INFINITY, 0.0, 0.0, 9.0), infinite);
    assert_eq!(mei(1.0, f64::INFINITY, 0.0, 9.0), infinite);
    assert_eq!(mei(1.0, 0.0, f64::INFINITY, 9.0), infinite);
    assert_eq!(mei(1.0, 0.0, 0.0, f64::INFINITY), infinite);
    assert!(matches!(mei(1.0, 0.0, 0.0, 0.0), CameraError::Singular { .. }));
    assert!(matches!(mei(1.0, 0.0, 0.0, -5.0), CameraError::Singular { .. }));

    let message = |forward_px| f_theta(forward_px).unwrap_err().to_string();
    let expected = "expected an f-theta polynomial that begins with up to 1 pixels and grows, found the \
        coefficients 0.0 and -1.0";
    assert_eq!(message([0.0, -1.0, 0.0, 0.0, 0.0, 0.0]), expected);
    assert!(message([1.1, 900.0, 0.0, 0.0, 0.0, 0.0]).ends_with("the coefficients 1.1 and 900.0"));
    assert!(message([0.0, 0.0, 9.0, 0.0, 0.0, 0.0]).ends_with("the coefficients 0.0 and 0.0"));
    assert_eq!(message([0.0, 900.0, 0.0, 0.0, f64::INFINITY, 0.0]), infinite.to_string());
    let backward =
        Camera::f_theta("c", 9, 9, std::array::from_fn(|i| if i == 13 { f64::INFINITY } else { 1.0 }));
    assert_eq!(backward.unwrap_err(), infinite);
}
