//! Keyword arguments as options of the library.
//!
//! # How it works
//! The functions of the package that have many keyword arguments are written in Python, with types, defaults
//! and documentation. They pass their arguments by name, and [`Keywords`] reads them. Names and defaults are
//! as in the command's options.

use std::path::PathBuf;

use point_skeleton::conditions::{DepthBins, LayoutStyle};
use point_skeleton::dataset::{LogLocator, ReadOptions};
use point_skeleton::named::Named;
use point_skeleton::raster::{RasterizerDesc, RasterizerKind, SplatSchedule};
use point_skeleton::scene::{SelectionOptions, SubstituteOptions};
use point_skeleton::skeleton::AugmentOptions;
use point_skeleton::{ConditionOptions, MapKind, MapSet};
use pyo3::exceptions::{PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::error::{invalid, raise};
use crate::maps::arrays::Size;

/// Keyword arguments by name.
#[derive(Clone, Copy)]
pub(crate) struct Keywords<'a, 'py>(pub(crate) &'a Bound<'py, PyDict>);

/// Argument that names a device.
#[derive(FromPyObject)]
enum DeviceName {
    Index(u32),
    Text(String),
}

/// Returns the variant with a name.
///
/// # Errors
/// Raises `ValueError`, which lists the names.
pub(crate) fn named<T: Named>(argument: &str, name: &str) -> PyResult<T> {
    named_of(argument, name, T::ALL)
}

fn named_of<T: Named>(argument: &str, name: &str, variants: &[T]) -> PyResult<T> {
    T::from_name_in(name, variants).map_err(|error| {
        let names = error.names.join(", ");
        PyValueError::new_err(format!("expected {argument} to be one of {names}, found {name:?}"))
    })
}

impl<'py> Keywords<'_, 'py> {
    /// Returns an argument.
    ///
    /// # Errors
    /// Raises `TypeError`, which names the argument, for another type.
    pub(crate) fn get<T>(self, name: &str) -> PyResult<T>
    where
        T: for<'b> FromPyObject<'b, 'py>,
    {
        let value = self.0.get_item(name)?.ok_or_else(|| PyKeyError::new_err(name.to_owned()))?;
        value.extract().map_err(|error| {
            let (py, error) = (self.0.py(), Into::<PyErr>::into(error));
            match error.get_type(py).is(py.get_type::<PyTypeError>()) {
                true => PyTypeError::new_err(format!("argument '{name}': {}", error.value(py))),
                false => error,
            }
        })
    }

    /// Returns the variant that an argument names.
    ///
    /// # Errors
    /// Raises `ValueError`, which lists the names.
    pub(crate) fn named<T: Named>(self, argument: &str) -> PyResult<T> {
        self.named_of(argument, T::ALL)
    }

    /// Returns the one of some variants that an argument names.
    ///
    /// # Errors
    /// Raises `ValueError`, which lists their names.
    pub(crate) fn named_of<T: Named>(self, argument: &str, variants: &[T]) -> PyResult<T> {
        named_of(argument, &self.get::<String>(argument)?, variants)
    }

    /// Returns a number that fits, `None` for `None`. `expected` completes the message: `above 0 m`.
    ///
    /// # Errors
    /// Raises `ValueError` for others.
    pub(crate) fn number(
        self,
        argument: &str,
        expected: &str,
        fits: impl FnOnce(f64) -> bool,
    ) -> PyResult<Option<f64>> {
        match self.get::<Option<f64>>(argument)? {
            Some(value) if !(value.is_finite() && fits(value)) => {
                Err(PyValueError::new_err(format!("expected a {argument} {expected}, found {value}")))
            }
            value => Ok(value),
        }
    }

    /// Returns a positive count.
    ///
    /// # Errors
    /// Raises `ValueError` for others.
    pub(crate) fn count(self, argument: &str) -> PyResult<usize> {
        let count: i64 = self.get(argument)?;
        let fit = usize::try_from(count).ok().filter(|count| *count > 0);
        fit.ok_or_else(|| PyValueError::new_err(format!("expected {argument} of 1 or more, found {count}")))
    }

    /// Returns the half-open range of frames in `frames`, `(first, end)`; `None` for all.
    ///
    /// # Errors
    /// Raises `ValueError` if it is empty.
    pub(crate) fn frames(self) -> PyResult<Option<std::ops::Range<usize>>> {
        match self.get::<Option<(usize, usize)>>("frames")? {
            Some((first, end)) if first >= end => Err(PyValueError::new_err(format!(
                "expected frames (first, end) with first below end, found {:?}",
                (first, end)
            ))),
            frames => Ok(frames.map(|(first, end)| first..end)),
        }
    }

    /// Returns the location of a log, with the options for reading it.
    pub(crate) fn locate(self, name: &str) -> PyResult<LogLocator> {
        let locator = name.parse::<LogLocator>().map_err(raise)?;
        Ok(LogLocator {
            sensor_root: self.get("sensor_root")?,
            map_root: self.get("map_root")?,
            allow_outside: self.get("allow_outside")?,
            reading: ReadOptions {
                rings: self.named("ring_is")?,
                distortion: self.named("image_distortion")?,
                missing: self.named("missing")?,
            },
            ..locator
        })
    }

    /// Returns the options for rendering maps: by default as for every log, and the map layout.
    pub(crate) fn conditions(self) -> PyResult<ConditionOptions> {
        let is_distance = ConditionOptions::is_distance_m;
        let radius_m = self.number("radius", "above 0 m", is_distance)?.unwrap_or(100.0);
        let far_m = self.number("far", "above 0 m", is_distance)?;
        let splat = self.get::<Option<String>>("splat")?.map(|text| text.parse::<SplatSchedule>());
        Ok(ConditionOptions {
            maps: self.maps()?.unwrap_or(MapSet::default().with(MapKind::Map)),
            splat: splat.transpose().map_err(invalid)?.unwrap_or_default(),
            radius_m,
            size: self.get::<Option<Size>>("size")?.map(|Size(size)| size),
            out_size: self.get::<Option<Size>>("out_size")?.map(|Size(size)| size),
            color_filter: self.named("color_filter")?,
            occlusion: self.named("occlusion")?,
            depth_bins: DepthBins {
                scale: self.named("depth_bins")?,
                far_m: far_m.unwrap_or(radius_m) as f32,
                ..DepthBins::default()
            },
            depth_embedding: self.named("depth_embedding")?,
            layout: LayoutStyle {
                line_width: self.named("line_width")?,
                map_layers: self.named("map_layers")?,
            },
            line_scales: None,
        })
    }

    /// Returns the maps by name; `None` for the default ones.
    pub(crate) fn maps(self) -> PyResult<Option<MapSet>> {
        let Some(maps) = self.get::<Option<Bound<'_, PyAny>>>("maps")? else { return Ok(None) };
        let names: Vec<String> = match maps.is_instance_of::<PyString>() {
            true => Vec::new(),
            false => maps.extract()?,
        };
        if let Some(part) = names.iter().find(|name| ["points", "layout"].contains(&name.as_str())) {
            return Err(PyValueError::new_err(format!(
                "expected the map tensor, of which {part} is a part, found {part}"
            )));
        }
        if names.is_empty() || names.iter().any(|name| name.contains(',')) {
            let found = maps.repr()?;
            return Err(PyValueError::new_err(format!("expected a sequence of map names, found {found}")));
        }
        names.join(",").parse().map(Some).map_err(invalid)
    }

    /// Returns the options for selecting the clouds of actors.
    pub(crate) fn selection(self) -> PyResult<SelectionOptions> {
        Ok(SelectionOptions {
            min_actor_points: self.get("min_actor_points")?,
            template_fit: self.named("template_fit")?,
        })
    }

    /// Returns the options of templates and augmented assets.
    pub(crate) fn substitutes(self) -> PyResult<SubstituteOptions> {
        let default = AugmentOptions::default();
        let share = self.number("augment_share", "of 0 to 1", |share| (0.0..=1.0).contains(&share))?;
        let color_only = self.get("augment_color_only")?;
        let seed: Option<u64> = self.get("augment")?;
        if seed.is_none() && (color_only || share.is_some()) {
            let message = "expected augment with augment_share and augment_color_only, found None";
            return Err(PyValueError::new_err(message));
        }
        Ok(SubstituteOptions {
            library: self.get("templates")?,
            use_default: self.get("default_templates")?,
            augment: seed.map(|seed| AugmentOptions {
                seed,
                share: share.unwrap_or(default.share),
                color_only,
                ..default
            }),
            looks: Default::default(), // logs of Python have no points of files
        })
    }

    /// Returns the parameters of the rasterizer.
    pub(crate) fn rasterizer(self) -> PyResult<RasterizerDesc> {
        let kind: RasterizerKind = self.named("rasterizer")?;
        let device = self.get::<Option<DeviceName>>("device")?.map(|device| match device {
            DeviceName::Index(index) => index.to_string(),
            DeviceName::Text(text) => text,
        });
        let mib = |name| Ok::<_, PyErr>(self.get::<Option<u32>>(name)?.map(|mib| u64::from(mib) << 20));
        let (memory_bytes, host_memory_bytes) = (mib("gpu_memory")?, mib("memory")?);
        let occlusion_culling = !self.get::<bool>("no_occlusion_culling")?;
        let desc = RasterizerDesc { kind, device, memory_bytes, host_memory_bytes, occlusion_culling };
        match desc.unused().first() {
            None => Ok(desc),
            Some(name) => {
                let name = name.replace('-', "_");
                let message = format!("expected no {name} with the rasterizer {kind}, found one");
                Err(PyValueError::new_err(message))
            }
        }
    }

    /// Returns a path, `None` for `None`.
    pub(crate) fn path(self, argument: &str) -> PyResult<Option<PathBuf>> {
        self.get(argument)
    }
}
