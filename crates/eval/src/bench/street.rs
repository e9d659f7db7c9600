//! Benchmark scene: a synthetic street with six cameras.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

use point_skeleton::cloud::Point;
use point_skeleton::files::FileName;
use point_skeleton::geometry::{Camera, View};
use point_skeleton::hash::{between, hash, unit};

/// Half the length of the street, meters.
pub(super) const HALF_LENGTH_M: f64 = 100.0;
/// Name, yaw to the left in degrees and focal length in pixels of each camera in the street.
const CAMERAS: [(&str, f64, f64); 6] = [
    ("CAM_FRONT", 0.0, 1266.0),
    ("CAM_FRONT_RIGHT", -55.0, 1260.0),
    ("CAM_FRONT_LEFT", 55.0, 1272.0),
    ("CAM_BACK", 180.0, 809.0),
    ("CAM_BACK_LEFT", 110.0, 1256.0),
    ("CAM_BACK_RIGHT", -110.0, 1259.0),
];
/// Peak memory of [`street_cloud`] per point, bytes: a sort key and the point.
pub(super) const POINT_BYTES: u64 = 8 + 16;
const WIDTH: u32 = 1600;
const HEIGHT: u32 = 900;
/// Bits of a sort key that hold the point's index; a key of [`Site::cell`] has 18.
const NUMBER_BITS: u32 = 46;

/// Generates the benchmark cloud with any number of points: a street 200 m long in random colors. Three of
/// five points lie on the ground, up to 40 m to both sides and denser towards the middle. The others lie on
/// two wavy rows of facades 7 to 20 m away and up to 15 m high, denser towards the bottom. Points are in
/// Morton order of half-meter cells, as in clouds merged by voxel. Their class is 0.
///
/// The same seed gives the same points for any number of threads. Peak memory is 24 bytes per point,
/// 16 of them for the result.
pub fn street_cloud(points: usize, seed: u64) -> Vec<Point> {
    let key = |number: usize| Site::new(number as u64, seed).cell() << NUMBER_BITS | number as u64;
    let mut order: Vec<u64> = (0..points).into_par_iter().map(key).collect();
    // The number within the key keeps the sort stable.
    order.par_sort_unstable();
    let point = |key: &u64| point(*key & ((1 << NUMBER_BITS) - 1), seed);
    order.par_iter().map(point).collect()
}

/// Returns six cameras with 900x1600 pixels that cover all directions from 1.5 m above the middle of
/// [`street_cloud`].
pub fn street_views() -> Vec<View> {
    CAMERAS.iter().filter_map(|&(name, yaw_deg, focal_px)| view(name, yaw_deg, focal_px)).collect()
}

fn view(name: &str, yaw_deg: f64, focal_px: f64) -> Option<View> {
    let (sin, cos) = (yaw_deg * (PI / 180.0)).sin_cos();
    let (right, down, forward) = (DVec3::new(sin, -cos, 0.0), DVec3::NEG_Z, DVec3::new(cos, sin, 0.0));
    let eye = DVec3::new(1.5 * forward.x, 0.5 * forward.y, 1.5);
    let rotation = DMat3::from_cols(right, down, forward).transpose();
    let (cx, cy) = (f64::from(WIDTH) / 2.0, f64::from(HEIGHT) / 2.0);
    let intrinsics = DMat3::from_cols(DVec3::X * focal_px, DVec3::Y * focal_px, DVec3::new(cx, cy, 1.0));
    let name = FileName::new(name).ok()?;
    Some(View {
        camera: Camera { name, width: WIDTH, height: HEIGHT, intrinsics, lens: None },
        camera_from_world: DAffine3::from_mat3_translation(rotation, -(rotation * eye)),
    })
}

/// Random quantities of a point; each is a separate hash input.
#[derive(Clone, Copy)]
enum Draw {
    X,
    Y,
    Side,
    Z,
    Color,
}

