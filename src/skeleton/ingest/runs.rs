//! Intermediate files with the sums of some frames, cell by cell.
//!
//! # How it works
//! When enough points are in memory, their cells are written as a *run*: a file of sums and its index. Runs
//! are immutable. When the list ends with [`FAN_IN`] runs of one level, they are merged into one of the next
//! level, as in log-structured merge trees. There are thus few runs, and each point is rewritten few times.
//! Merging processes a few cells at a time, so its memory use does not depend on the length of the log.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Write;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use bytemuck::Zeroable;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cells::Cell;
use super::sums::{VoxelSum, merge_two};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::files::{Checksum, json};
use crate::files::{write_json, write_whole};

/// Number of runs that are merged at once.
const FAN_IN: usize = 8;
const SUM_BYTES: u64 = size_of::<VoxelSum>() as u64;

/// Number and level of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct RunName {
    number: usize,
    /// How often its points were merged.
    level: usize,
}

/// Number and checksum of a cell's sums in a run.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Entry {
    cell: Cell,
    sums: usize,
    xxh3: Checksum,
}

/// Callback that writes a cell with its sums.
type WriteCell<'a> = dyn FnMut(Cell, Vec<VoxelSum>) -> Result<(), FileError> + 'a;

impl RunName {
    pub(super) fn sums(&self, folder: &Path) -> PathBuf {
        folder.join(format!("run-{:06}.sums", self.number))
    }

    pub(super) fn index(&self, folder: &Path) -> PathBuf {
        folder.join(format!("run-{:06}.json", self.number))
    }

    /// Writes a run, the index last. `fill` passes the cells in order.
    fn write(
        &self,
        folder: &Path,
        fill: impl FnOnce(&mut WriteCell<'_>) -> Result<(), FileError>,
    ) -> Result<(), FileError> {
        let path = self.sums(folder);
        let mut index = Vec::new();
        write_whole(&path, |file| {
            fill(&mut |cell, sums| {
                index.push(Entry { cell, sums: sums.len(), xxh3: Checksum::of(&sums) });
                file.write_all(bytemuck::cast_slice(&sums)).map_err(FileError::io("write", &path))
            })
        })?;
        write_json(&self.index(folder), &index)
    }
}

/// Run on disk. Cells are read rather than mapped, since pages read through a mapping stay in memory.
struct Run {
    /// Position of the first sum of each cell, and its entry.
    cells: BTreeMap<Cell, (usize, Entry)>,
    path: PathBuf,
    file: File,
}

impl Run {
    fn open(folder: &Path, name: &RunName) -> Result<Self, FileError> {
        let (index, path) = (name.index(folder), name.sums(folder));
        let entries: Vec<Entry> = json::read(&index, "an index of points")?;
        let (mut cells, mut end) = (BTreeMap::new(), 0_usize);
        for entry in entries {
            cells.insert(entry.cell, (end, entry));
            end = end.saturating_add(entry.sums);
        }
        let (file, found) = open_regular(&path)?;
        let expected = (end as u64).saturating_mul(SUM_BYTES);
        if expected != found {
            return Err(FileError::content(format!("{expected} bytes"), format!("{found} bytes"), &path));
        }
        Ok(Self { cells, path, file })
    }

    /// Reads the sums of a cell and validates their checksum.
    fn read(&self, cell: Cell) -> Result<Vec<VoxelSum>, FileError> {
        let Some((first, entry)) = self.cells.get(&cell) else { return Ok(Vec::new()) };
        let mut sums = vec![VoxelSum::zeroed(); entry.sums];
        let read = self.file.read_exact_at(bytemuck::cast_slice_mut(&mut sums), *first as u64 * SUM_BYTES);
        read.map_err(FileError::io("read", &self.path))?;
        entry.xxh3.check(&sums, || format!("sums of {cell:?}"), &self.path)?;
        Ok(sums)
    }
}

/// Runs that are read together.
pub(super) struct Runs(Vec<Run>);

impl Runs {
    /// Opens runs.
    ///
    /// # Errors
    /// Fails if a run is missing or damaged.
    pub(super) fn open(folder: &Path, names: &[RunName]) -> Result<Self, FileError> {
        Ok(Self(names.iter().map(|name| Run::open(folder, name)).collect::<Result<_, _>>()?))
    }

    /// Returns every cell that has points, in order.
    pub(super) fn cells(&self) -> Vec<Cell> {
        let cells: BTreeSet<Cell> = self.0.iter().flat_map(|run| run.cells.keys().copied()).collect();
        cells.into_iter().collect()
    }

