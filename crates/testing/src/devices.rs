//! Runs all rasterizers on one job and compares them.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::geometry::{Camera, View};
use point_skeleton::gpu::{Device, DeviceDesc};
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, ComputeRasterizer, ComputeRasterizerDesc, CpuRasterizer, CpuRasterizerDesc, GraphicsRasterizer,
    GraphicsRasterizerDesc, Instance, MapSet, Rasterizer, SplatJob, SplatMaps, SplatSchedule,
};

use crate::shared::skip;

/// Runs a test with a device under validation; fails on any message, also on destruction of the device.
pub fn with_device<T>(test: impl FnOnce(Arc<Device>) -> T) -> T {
    let desc = DeviceDesc { validation: true, ..DeviceDesc::from_env() };
    let device = Device::new(&desc).unwrap_or_else(|e| panic!("{e}"));
    let messages = device.validation_messages();
    let result = test(device);
    messages.check().unwrap_or_else(|e| panic!("{e}"));
    result
}

/// Work division of a device's rasterizers, for tests that change it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Division {
    pub raster: GraphicsRasterizerDesc,
    pub compute: ComputeRasterizerDesc,
}

/// Name of Mesa's lavapipe, which supports all rasterizers.
const LAVAPIPE: &str = "llvmpipe";

/// Runs a test with a device that supports `compute`; skips it on other devices.
pub fn with_compute_device(test: impl FnOnce(Arc<Device>)) {
    with_device(|device| if has_compute(&device) { test(device) } else { skip("no 64-bit atomics") });
}

fn has_compute(device: &Device) -> bool {
    assert!(device.atomics_64() || !device.name().contains(LAVAPIPE), "{}", device.name());
    device.atomics_64()
}

/// Creates all rasterizers that a device supports, and the processor's.
pub fn rasterizers<'a>(
    device: &Arc<Device>,
    clouds: &CloudSet<'a>,
    division: Division,
) -> Vec<Box<dyn Rasterizer + 'a>> {
    let raster = GraphicsRasterizer::with_desc(device.clone(), clouds, division.raster);
    let mut all: Vec<Box<dyn Rasterizer + 'a>> = vec![Box::new(raster.unwrap_or_else(|e| panic!("{e}")))];
    for occlusion_culling in [true, false] {
        let desc = CpuRasterizerDesc { occlusion_culling, memory_bytes: None };
        all.push(Box::new(CpuRasterizer::with_desc(clouds.clone(), desc)));
    }
    if has_compute(device) {
        let copies = ComputeRasterizerDesc { copies: true, ..division.compute };
        for desc in [division.compute, copies] {
            let compute = ComputeRasterizer::with_desc(device.clone(), clouds, desc);
            all.push(Box::new(compute.unwrap_or_else(|e| panic!("{e}"))));
        }
    }
    all
}

/// Returns how many pixels differ in any plane. Maps of different sizes or planes differ everywhere.
pub fn differing(a: &SplatMaps, b: &SplatMaps) -> usize {
    let lengths = |m: &SplatMaps| {
        [
            m.width as usize,
            m.height as usize,
            m.point.len(),
            m.depth_m.len(),
            m.rgb_class.len(),
            m.instance.len(),
        ]
    };
    let pixels = a.width as usize * a.height as usize;
    if lengths(a) != lengths(b) {
        return pixels.max(1);
    }
    let differs = |i: &usize| {
        let bits = |m: &SplatMaps| {
            let depth = m.depth_m.get(*i).map(|d| d.to_bits());
            (depth, m.point.get(*i).copied(), m.rgb_class.get(*i).copied(), m.instance.get(*i).copied())
        };
        bits(a) != bits(b)
    };
    (0..pixels).filter(differs).count()
}

/// Fails if two rasterizers differ on any pixel.
pub fn assert_same(a: &SplatMaps, b: &SplatMaps, what: &str) {
    let count = differing(a, b);
    assert_eq!(count, 0, "{what}: {count} of {}x{} pixels differ", a.width, a.height);
}

/// Input of a hand-computed case: one cloud per entry, all at the origin, and a camera at the origin.
pub struct Case {
    pub clouds: Vec<Vec<Point>>,
    pub view: View,
    pub schedule: SplatSchedule,
    pub instances: Vec<Instance>,
}

impl Case {
    /// Creates a camera of focal length 1 with its principal point at the corner: the point `(i·z, j·z, z)`
    /// is in pixel (i, j).
    pub fn new(width: u32, height: u32, schedule: &str, clouds: &[&[Point]]) -> Self {
        let rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("test", width, height, rows).unwrap();
        let instance = |cloud| Instance {
            cloud,
            world_from_local: DAffine3::from_translation(DVec3::ZERO),
            number: cloud as u32 + 10,
        };
        Self {
            clouds: clouds.iter().map(|c| c.to_vec()).collect(),
            view: View { camera, camera_from_world: DAffine3::IDENTITY },
            schedule: schedule.parse().unwrap(),
            instances: (0..clouds.len()).map(instance).collect(),
        }
    }

    /// Renders maps with all rasterizers, which must agree.
    pub fn draw(&self, maps: MapSet) -> SplatMaps {
        let clouds: CloudSet<'_> = self.clouds.iter().map(Cloud::from).collect();
        let job = SplatJob {
            view: &self.view,
            schedule: &self.schedule,
            instances: &self.instances,
            crop: None,
            maps,
        };
        let expected = ReferenceRasterizer::new(clouds.clone()).splat(&job).unwrap();
        with_device(|device| {
            for mut rasterizer in rasterizers(&device, &clouds, Division::default()) {
                let found = rasterizer.splat(&job).unwrap();
                assert_same(&expected, &found, rasterizer.info().rasterizer);
            }
        });
        expected
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A comparator that cannot fail proves nothing.
    #[test]
    fn the_comparator_detects_each_plane() {
        let point = Point::new([1.0, 1.0, 1.0], [1, 2, 3], 1);
        let maps = Case::new(3, 3, "9:0", &[&[point]]).draw(MapSet::SPLATTED);
        assert_eq!(differing(&maps, &maps), 0);
        let change = |edit: &dyn Fn(&mut SplatMaps)| {
            let mut other = maps.clone();
            edit(&mut other);
            differing(&maps, &other)
        };
        assert_eq!(change(&|m| m.point[0] = 7), 1);
        assert_eq!(change(&|m| m.depth_m[4] = m.depth_m[4].next_up()), 1);
        assert_eq!(change(&|m| m.rgb_class[8] ^= 1 << 24), 1);
        assert_eq!(change(&|m| m.instance.fill(9)), 9);
        assert_eq!(change(&|m| m.instance.clear()), 9);
        let failed = std::panic::catch_unwind(|| {
            let mut other = maps.clone();
            other.point[0] = 7;
            assert_same(&maps, &other, "one pixel");
        });
        assert!(failed.is_err());
    }
}