/// Horizontal position of a point, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Site {
    on_ground: bool,
    x_m: f64,
    y_m: f64,
}

impl Site {
    fn new(number: u64, seed: u64) -> Self {
        let draw = |draw: Draw| unit(seed, &[number as i64, draw as i64]);
        let on_ground = number % 5 < 3;
        let x_m = between(seed, &[number as i64, Draw::X as i64], -HALF_LENGTH_M, HALF_LENGTH_M);
        let y_m = if on_ground {
            let t = 2.0 * draw(Draw::Y) - 1.0;
            // |t|^1.5 with the sign of t.
            40.0 * t * t.abs().sqrt()
        } else {
            let side = if draw(Draw::Side) < 0.5 { -1.0 } else { 1.0 };
            side * (12.0 + 3.0 * draw(Draw::Y) + 5.0 * (0.05 * x_m).sin())
        };
        Self { on_ground, x_m, y_m }
    }

    /// Returns the index of the cell in Morton order.
    fn cell(&self) -> u64 {
        let side = |v: f64| spread(((v + 128.0) * 2.0) as u16);
        side(self.x_m) | side(self.y_m) << 1
    }
}

/// Inserts a zero before every bit.
fn spread(value: u16) -> u64 {
    [(8, 0x00ff_00ff), (4, 0x0f0f_0f0f), (2, 0x3333_3333), (1, 0x5555_5555)]
        .iter()
        .fold(u64::from(value), |bits, (shift, mask)| (bits | bits << shift) & mask)
}