    /// Passes the merged sums of each cell to `take`, in the order of the list. Reads a few cells in
    /// parallel, while `take` runs on this thread for the previous ones.
    ///
    /// # Errors
    /// Fails if a run cannot be read or is damaged. Returns any error of `take`.
    pub(super) fn merged<E: From<FileError>>(
        &self,
        cells: &[Cell],
        mut take: impl FnMut(Cell, Vec<VoxelSum>) -> Result<(), E>,
    ) -> Result<(), E> {
        const CELLS_PER_BATCH: usize = 4;
        let of = |cell: &Cell| {
            // Merges one run after the other: a cell is in memory at most three times, for any number of
            // runs.
            let add = |sums, run: &Run| Ok::<_, FileError>(merge_two(sums, run.read(*cell)?));
            Ok((*cell, self.0.iter().try_fold(Vec::new(), add)?))
        };
        let mut ready = Vec::new();
        for some in cells.chunks(CELLS_PER_BATCH).chain([&[] as &[Cell]]) {
            let mut merged: Result<Vec<_>, FileError> = Ok(Vec::new());
            rayon::in_place_scope(|scope| {
                scope.spawn(|_| merged = some.par_iter().map(of).collect());
                ready.drain(..).try_for_each(|(cell, sums)| take(cell, sums))
            })?;
            ready = merged?;
        }
        Ok(())
    }
}

/// Appends a run to the list and merges runs if there are too many of a level. Returns the new list; the
/// files of merged runs are not deleted.
///
/// # Errors
/// Fails if a file cannot be read or written.
pub(super) fn push(
    folder: &Path,
    mut names: Vec<RunName>,
    cells: Vec<(Cell, Vec<VoxelSum>)>,
) -> Result<Vec<RunName>, FileError> {
    let mut number = names.iter().map(|name| name.number + 1).max().unwrap_or(0);
    let mut next = |level: usize| {
        number += 1;
        RunName { number: number - 1, level }
    };
    let name = next(0);
    name.write(folder, |write| cells.into_iter().try_for_each(|(cell, sums)| write(cell, sums)))?;
    names.push(name);
    loop {
        let level = names.last().map_or(0, |name| name.level);
        let first = names.partition_point(|name| name.level > level);
        if names.len() - first < FAN_IN {
            return Ok(names);
        }
        let runs = Runs::open(folder, &names[first..])?;
        let merged = next(level + 1);
        merged.write(folder, |write| runs.merged(&runs.cells(), write))?;
        names.truncate(first);
        names.push(merged);
    }
}

#[cfg(test)]
mod tests {
    use super::super::sums::{Voxels, merge};
    use super::*;
    use glam::DVec3;

    const VOXELS: Voxels = Voxels { side_m: 0.5 };

    fn sums(frame: u64) -> Vec<VoxelSum> {
        let at = |i: u64| DVec3::new((frame % 7) as f64 + i as f64 * 0.3, (i % 5) as f64, 0.1);
        merge((0..40).map(|i| VOXELS.sum(at(i), [i as u8; 3], frame << 32 | i)).collect())
    }

    /// Returns the cells of a frame: a chunk and a track.
    fn cells(frame: u64) -> Vec<(Cell, Vec<VoxelSum>)> {
        let chunk = Cell::Chunk([frame as i64 / 10, 0, -1]);
        vec![(chunk, sums(frame)), (Cell::Track { log: 0, track: frame as usize % 3 }, sums(frame + 1))]
    }

    #[test]
    fn runs_are_merged_and_nothing_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let (mut names, mut expected) = (Vec::new(), BTreeMap::<Cell, Vec<VoxelSum>>::new());
        for frame in 0..100 {
            for (cell, sums) in cells(frame) {
                expected.entry(cell).or_default().extend(sums);
            }
            names = push(folder.path(), names, cells(frame)).unwrap();
            assert!(names.len() < 2 * FAN_IN + 2, "{names:?}");
        }
        let runs = Runs::open(folder.path(), &names).unwrap();
        let mut found = BTreeMap::new();
        let keep = |cell, sums| {
            assert!(found.insert(cell, sums).is_none());
            Ok::<_, FileError>(())
        };
        runs.merged(&runs.cells(), keep).unwrap();
        let expected: BTreeMap<Cell, Vec<VoxelSum>> =
            expected.into_iter().map(|(cell, sums)| (cell, merge(sums))).collect();
        assert!(found == expected);
    }

    #[test]
    fn errors_name_a_damaged_run() {
        let folder = tempfile::tempdir().unwrap();
        let names = push(folder.path(), Vec::new(), cells(3)).unwrap();
        let path = names[0].sums(folder.path());
        std::fs::File::options().write(true).open(&path).unwrap().set_len(100).unwrap();
        let text = Runs::open(folder.path(), &names).err().unwrap().to_string();
        assert!(text.contains("found 100 bytes") && text.ends_with("run-000000.sums"), "{text}");
    }

    #[test]
    fn a_changed_byte_in_a_run_is_detected_when_its_cell_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let names = push(folder.path(), Vec::new(), cells(3)).unwrap();
        let path = names[0].sums(folder.path());
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let runs = Runs::open(folder.path(), &names).unwrap();
        let [first, last] = [0, 1].map(|i| runs.cells()[i]);
        let merged = |cell| runs.merged(&[cell], |_, _| Ok::<_, FileError>(()));
        merged(first).unwrap();
        let text = merged(last).unwrap_err().to_string();
        assert!(text.contains("sums of Track { log: 0, track: 0 } with checksum"), "{text}");
        assert!(text.ends_with("run-000000.sums"), "{text}");
    }
}
