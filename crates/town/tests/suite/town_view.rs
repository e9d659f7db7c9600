//! Ground-truth views of the town: maps compared with rays cast in `f64`, color compared with values known by
//! hand.
//!
//! All tests run under the validation layer and fail on any message.

use glam::{DAffine3, DMat3, DQuat, DVec3, EulerRot, Vec3};
use point_skeleton::geometry::{Camera, View};
use point_skeleton::gpu::Device;
use pskel_testing::devices::with_device;
use pskel_town::Daylight;
use pskel_town::mesh::{Mesh, Skin, Surface};
use pskel_town::view::{GroundTruthView, Light, MeshDraw, MeshRenderError, MeshRenderer};

const NEAR_M: f64 = 0.1;

fn plain(grey: u8) -> Skin {
    Skin::new([grey; 3], Surface::Plain)
}

/// Returns a view at `place` along x, turned by yaw, pitch (down) and roll, radians.
fn view([height, width]: [u32; 2], focal: f64, place: DVec3, [yaw, pitch, roll]: [f64; 3]) -> View {
    let rows = [
        [focal, 0.0, 0.47 * f64::from(width)],
        [0.0, 1.04 * focal, 0.55 * f64::from(height)],
        [0.0, 0.0, 1.0],
    ];
    let camera = Camera::new("c", width, height, rows).unwrap();
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    let turn = DMat3::from_quat(DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll));
    let town_from_camera = DAffine3 { matrix3: turn * axes, translation: place };
    View { camera, camera_from_world: town_from_camera.inverse() }
}

fn at(place: DVec3, yaw: f64) -> DAffine3 {
    DAffine3::from_rotation_translation(DQuat::from_rotation_z(yaw), place)
}

/// Returns a scene: a wall, two boxes in front of it, leaning slabs, ground that extends behind the camera, a
/// rail beside it.
fn scene() -> (Vec<Mesh>, Vec<MeshDraw>) {
    let block = |min: [f64; 3], max: [f64; 3], surface| {
        let mut mesh = Mesh::default();
        mesh.block(DVec3::from(min), DVec3::from(max), Skin::new([120, 90, 60], surface));
        mesh
    };
    let wall = block([20.0, -30.0, -1.0], [21.0, 30.0, 12.0], Surface::Brick);
    let car = block([-2.0, -1.0, 0.0], [2.0, 1.0, 1.5], Surface::CarPaint);
    let mut leaning = Mesh::default();
    for i in 0..12 {
        let (x, y) = (6.0 + f64::from(i % 4) * 2.5, -6.0 + 1.1 * f64::from(i));
        let corners = [[0.0, 0.0, 0.2], [0.7, -0.9, 0.4], [1.5, 0.3, 2.5], [0.8, 1.2, 2.3]];
        let skin = Skin { rgb: [80, 140, 60], surface: Surface::Foliage, seed: i as u32 };
        leaning.polygon(&corners.map(|c| DVec3::from(c) + DVec3::new(x, y, 0.0)), skin);
    }
    let ground = block([-80.0, -60.0, -1.0], [120.0, 60.0, 0.0], Surface::Asphalt);
    // Partly nearer than the near plane, so that it is clipped.
    let rail = block([-3.0, -0.5, 1.2], [6.0, -0.45, 1.3], Surface::Metal);
    let draw = |mesh, town_from_mesh, class, instance| MeshDraw { mesh, town_from_mesh, class, instance };
    let draws = vec![
        draw(0, DAffine3::IDENTITY, 1, 0),
        draw(1, at(DVec3::new(9.0, 2.0, 0.0), 0.4), 10, 7),
        draw(1, at(DVec3::new(14.0, -3.0, 0.0), -1.1), 11, 70_000),
        draw(2, DAffine3::IDENTITY, 2, 0),
        draw(3, DAffine3::IDENTITY, 3, 0),
        draw(4, DAffine3::IDENTITY, 4, 9),
        // Behind the camera.
        draw(1, at(DVec3::new(-15.0, 0.0, 0.0), 0.0), 12, 8),
    ];
    (vec![wall, car, leaning, ground, rail], draws)
}

/// All triangles in `f64`, the reference for the images.
struct Rays(Vec<(usize, [DVec3; 3])>);

