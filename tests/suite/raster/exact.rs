//! Cases whose result can be computed by hand; all rasterizers must return it.

use glam::{DAffine3, DVec2, DVec3};
use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, Crop, MapKind, MapSet, Rasterizer, Segment, SplatJob, SplatMaps, draw_lines,
};

use pskel_testing::devices::{Case, Division, rasterizers, with_compute_device, with_device};

fn point(position: [f32; 3]) -> Point {
    Point::new(position, [1, 2, 3], 0)
}

/// Returns the pixels `(column, row)` that are not empty.
fn covered(maps: &SplatMaps) -> Vec<(u32, u32)> {
    let at = |i: usize| (i as u32 % maps.width, i as u32 / maps.width);
    (0..maps.point.len()).filter(|i| maps.point[*i] > 0).map(at).collect()
}

#[test]
fn a_point_covers_exactly_its_square() {
    let case = Case::new(9, 7, "4:2,8:1,16:0", &[&[point([4.5 * 2.0, 3.0 * 2.0, 2.0])]]);
    let maps = case.draw(MapSet::SPLATTED);
    let square: Vec<_> = (1..=5).flat_map(|y| (2..=6).map(move |x| (x, y))).collect();
    assert_eq!(covered(&maps), square);
    let inside = (3 * 9 + 4) as usize;
    assert_eq!((maps.depth_m[inside], maps.instance[inside]), (2.0, 10));
    assert_eq!(maps.rgb_class[inside], u32::from_le_bytes([1, 2, 3, 0]));
    assert_eq!((maps.depth_m[0], maps.rgb_class[0], maps.instance[0]), (f32::INFINITY, 0, 0));
}

#[test]
fn squares_of_points_outside_the_image_are_drawn() {
    // Centers at (-2, 8) and (7, -1) around a 6x7 image, radius 2 and 1.
    let case = Case::new(6, 7, "2:2,4:1", &[&[point([-2.0, 8.0, 1.0]), point([6.5 * 4.0, -4.0, 4.0])]]);
    assert_eq!(covered(&case.draw(MapSet::SPLATTED)), [(5, 0), (0, 6)]);
    let out = Case::new(6, 7, "2:2", &[&[point([-3.0, 3.0, 1.0]), point([3.0, 9.0, 1.0])]]);
    assert_eq!(covered(&out.draw(MapSet::SPLATTED)), []);
}

#[test]
fn the_smallest_index_wins_ties_and_the_nearest_wins_otherwise() {
    let (near, far) = (point([2.0, 2.0, 2.0]), point([3.0, 3.0, 3.0]));
    let case = Case::new(3, 3, "9:1", &[&[far, near, near], &[near]]);
    let maps = case.draw(MapSet::SPLATTED);
    assert!(maps.point.iter().all(|p| *p == 2) && maps.instance.iter().all(|i| *i == 10));
    // Point numbers are counted through all instances.
    let maps = Case::new(3, 3, "9:1", &[&[far, far], &[far, near]]).draw(MapSet::SPLATTED);
    assert!(maps.point.iter().all(|p| *p == 4) && maps.instance.iter().all(|i| *i == 11));
    // A point that is one `f32` step nearer wins.
    let z = 50.0_f32;
    let nearer = point([z, z, z.next_down()]);
    let maps = Case::new(3, 3, "60:1", &[&[point([z, z, z]), nearer]]).draw(MapSet::SPLATTED);
    assert_eq!((maps.point[4], maps.depth_m[4]), (2, z.next_down()));
}

#[test]
fn depths_outside_of_the_schedule_are_dropped() {
    let at = |z: f32| point([z, z, z]);
    let dropped = [-1.0, 0.0, 1e-6, 1e-5, 100.001, 1e9, f32::NAN, f32::INFINITY];
    for z in dropped {
        assert_eq!(covered(&Case::new(3, 3, "15:1,100:0", &[&[at(z)]]).draw(MapSet::SPLATTED)), [], "{z}");
    }
    for (z, pixels) in [(1.1e-5, 9), (15.0, 9), (15.001, 1), (100.0, 1)] {
        let maps = Case::new(3, 3, "15:1,100:0", &[&[at(z)]]).draw(MapSet::SPLATTED);
        assert_eq!((covered(&maps).len(), maps.depth_m[4]), (pixels, z));
    }
}

#[test]
fn the_crop_is_a_square_with_its_border() {
    let points: Vec<Point> = (0..8).map(|i| point([i as f32, 0.0, 1.0])).collect();
    let case = Case::new(8, 1, "9:0", &[&points]);
    let crop = Some(Crop { center: DVec2::new(1004.0, 2000.0), radius_m: 2.0 });
    let mut instance = case.instances[0];
    instance.world_from_local = DAffine3::from_translation(DVec3::new(1000.0, 2000.0, 0.0));
    let mut view = case.view.clone();
    view.camera_from_world = instance.world_from_local.inverse();
    let (schedule, instances, maps) = (&case.schedule, &[instance][..], MapSet::SPLATTED);
    let job = SplatJob { view: &view, schedule, instances, crop, maps };
    let expected = [(2, 0), (3, 0), (4, 0), (5, 0), (6, 0)];
    assert_eq!(covered(&ReferenceRasterizer::new(vec![(&points).into()]).splat(&job).unwrap()), expected);
    with_device(|device| {
        for mut rasterizer in rasterizers(&device, &vec![(&points).into()], Division::default()) {
            assert_eq!(covered(&rasterizer.splat(&job).unwrap()), expected);
        }
    });
}

