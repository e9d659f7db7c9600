//! Runs the examples.

#[allow(unreachable_pub)] // `run` is public in the example
#[path = "../../examples/splat_cloud.rs"]
mod splat_cloud;

use point_skeleton::RasterizerKind;

#[test]
fn splat_cloud_draws_a_disk_the_same_on_all_rasterizers() {
    let folder = tempfile::tempdir().unwrap();
    let draw = |kind: RasterizerKind| {
        let out = folder.path().join(format!("{kind}.png"));
        splat_cloud::run(kind, &out).unwrap();
        image::open(out).unwrap().into_rgb8()
    };
    let image = draw(RasterizerKind::Cpu);
    for kind in [RasterizerKind::Auto, RasterizerKind::Graphics] {
        assert!(draw(kind) == image, "{kind}");
    }
    // A sphere of radius 1 m at 5 m covers a disk of radius 350 * tan(asin(1/5)) = 71 pixels, grown by the
    // splats.
    for (x, y, pixel) in image.enumerate_pixels() {
        let radius = (f64::from(x) + 0.5 - 200.0).hypot(f64::from(y) + 0.5 - 150.0);
        let empty = pixel.0 == [0; 3];
        assert!(radius < 76.0 || empty, "{x} {y}");
        assert!(radius > 60.0 || !empty, "{x} {y}");
    }
}