impl Rays {
    fn new(meshes: &[Mesh], draws: &[MeshDraw]) -> Self {
        let triangles = draws.iter().enumerate().flat_map(|(number, draw)| {
            let mesh = &meshes[draw.mesh];
            mesh.triangles.iter().map(move |t| {
                let corner = |i: u32| Vec3::from(mesh.vertices[i as usize].position).as_dvec3();
                (number, t.map(|i| draw.town_from_mesh.transform_point3(corner(i))))
            })
        });
        Self(triangles.collect())
    }

    /// Returns triangle and length along the ray of the first hit beyond `least` (Möller and Trumbore 1997).
    fn cast(&self, from: DVec3, ray: DVec3, least: f64) -> Option<(usize, f64)> {
        let hit = |(number, (_, [a, b, c])): (usize, &(usize, [DVec3; 3]))| {
            let (ab, ac) = (b - a, c - a);
            let p = ray.cross(ac);
            let scale = 1.0 / ab.dot(p);
            let u = (from - a).dot(p) * scale;
            let q = (from - a).cross(ab);
            let (v, t) = (ray.dot(q) * scale, ac.dot(q) * scale);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > least).then_some((number, t))
        };
        self.0.iter().enumerate().filter_map(hit).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the triangle and camera z that a view shows at an image position.
    fn seen(&self, view: &View, x: f64, y: f64) -> Option<(usize, f64)> {
        let town_from_camera = view.camera_from_world.inverse();
        let ray = town_from_camera.matrix3 * (view.camera.intrinsics.inverse() * DVec3::new(x, y, 1.0));
        self.cast(town_from_camera.translation, ray, NEAR_M)
    }
}

/// Returns the distance from an edge, pixels, within which a device may resolve to the other side: it rounds
/// corners to its sub-pixel steps and clips at the near plane. A hundredth of a pixel with lavapipe's 256
/// steps.
fn hair_px(device: &Device) -> f64 {
    2.56 / f64::from(device.limits().sub_pixel_precision_bits).exp2()
}

/// Compares every pixel farther than `hair_px` from an edge; returns the share of compared pixels.
fn compare(shown: &GroundTruthView, view: &View, (rays, draws): (&Rays, &[MeshDraw]), hair_px: f64) -> f64 {
    let width = view.camera.width as usize;
    let mut compared = 0;
    for (i, depth_m) in shown.depth_m.iter().enumerate() {
        let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let at = |dx: f64, dy: f64| rays.seen(view, x + dx * hair_px, y + dy * hair_px);
        let middle = at(0.0, 0.0);
        let around = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(dx, dy)| at(dx, dy));
        if around.iter().any(|other| other.map(|o| o.0) != middle.map(|m| m.0)) {
            continue;
        }
        compared += 1;
        let draw = middle.map(|(triangle, _)| &draws[rays.0[triangle].0]);
        let truth = draw.map_or((0, 0), |d| (d.class, d.instance));
        assert_eq!((shown.class[i], shown.instance[i]), truth, "{x} {y}");
        let z = middle.map_or(f64::INFINITY, |m| m.1);
        let error = if z.is_finite() { (f64::from(*depth_m) / z - 1.0).abs() } else { 0.0 };
        assert!(error < 1e-7 && depth_m.is_finite() == z.is_finite(), "{x} {y}: {depth_m} for {z}");
    }
    compared as f64 / shown.depth_m.len() as f64
}

#[test]
fn maps_match_ray_casting() {
    let (meshes, draws) = scene();
    let rays = Rays::new(&meshes, &draws);
    let eye = DVec3::new(0.0, -0.4, 1.4);
    let views = [
        view([90, 160], 110.0, eye, [0.0, 0.05, 0.0]),
        view([61, 97], 40.0, eye, [0.3, 0.2, 0.4]),
        view([45, 80], 90.0, eye, [2.9, 0.1, -0.2]),
        view([80, 45], 30.0, DVec3::new(9.0, 6.0, 7.0), [-1.6, 0.7, 0.0]),
        view([50, 50], 400.0, DVec3::new(-60.0, 3.0, 2.0), [0.0, 0.0, 0.1]),
    ];
    with_device(|device| {
        let refs: Vec<&Mesh> = meshes.iter().collect();
        let mut renderer = MeshRenderer::new(&device, &refs).unwrap();
        let light = Light::new(Daylight::Day, 1);
        let whole = renderer.render(&draws, &views, &light).unwrap();
        // In tiles: the same except for rounding.
        let mut renderer = renderer.with_tile_side(23);
        let tiled = renderer.render(&draws, &views, &light).unwrap();
        let mut seen = std::collections::BTreeSet::new();
        for ((view, a), b) in views.iter().zip(&whole).zip(&tiled) {
            for shown in [a, b] {
                let share = compare(shown, view, (&rays, &draws), hair_px(&device));
                assert!(share > 0.9, "{share}");
            }
            seen.extend(a.class.iter().copied());
            let differ = a.image.iter().zip(b.image.iter()).filter(|(a, b)| a.abs_diff(**b) > 2).count();
            assert!(differ * 200 < a.image.len(), "{differ}");
        }
        assert!(seen.into_iter().eq([0, 1, 2, 3, 4, 10, 11, 12]));
    });
}