/// Many points of one pixel draw the largest squares. The first of the nearest points wins its whole square,
/// and so does a point that is nearer by one `f32` step.
#[test]
fn many_points_in_one_pixel_have_one_winner() {
    let at = |x: f32, y: f32, z: f32| point([(x + 0.5) * z, (y + 0.5) * z, z]);
    let mut points = vec![at(40.0, 35.0, 2.0); 20_000];
    points[0] = at(40.0, 35.0, 2.0_f32.next_up());
    points.push(at(70.0, 35.0, 2.0_f32.next_down()));
    let case = Case::new(100, 90, "9:31", &[&points]);
    let maps = case.draw(MapSet::SPLATTED);
    let pixel = |x: usize, y: usize| maps.point[y * 100 + x];
    assert_eq!([pixel(9, 4), pixel(38, 66), pixel(9, 67), pixel(8, 4)], [2, 2, 0, 0]);
    assert_eq!([pixel(39, 35), pixel(70, 4), pixel(99, 66), pixel(99, 67)], [20_001, 20_001, 20_001, 0]);
    assert_eq!(covered(&maps).len(), 63 * 91);
    with_compute_device(|device| {
        let clouds: CloudSet<'_> = case.clouds.iter().map(Cloud::from).collect();
        let spread = |mut rasterizer: Box<dyn Rasterizer + '_>| {
            let (view, schedule, instances) = (&case.view, &case.schedule, case.instances.as_slice());
            rasterizer
                .splat(&SplatJob { view, schedule, instances, crop: None, maps: MapSet::SPLATTED })
                .unwrap();
            let stages = rasterizer.take_stages().0;
            (rasterizer.info().rasterizer, stages.contains_key("spread"))
        };
        let found: Vec<_> =
            rasterizers(&device, &clouds, Division::default()).into_iter().map(spread).collect();
        let cpu = ("cpu", false);
        assert_eq!(found, [("graphics", false), cpu, cpu, ("compute", true), ("compute", true)]);
    });
}

#[test]
fn unwanted_maps_are_empty() {
    let case = Case::new(4, 4, "9:1", &[&[point([1.0, 1.0, 1.0])]]);
    for bits in 0..16_u32 {
        let bit = |i: u32| bits >> i & 1 == 1;
        let kinds = [MapKind::Point, MapKind::Depth, MapKind::Color, MapKind::Instance];
        let kinds = (0..).zip(kinds).filter(|(i, _)| bit(*i));
        let maps = case.draw(kinds.fold(MapSet::NONE, |maps, (_, kind)| maps.with(kind)));
        let lengths = [maps.point.len(), maps.depth_m.len(), maps.rgb_class.len(), maps.instance.len()];
        assert_eq!(lengths, [0, 1, 2, 3].map(|i| if bit(i) { 16 } else { 0 }));
    }
}

#[test]
fn no_points_give_empty_maps() {
    assert_eq!(covered(&Case::new(4, 4, "9:1", &[]).draw(MapSet::SPLATTED)), []);
    assert_eq!(covered(&Case::new(4, 4, "9:1", &[&[]]).draw(MapSet::SPLATTED)), []);
}

#[test]
fn a_line_covers_pixels_whose_centers_are_inside() {
    let line = |y: f32| Segment { from: [2.0, y], to: [6.0, y], rgb: [9, 8, 7] };
    let rows =
        |image: &[[u8; 3]]| -> Vec<usize> { (0..8).filter(|row| image[row * 8 + 3] == [9, 8, 7]).collect() };
    let draw = |segments: &[Segment]| draw_lines(segments, ImageSize { height: 8, width: 8 }, 2.0);
    let image = draw(&[line(4.0)]);
    assert_eq!(rows(&image), [3, 4]);
    assert_eq!(image.iter().filter(|p| **p != [0; 3]).count(), 8);
    // Pixel centers on one edge are inside, on the other edge outside.
    assert_eq!(rows(&draw(&[line(4.5)])), [3, 4]);
    // Later lines cover earlier ones; line ends are butt caps.
    let over = Segment { from: [3.0, 0.0], to: [3.0, 8.0], rgb: [1, 1, 1] };
    let image = draw(&[line(4.0), over]);
    assert_eq!([1, 2, 3, 4, 5, 6].map(|x| image[4 * 8 + x][0]), [0, 1, 1, 9, 9, 0]);
    assert!(draw(&[]).iter().all(|p| *p == [0; 3]));
}
