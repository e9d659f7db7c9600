use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

use super::color::estimator::Candidate;
use super::sums::{VoxelSum, Voxels, merge};
use super::sweep::SweepCloud;
use crate::skeleton::{BuildOptions, BuildReport, CHUNK_M};

/// Unit that collects points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Cell {
    /// Background chunk: its position in steps of [`CHUNK_M`].
    Chunk([i64; 3]),
    /// Track of a log.
    Track {
        /// Index of the log.
        log: usize,
        /// Index of the track in the log.
        track: usize,
    },
}

/// Points in memory, not yet written to a run.
pub(super) struct Cells {
    background: Voxels,
    actors: Voxels,
    cells: Vec<(Cell, Vec<VoxelSum>)>,
    /// Position of each cell in the list.
    index: FxHashMap<Cell, usize>,
    /// Position of the last point's cell, which the next point usually shares.
    last: usize,
    /// Number of points.
    pub(super) points: usize,
}

impl Cells {
    pub(super) fn new(options: &BuildOptions) -> Self {
        let background = Voxels { side_m: options.voxel_m };
        let actors = Voxels { side_m: options.actor_voxel_m.unwrap_or(options.voxel_m) };
        Self { background, actors, cells: Vec::new(), index: FxHashMap::default(), last: 0, points: 0 }
    }

    /// Returns the voxels that merge the points of a cell.
    pub(super) fn voxels(&self, cell: Cell) -> Voxels {
        match cell {
            Cell::Chunk(_) => self.background,
            Cell::Track { .. } => self.actors,
        }
    }

    /// Adds the colored points of a sweep with global index `sweep`. Counts them, and those without a color.
    /// Returns the tracks that received a point.
    pub(super) fn add(
        &mut self,
        log: usize,
        sweep: u64,
        cloud: &SweepCloud,
        report: &mut BuildReport,
    ) -> Vec<Cell> {
        let mut place = sweep << 32;
        for point in &cloud.background {
            let at = (point.position / CHUNK_M).floor();
            let cell = Cell::Chunk(at.to_array().map(|i| i as i64));
            report.background_points += self.add_point(cell, point, at * CHUNK_M, &mut place);
        }
        let mut tracks = Vec::new();
        for (&track, points) in &cloud.actors {
            let cell = Cell::Track { log, track };
            let added: usize =
                points.iter().map(|point| self.add_point(cell, point, DVec3::ZERO, &mut place)).sum();
            report.actor_points += added;
            if added > 0 {
                tracks.push(cell);
            }
        }
        let colorless = |points: &Vec<Candidate>| points.iter().filter(|p| p.rgb.is_none()).count();
        report.dropped_uncolored += cloud.parts().map(|(_, points)| colorless(points)).sum::<usize>();
        tracks
    }

    /// Adds a point if it has a color; returns the number of added points.
    fn add_point(&mut self, cell: Cell, point: &Candidate, origin: DVec3, place: &mut u64) -> usize {
        let Some(rgb) = point.rgb else { return 0 };
        let sum = self.voxels(cell).sum(point.position - origin, rgb, *place);
        self.sums(cell).push(sum);
        *place += 1;
        self.points += 1;
        1
    }

    fn sums(&mut self, cell: Cell) -> &mut Vec<VoxelSum> {
        if self.cells.get(self.last).is_none_or(|(last, _)| *last != cell) {
            self.last = *self.index.entry(cell).or_insert(self.cells.len());
            if self.last == self.cells.len() {
                self.cells.push((cell, Vec::new()));
            }
        }
        &mut self.cells[self.last].1
    }

    /// Removes and returns all points, merged, in the order of cells.
    pub(super) fn take(&mut self) -> Vec<(Cell, Vec<VoxelSum>)> {
        let cells = std::mem::take(&mut self.cells);
        self.index.clear();
        self.points = 0;
        let mut merged: Vec<_> = cells.into_par_iter().map(|(cell, sums)| (cell, merge(sums))).collect();
        merged.sort_by_key(|(cell, _)| *cell);
        merged
    }
}