/// The comparison must be able to fail: a view shifted by one centimeter differs.
#[test]
#[should_panic(expected = "for")]
fn the_comparison_detects_a_shifted_view() {
    let (meshes, draws) = scene();
    let rays = Rays::new(&meshes, &draws);
    let from = |y: f64| view([45, 80], 60.0, DVec3::new(0.0, y, 1.4), [0.2, 0.05, 0.0]);
    let (shown, hair_px) = with_device(|device| {
        let refs: Vec<&Mesh> = meshes.iter().collect();
        let mut renderer = MeshRenderer::new(&device, &refs).unwrap();
        (renderer.render(&draws, &[from(0.0)], &Light::bare()).unwrap(), hair_px(&device))
    });
    compare(&shown[0], &from(0.01), (&rays, &draws), hair_px);
}

fn srgb(linear: f64) -> u8 {
    let v = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (255.0 * v).round() as u8
}

#[test]
fn edges_are_blended_in_linear_light() {
    // A white sheet at 10 m whose corner lies at pixel (20.3, 11.7). Two of pixel 20's samples at 20, 20.5
    // and 21, with weights 1, 2 and 1, are white; one sample in row 11 is white.
    let focal = 50.0;
    let view = view([30, 40], focal, DVec3::ZERO, [0.0; 3]);
    let [k, c] = [view.camera.intrinsics.x_axis.x, view.camera.intrinsics.z_axis.x];
    let (ky, cy) = (view.camera.intrinsics.y_axis.y, view.camera.intrinsics.z_axis.y);
    let (left, top) = (-10.0 * (20.3 - c) / k, -10.0 * (11.7 - cy) / ky);
    let mut sheet = Mesh::default();
    let corner = |y: f64, z: f64| DVec3::new(10.0, y, z);
    let corners = [corner(left, -9.0), corner(-20.0, -9.0), corner(-20.0, top), corner(left, top)];
    sheet.polygon(&corners, plain(255));
    let draws = [MeshDraw { mesh: 0, town_from_mesh: DAffine3::IDENTITY, class: 1, instance: 1 }];
    let shown = with_device(|device| {
        MeshRenderer::new(&device, &[&sheet]).unwrap().render(
            &draws,
            std::slice::from_ref(&view),
            &Light::bare(),
        )
    });
    let image = &shown.unwrap()[0].image;
    let share = |i: u32, edge: u32, cut: f64| match i {
        i if i < edge => 0.0,
        i if i > edge => 1.0,
        _ => cut,
    };
    for (x, y, pixel) in image.enumerate_pixels() {
        let linear = share(x, 20, 0.75) * share(y, 11, 0.25);
        assert_eq!(pixel.0, [srgb(linear); 3], "{x} {y}");
    }
}

