use glam::DAffine3;
use point_skeleton::conditions::{ConditionError, check_memory};
use point_skeleton::geometry::{Camera, View};
use point_skeleton::raster::{Instance, RasterizerDesc, SplatJob, class_of, create, rgb_of};
use point_skeleton::{CameraConditions, ConditionOptions, MapKind, MapSet, RasterizerKind, SplatSchedule};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{invalid, raise};
use crate::maps::arrays::{Numbers, Size, affine, intrinsics as matrix, shaped};
use crate::maps::dictionary;
use crate::maps::points::placed;
use crate::pool::detached;

/// Splats points `[N, 6]` (x, y, z in meters; red, green, blue of 0 to 255) or `[N, 7]` (and class) into
/// cameras: `intrinsics` `[V, 3, 3]` in pixels, `camera_from_world` `[V, 4, 4]` in meters, all of one `size`
/// (height, width). Returns color, depth, class and point maps. Colors of 0 to 1 with fractions are scaled,
/// and points more than 16 km from most others are off by more than 0.5 mm, both with a `UserWarning`. Raises
/// `ValueError` for invalid arrays, `TypeError` for masked values, `RenderError` without a device.
#[pyfunction]
#[pyo3(signature = (points, intrinsics, camera_from_world, size, *, schedule="15:2,35:1,100:0",
    rasterizer="auto"))]
pub(crate) fn splat<'py>(
    py: Python<'py>,
    points: Numbers<'py>,
    intrinsics: Numbers<'py>,
    camera_from_world: Numbers<'py>,
    size: Size,
    schedule: &str,
    rasterizer: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let schedule: SplatSchedule = schedule.parse().map_err(invalid)?;
    let kind: RasterizerKind = rasterizer.parse().map_err(invalid)?;
    let (points, origin) = placed(py, "points", &crate::maps::points::points(py, "points", &points)?)?;
    let views = views(&intrinsics, &camera_from_world, size)?;
    let world_from_local = DAffine3::from_translation(origin);
    let maps = MapSet::of(&[MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Point]);
    let options = ConditionOptions { maps, ..ConditionOptions::default() };
    let draw = || {
        check_memory(&views, &options, false).map_err(|error| raise(ConditionError::from(error)))?;
        let mut rasterizer = create(&RasterizerDesc::from(kind), vec![(&points).into()]).map_err(raise)?;
        let mut of_view = |view: &View| {
            let maps = rasterizer.splat(&SplatJob {
                view,
                schedule: &schedule,
                instances: &[Instance { cloud: 0, world_from_local, number: 0 }],
                crop: None,
                maps,
            })?;
            Ok(CameraConditions {
                width: maps.width,
                height: maps.height,
                color: Some(maps.rgb_class.iter().map(|pixel| rgb_of(*pixel)).collect()),
                class: Some(maps.rgb_class.iter().map(|pixel| class_of(*pixel)).collect()),
                depth_m: Some(maps.depth_m),
                point: Some(maps.point),
                ..CameraConditions::default()
            })
        };
        let cameras: Result<Vec<_>, point_skeleton::raster::RasterError> =
            views.iter().map(&mut of_view).collect();
        cameras.map_err(raise)
    };
    dictionary(py, &detached(py, draw)?)
}

fn views(intrinsics: &Numbers<'_>, poses: &Numbers<'_>, Size(size): Size) -> PyResult<Vec<View>> {
    let intrinsics = shaped("intrinsics", intrinsics, &[0, 3, 3])?;
    let poses = shaped("camera_from_world", poses, &[0, 4, 4])?;
    let (count, found) = (intrinsics.shape()[0], poses.shape()[0]);
    if count != found {
        let message = format!("expected a camera_from_world for each of {count} intrinsics, found {found}");
        return Err(PyValueError::new_err(message));
    }
    let view = |i: usize| {
        let rows = matrix(|row, column| intrinsics[[i, row, column]]);
        let camera = Camera::new(format!("camera-{i}"), size.width, size.height, rows).map_err(invalid)?;
        let camera_from_world =
            affine(&format!("camera_from_world[{i}]"), |row, column| poses[[i, row, column]])?;
        Ok(View { camera, camera_from_world })
    };
    (0..count).map(view).collect()
}