fn point(number: u64, seed: u64) -> Point {
    let site = Site::new(number, seed);
    let u = unit(seed, &[number as i64, Draw::Z as i64]);
    let z_m = if site.on_ground { 0.05 * u } else { 15.0 * u.powf(1.7) };
    let [r, g, b, ..] = hash(seed, &[number as i64, Draw::Color as i64]).to_le_bytes();
    Point::new([site.x_m as f32, site.y_m as f32, z_m as f32], [r, g, b], 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT: usize = 100_000;

    fn with_threads(threads: usize, seed: u64) -> Vec<Point> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| street_cloud(COUNT, seed))
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
        let one = with_threads(1, 1);
        assert!(one == with_threads(3, 1) && one != with_threads(1, 2));
        assert!(street_cloud(0, 1).is_empty());
    }

    /// Compares with the reference method: a stable sort by interleaved bits.
    #[test]
    fn points_stand_in_morton_order() {
        let cell = |number: &u64| {
            let site = Site::new(*number, 5);
            let [x, y] = [site.x_m, site.y_m].map(|v| ((v + 128.0) * 2.0) as u64);
            (0..16).map(|bit| (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1)).sum::<u64>()
        };
        let mut numbers: Vec<u64> = (0..COUNT as u64).collect();
        numbers.sort_by_key(cell);
        assert!(cell(&numbers[COUNT - 1]) < 1 << (64 - NUMBER_BITS));
        let expected: Vec<Point> = numbers.iter().map(|number| point(*number, 5)).collect();
        assert!(street_cloud(COUNT, 5) == expected);
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
        sum / f64::from(count)
    }

    #[track_caller]
    fn assert_close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() < tolerance, "{found}, expected {expected}");
    }

    #[test]
    fn shares_and_moments_are_those_of_the_distribution() {
        let points = street_cloud(COUNT, 1);
        let position = |p: &Point| p.position.map(f64::from);
        let of = |axis: usize| points.iter().map(move |p| position(p)[axis]);
        let share = |inside: &dyn Fn([f64; 3]) -> bool| {
            points.iter().filter(|p| inside(position(p))).count() as f64 / COUNT as f64
        };
        assert_close(mean(of(0)), 0.0, 1.0);
        assert_close(mean(of(0).map(|x| x * x)), 1e4 / 3.0, 50.0);
        assert_close(mean(of(1)), 0.0, 0.3);
        // On facades u^1.7 * 15 <= 0.05 holds for u <= 300^(-1 / 1.7).
        let low = 300.0_f64.powf(-1.0 / 1.7);
        assert_close(share(&|p| p[2] <= 0.05), 0.6 + 0.4 * low, 0.002);
        assert_close(mean(of(2)), 0.6 * 0.025 + 0.4 * 15.0 / 2.7, 0.05);
        let (ground, facade): (Vec<[f64; 3]>, Vec<_>) =
            points.iter().map(position).partition(|p| p[2] <= 0.05);
        // The mean of 40 |t|^1.5 is 16, and facades are 13.5 m away on average.
        assert_close(
            mean(ground.iter().map(|p| p[1].abs())),
            (0.6 * 16.0 + 0.4 * low * 13.5) / (0.6 + 0.4 * low),
            0.2,
        );
        let wall = |p: &[f64; 3]| p[1].abs() - 5.0 * (0.05 * p[0]).sin();
        assert_close(mean(facade.iter().map(wall)), 13.5, 0.05);
        assert!(facade.iter().all(|p| (11.99..15.01).contains(&wall(p)) && p[2] <= 15.0));
        assert_close(mean(facade.iter().map(|p| p[1].signum())), 0.0, 0.02);
        assert!(ground.iter().all(|p| p[0].abs() <= 100.0 && p[1].abs() <= 40.0 && p[2] >= 0.0));
        assert_close(mean(points.iter().flat_map(Point::rgb).map(f64::from)), 127.5, 0.5);
        assert!(points.iter().all(|p| p.class() == 0));
    }

    /// Compares with values from the script that generates the street for the renderers in the speed
    /// comparison.
    #[test]
    fn cameras_stand_where_the_peers_have_them() {
        let views = street_views();
        let names: Vec<&str> = views.iter().map(|v| v.camera.name.as_str()).collect();
        assert_eq!(names, CAMERAS.map(|c| c.0));
        for (view, (focal, [a, b], [right, forward])) in views.iter().zip(PEERS) {
            let camera = &view.camera;
            assert_eq!((camera.height, camera.width), (900, 1600));
            assert_eq!(camera.rows(), [[focal, 0.0, 800.0], [0.0, focal, 450.0], [0.0, 0.0, 1.0]]);
            let expected =
                [[a, b, 0.0, right], [0.0, 0.0, -1.0, 1.5], [-b, a, 0.0, forward], [0.0, 0.0, 0.0, 1.0]];
            let found = point_skeleton::cloud::cameras::rows(&view.camera_from_world);
            let off = found.as_flattened().iter().zip(expected.as_flattened()).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-15, "{found:?}, expected {expected:?}");
        }
    }

    type Peer = (f64, [f64; 2], [f64; 2]);

    /// Focal length; first row of the rotation; offsets along the first and the third row.
    const PEERS: [Peer; 6] = [
        (1266.0, [0.0, -1.0], [0.0, -1.5]),
        (
            1260.0,
            [-0.819_152_044_288_991_8, -0.573_576_436_351_046_2],
            [0.469_846_310_392_954_27, -0.828_989_928_337_165_8],
        ),
        (
            1272.0,
            [0.819_152_044_288_991_8, -0.573_576_436_351_046_2],
            [-0.469_846_310_392_954_27, -0.828_989_928_337_165_8],
        ),
        (809.0, [1.224_646_799_147_353_2e-16, 1.0], [1.224_646_799_147_353_2e-16, -1.5]),
        (
            1256.0,
            [0.939_692_620_785_908_4, 0.342_020_143_325_668_7],
            [0.321_393_804_843_269_7, -0.616_977_778_440_511],
        ),
        (
            1259.0,
            [-0.939_692_620_785_908_4, 0.342_020_143_325_668_7],
            [-0.321_393_804_843_269_7, -0.616_977_778_440_511],
        ),
    ];
}