#[test]
fn the_sun_casts_shadows() {
    let mut ground = Mesh::default();
    let corner = |x: f64, y: f64| DVec3::new(x, y, 0.0);
    let corners =
        [corner(-150.0, -150.0), corner(150.0, -150.0), corner(150.0, 150.0), corner(-150.0, 150.0)];
    ground.polygon(&corners, plain(150));
    let mut post = Mesh::default();
    post.block(DVec3::new(-1.5, -1.5, 0.0), DVec3::new(1.5, 1.5, 6.0), plain(150));
    let meshes = [ground, post];
    let draw =
        |mesh, x| MeshDraw { mesh, town_from_mesh: at(DVec3::new(x, 3.0, 0.0), 0.7), class: 1, instance: 0 };
    // One post near, in the fine shadow map, and one far, in the coarse one.
    let draws = [draw(0, 0.0), draw(1, 4.0), draw(1, 90.0)];
    let rays = Rays::new(&meshes, &draws);
    let near = view([60, 90], 40.0, DVec3::new(4.0, -12.0, 12.0), [1.57, 0.8, 0.0]);
    let far = view([60, 90], 250.0, DVec3::new(30.0, 3.0, 40.0), [0.0, 0.59, 0.0]);
    with_device(|device| {
        let refs: Vec<&Mesh> = meshes.iter().collect();
        let mut renderer = MeshRenderer::new(&device, &refs).unwrap();
        for (daylight, seed) in [(Daylight::Day, 1), (Daylight::Day, 6), (Daylight::Dusk, 2)] {
            let light = Light::new(daylight, seed);
            for (view, blur_m) in [(&near, 0.2), (&far, 0.6)] {
                let shown = &renderer.render(&draws, std::slice::from_ref(view), &light).unwrap()[0];
                let (mut lit, mut dark) = (Vec::new(), Vec::new());
                let town_from_camera = view.camera_from_world.inverse();
                for (x, y, pixel) in shown.image.enumerate_pixels() {
                    let place = DVec3::new(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0);
                    let ray = town_from_camera.matrix3 * (view.camera.intrinsics.inverse() * place);
                    let from = town_from_camera.translation;
                    let Some((0 | 1, t)) = rays.cast(from, ray, NEAR_M) else { continue };
                    let blocked = |dx: f64, dy: f64| {
                        let place = from + t * ray + blur_m * DVec3::new(dx, dy, 0.0);
                        rays.cast(place, light.towards_sun, 1e-6).is_some()
                    };
                    let ring = (0..16).map(|i| f64::from(i).to_radians() * 22.5);
                    let around: usize = ring.map(|a| usize::from(blocked(a.cos(), a.sin()))).sum();
                    let value = pixel.0.map(u32::from).iter().sum::<u32>();
                    match (around, blocked(0.0, 0.0)) {
                        (0, false) => lit.push(value),
                        (16, true) => dark.push(value),
                        _ => {}
                    }
                }
                assert!(lit.len() > 1000 && dark.len() > 20, "{} {}", lit.len(), dark.len());
                let mean = |values: &[u32]| f64::from(values.iter().sum::<u32>()) / values.len() as f64;
                lit.sort_unstable();
                dark.sort_unstable();
                // At dusk the low sun adds little to the sky light, which the posts block in part too.
                let (aside, share) = if daylight == Daylight::Dusk { (20, 0.9) } else { (usize::MAX, 0.85) };
                let (least, most) = (lit[lit.len() / aside], dark[dark.len() - 1 - dark.len() / aside]);
                assert!(most < least, "{daylight:?} {seed}: {most} in the shadow, {least} in the sun");
                assert!(mean(&dark) < share * mean(&lit), "{} {}", mean(&dark), mean(&lit));
            }
        }
    });
}

/// Returns a digest of images that show the whole scene, which must be equal in every process.
fn digest() -> String {
    let (meshes, draws) = scene();
    let views = [0.0, 1.2, 3.0].map(|yaw| view([45, 80], 60.0, DVec3::new(0.0, 0.4, 1.4), [yaw, 0.05, 0.0]));
    with_device(|device| {
        let refs: Vec<&Mesh> = meshes.iter().collect();
        let mut renderer = MeshRenderer::new(&device, &refs).unwrap();
        let mut bytes = Vec::new();
        for daylight in [Daylight::Day, Daylight::Dusk, Daylight::Overcast] {
            let light = Light::new(daylight, 4);
            let all = renderer.render(&draws, &views, &light).unwrap();
            assert_eq!(all, renderer.render(&draws, &views, &light).unwrap());
            // A view does not depend on the others.
            assert_eq!(all[2], renderer.render(&draws, &views[2..], &light).unwrap()[0]);
            assert!(all[0].image != all[1].image);
            bytes.extend(all.iter().flat_map(|shown| shown.image.to_vec()));
        }
        let sum = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
        });
        format!("digest {sum:016x}")
    })
}

