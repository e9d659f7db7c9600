use glam::{DAffine3, DMat4, DVec3};
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use point_skeleton::cloud::Point;
use point_skeleton::geometry::{Camera, View};
use point_skeleton::raster::{Instance, RasterizerDesc, SplatJob, class_of, create, rgb_of};
use point_skeleton::{CameraConditions, MapKind, MapSet, RasterizerKind, SplatSchedule};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::dictionary;
use crate::error::{invalid, raise};

/// Splats points `[N, 6]` (x, y, z in meters, red, green, blue in 0..255) or `[N, 7]` (and class) into cameras:
/// intrinsics `[V, 3, 3]` in pixels, `camera_from_world` `[V, 4, 4]` in meters, all of one size `(height, width)`.
#[pyfunction]
#[pyo3(signature = (points, intrinsics, camera_from_world, size, *, schedule="15:2,35:1,100:0", rasterizer="auto"))]
pub(crate) fn splat<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    intrinsics: PyReadonlyArray3<'py, f64>,
    camera_from_world: PyReadonlyArray3<'py, f64>,
    size: (u32, u32),
    schedule: &str,
    rasterizer: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let schedule: SplatSchedule = schedule.parse().map_err(invalid)?;
    let kind: RasterizerKind = rasterizer.parse().map_err(invalid)?;
    let (origin, points) = cloud(&points)?;
    let views = views(&intrinsics, &camera_from_world, size)?;
    let world_from_local = DAffine3::from_translation(origin);
    let draw = || -> Result<Vec<CameraConditions>, point_skeleton::Error> {
        let mut rasterizer = create(&RasterizerDesc::from(kind), vec![&points])?;
        let of_view = |view: &View| {
            let maps = rasterizer.splat(&SplatJob {
                view,
                schedule: &schedule,
                instances: &[Instance { cloud: 0, world_from_local, number: 0 }],
                crop: None,
                maps: MapSet::of(&[MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Point]),
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
        views.iter().map(of_view).collect()
    };
    let cameras = py.detach(draw).map_err(raise)?;
    dictionary(py, &cameras)
}

/// Returns the mean of the points and the points relative to it, which keeps their precision far from the origin.
fn cloud(points: &PyReadonlyArray2<'_, f64>) -> PyResult<(DVec3, Vec<Point>)> {
    let columns = points.shape()[1];
    if columns != 6 && columns != 7 {
        return Err(PyValueError::new_err(format!("expected points [N, 6] or [N, 7], found {columns} columns")));
    }
    let rows = points.as_array();
    let position = |row: usize| DVec3::new(rows[[row, 0]], rows[[row, 1]], rows[[row, 2]]);
    let level = |row: usize, column: usize| -> PyResult<u8> {
        let value = rows[[row, column]];
        if (0.0..256.0).contains(&value) {
            return Ok(value as u8);
        }
        Err(PyValueError::new_err(format!("expected 0..255 in column {column} of point {row}, found {value}")))
    };
    let count = rows.nrows();
    let origin = (0..count).map(position).sum::<DVec3>() / count.max(1) as f64;
    if !origin.is_finite() {
        return Err(PyValueError::new_err("expected finite positions, found inf or nan"));
    }
    let point = |row: usize| {
        let rgb = [level(row, 3)?, level(row, 4)?, level(row, 5)?];
        let class = if columns == 7 { level(row, 6)? } else { 0 };
        Ok(Point::new((position(row) - origin).as_vec3().to_array(), rgb, class))
    };
    Ok((origin, (0..count).map(point).collect::<PyResult<_>>()?))
}

fn views(
    intrinsics: &PyReadonlyArray3<'_, f64>,
    camera_from_world: &PyReadonlyArray3<'_, f64>,
    (height, width): (u32, u32),
) -> PyResult<Vec<View>> {
    let (of_intrinsics, of_poses) = (intrinsics.shape(), camera_from_world.shape());
    let count = of_intrinsics[0];
    if of_intrinsics[1..] != [3, 3] || of_poses != [count, 4, 4] {
        return Err(PyValueError::new_err(format!(
            "expected intrinsics [V, 3, 3] and camera_from_world [V, 4, 4], found {of_intrinsics:?} and {of_poses:?}"
        )));
    }
    let (intrinsics, poses) = (intrinsics.as_array(), camera_from_world.as_array());
    let view = |camera: usize| {
        let rows = std::array::from_fn(|row| std::array::from_fn(|column| intrinsics[[camera, row, column]]));
        let pose: [[f64; 4]; 4] =
            std::array::from_fn(|column| std::array::from_fn(|row| poses[[camera, row, column]]));
        let pose = DMat4::from_cols_array_2d(&pose);
        if !pose.is_finite() || pose.row(3).to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(PyValueError::new_err(format!("expected a finite rigid transform, found camera {camera}: {pose}")));
        }
        let name = format!("camera-{camera}");
        let camera = Camera::new(&name, width, height, rows).map_err(invalid)?;
        Ok(View { camera, camera_from_world: DAffine3::from_mat4(pose) })
    };
    (0..count).map(view).collect()
}
