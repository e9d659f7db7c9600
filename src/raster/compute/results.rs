//! Maps of a frame, as read by the host.

use std::sync::Arc;

use bytemuck::Pod;

use super::plan::BandResult;
use super::slot::{DEPTH, INSTANCE, MAPS, POINT, RGB_CLASS, Slot};
use crate::geometry::ImageSize;
use crate::gpu::{GpuError, Mapped};
use crate::raster::{FrameMaps, MapSet, Plane, RasterError, ViewMaps};

/// Returns a view without maps.
pub(super) fn empty(size: ImageSize) -> ViewMaps<'static> {
    let none = || Plane::from(Vec::new());
    ViewMaps { size, rgb_class: none(), depth_m: Vec::new().into(), instance: none(), point: none() }
}

/// Maps of a view assembled from batches.
pub(super) struct OwnedMaps {
    size: ImageSize,
    maps: [Vec<u32>; MAPS],
}

impl OwnedMaps {
    pub(super) fn new(size: ImageSize, wanted: MapSet) -> Self {
        let map = |has: bool| vec![0; if has { size.pixels() } else { 0 }];
        Self { size, maps: Slot::wanted(wanted).map(map) }
    }

    pub(super) fn done(self) -> ViewMaps<'static> {
        let [rgb_class, depth, instance, point] = self.maps;
        ViewMaps {
            size: self.size,
            rgb_class: rgb_class.into(),
            depth_m: bytemuck::cast_vec(depth).into(),
            instance: instance.into(),
            point: point.into(),
        }
    }
}

/// Copies the strips of a batch into the maps of their views.
pub(super) fn read_parts(
    slot: &Slot,
    results: &[BandResult],
    wanted: MapSet,
    maps: &mut [OwnedMaps],
) -> Result<(), GpuError> {
    for (index, _) in Slot::wanted(wanted).iter().enumerate().filter(|(_, has)| **has) {
        let memory = slot.maps[index].readable().map()?;
        let words: &[u32] = bytemuck::cast_slice(&memory);
        for result in results {
            let view = &mut maps[result.band.view];
            let width = view.size.width as usize;
            for (i, row) in (result.band.rows[0]..result.band.rows[1]).enumerate() {
                let from = result.pixel + i * result.row_pixels;
                view.maps[index][row as usize * width..][..width].copy_from_slice(&words[from..][..width]);
            }
        }
    }
    Ok(())
}

/// Returns the maps of a one-batch frame: in place, unless their rows have padding or a view has several
/// strips. At strong reductions the source rows between strips are not drawn, so several strips of a view fit
/// into one batch although the whole view did not.
pub(super) fn read_maps<'s>(
    slot: &'s Slot,
    results: &[BandResult],
    sizes: &[ImageSize],
    wanted: MapSet,
) -> Result<FrameMaps<'s>, RasterError> {
    let in_place = |r: &BandResult| {
        let size = sizes[r.band.view];
        r.row_pixels == size.width as usize && r.band.rows == [0, size.height]
    };
    if !results.iter().all(in_place) {
        let mut maps: Vec<OwnedMaps> = sizes.iter().map(|size| OwnedMaps::new(*size, wanted)).collect();
        read_parts(slot, results, wanted, &mut maps)?;
        return Ok(maps.into_iter().map(OwnedMaps::done).collect());
    }
    let mut memory: [Option<Arc<Mapped<'s>>>; MAPS] = [const { None }; MAPS];
    for (index, _) in Slot::wanted(wanted).iter().enumerate().filter(|(_, has)| **has) {
        memory[index] = Some(Arc::new(slot.maps[index].readable().map()?));
    }
    let view = |result: &BandResult| ViewMaps {
        size: sizes[result.band.view],
        rgb_class: plane(&memory[RGB_CLASS], result, sizes),
        depth_m: plane(&memory[DEPTH], result, sizes),
        instance: plane(&memory[INSTANCE], result, sizes),
        point: plane(&memory[POINT], result, sizes),
    };
    Ok(results.iter().map(view).collect())
}

/// Returns a strip's part of a map; empty if the map was not requested.
fn plane<'s, T: Pod>(
    memory: &Option<Arc<Mapped<'s>>>,
    result: &BandResult,
    sizes: &[ImageSize],
) -> Plane<'s, T> {
    let Some(memory) = memory else { return Vec::new().into() };
    let first = 4 * result.pixel;
    Plane::mapped(memory.clone(), first..first + 4 * sizes[result.band.view].pixels())
}