/// The environment sets the number of lavapipe's threads, so each run needs its own process.
#[test]
fn pictures_do_not_depend_on_threads() {
    const INNER: &str = "PSKEL_TEST_TOWN_DIGEST";
    if std::env::var_os(INNER).is_some() {
        println!("{}", digest());
        return;
    }
    let run = |threads: &str| {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "town_view::pictures_do_not_depend_on_threads", "--nocapture"])
            .env(INNER, "1")
            .env("LP_NUM_THREADS", threads)
            .env("RAYON_NUM_THREADS", threads)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let line = text.lines().find(|line| line.contains("digest ")).unwrap();
        line[line.find("digest ").unwrap()..].to_owned()
    };
    assert_eq!(run("1"), run("2"));
}

/// Shadow maps of what stands are kept from view to view: images equal a new renderer's, whatever moves,
/// goes, or changes in between.
#[test]
fn kept_shadow_maps_show_in_no_image() {
    let (meshes, draws) = scene();
    let meshes: Vec<&Mesh> = meshes.iter().collect();
    let from = |x: f64| view([40, 70], 45.0, DVec3::new(x, 0.5, 1.6), [0.1, 0.05, 0.0]);
    let mut moved = draws.clone();
    moved[1].town_from_mesh = at(DVec3::new(7.0, -1.0, 0.0), 1.2);
    let cut: Vec<MeshDraw> = draws.iter().filter(|draw| draw.mesh != 2).copied().collect();
    let (day, dusk, bare) = (Light::new(Daylight::Day, 1), Light::new(Daylight::Dusk, 1), Light::bare());
    with_device(|device| {
        let mut renderer = MeshRenderer::new(&device, &meshes).unwrap();
        let mut images: Vec<Vec<u8>> = Vec::new();
        for (x, draws, light) in [
            (0.0, &draws, &day),
            (0.0, &moved, &day),
            (9.0, &moved, &day),
            (9.0, &cut, &day),
            (9.0, &cut, &dusk),
            (9.0, &cut, &bare),
            (0.0, &cut, &day),
        ] {
            let views = [from(x)];
            let kept = renderer.render(draws, &views, light).unwrap().remove(0);
            let new =
                MeshRenderer::new(&device, &meshes).unwrap().render(draws, &views, light).unwrap().remove(0);
            assert!(kept == new, "at {x} m");
            images.push(kept.image.into_raw());
        }
        assert!(images.windows(2).all(|two| two[0] != two[1]));
    });
}

#[test]
fn an_empty_scene_is_sky_and_invalid_draws_are_named() {
    let mut block = Mesh::default();
    block.block(DVec3::ZERO, DVec3::ONE, plain(9));
    let empty = Mesh::default();
    let view = view([20, 30], 20.0, DVec3::new(-5.0, 0.0, 1.0), [0.0; 3]);
    with_device(|device| {
        let light = Light::new(Daylight::Day, 1);
        let draw = |mesh| MeshDraw { mesh, town_from_mesh: DAffine3::IDENTITY, class: 1, instance: 1 };
        let views = std::slice::from_ref(&view);
        let is_sky = |shown: &GroundTruthView| {
            shown.depth_m.iter().all(|z| *z == f32::INFINITY)
                && shown.class.iter().all(|c| *c == 0)
                && shown.instance.iter().all(|i| *i == 0)
                && shown.image.pixels().all(|p| p.0[2] > 60)
        };
        let mut renderer = MeshRenderer::new(&device, &[&block, &empty]).unwrap();
        assert!(is_sky(&renderer.render(&[], views, &light).unwrap()[0]));
        assert!(is_sky(&renderer.render(&[draw(1)], views, &light).unwrap()[0]));
        assert!(!is_sky(&renderer.render(&[draw(0)], views, &light).unwrap()[0]));
        assert!(renderer.render(&[draw(0)], &[], &light).unwrap().is_empty());
        let error = renderer.render(&[draw(0), draw(2)], views, &light).unwrap_err();
        assert!(matches!(error, MeshRenderError::UnknownMesh { draw: 1, mesh: 2, meshes: 2 }));
        assert_eq!(error.to_string(), "expected meshes below 2, found 2 in draw 1");
        assert!(is_sky(&MeshRenderer::new(&device, &[]).unwrap().render(&[], views, &light).unwrap()[0]));
    });
}
