//! Intermediate files with the sums of some frames, cell by cell.
//!
//! # How it works
//! When enough points are in memory, their cells are written as a *run*: a file of compressed blocks of sums,
//! and its index. Runs are immutable. When the list ends with [`FAN_IN`] runs of one level, they are merged
//! into one of the next level, as in log-structured merge trees. There are thus few runs, and each point is
//! rewritten few times. Cells are merged in parts of limited size, a few at a time, so the memory for merging
//! depends neither on the length of logs nor on their number.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Write;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::blocks::{BLOCK, decode, encode};
use super::cells::Cell;
use super::sums::{VoxelSum, merge_sorted};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::files::{Checksum, json};
use crate::files::{write_json, write_whole};

/// Number of runs that are merged at once.
const FAN_IN: usize = 8;
/// Level whose runs are not merged before the end: while runs are merged, their points are on disk twice.
const LAST_LEVEL: usize = 2;
/// Number of runs, as they were first written, that are merged at once at most.
pub(super) const MERGED_AT_ONCE: usize = FAN_IN.pow(LAST_LEVEL as u32);
/// Maximum number of sums in a part: larger cells are split.
pub(super) const PART: usize = 1 << 19;

/// Number and level of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct RunName {
    number: usize,
    /// How often its points were merged.
    level: usize,
}

/// Some sums of a cell in a run.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Block {
    cell: Cell,
    /// Of the first sum.
    key: u64,
    sums: usize,
    /// Of the file.
    bytes: u64,
    /// Of the sums.
    xxh3: Checksum,
}

/// Sums of a cell that are merged at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    pub(super) cell: Cell,
    keys: Range<u64>,
    /// Number of sums before merging, about.
    sums: usize,
    /// Whether this is the last part of its cell.
    pub(super) is_last: bool,
}

impl RunName {
    pub(super) fn sums(&self, folder: &Path) -> PathBuf {
        folder.join(format!("run-{:06}.sums", self.number))
    }

    pub(super) fn index(&self, folder: &Path) -> PathBuf {
        folder.join(format!("run-{:06}.json", self.number))
    }

    /// Writes a run, the index last. `fill` passes the blocks in order.
    fn write(
        &self,
        folder: &Path,
        fill: impl FnOnce(&mut WriteBlocks<'_>) -> Result<(), FileError>,
    ) -> Result<(), FileError> {
        let path = self.sums(folder);
        let mut index = Vec::new();
        write_whole(&path, |file| {
            fill(&mut |blocks| {
                blocks.into_iter().try_for_each(|(block, bytes)| {
                    index.push(block);
                    file.write_all(&bytes).map_err(FileError::io("write", &path))
                })
            })
        })?;
        write_json(&self.index(folder), &index)
    }
}

/// Callback that writes blocks.
type WriteBlocks<'a> = dyn FnMut(Vec<(Block, Vec<u8>)>) -> Result<(), FileError> + 'a;

/// Compresses sums of a cell, which are sorted by voxel.
fn blocks(cell: Cell, sums: &[VoxelSum]) -> Vec<(Block, Vec<u8>)> {
    let block = |sums: &[VoxelSum]| {
        let (key, bytes, xxh3) = (sums[0].key, encode(sums), Checksum::of(sums));
        (Block { cell, key, sums: sums.len(), bytes: bytes.len() as u64, xxh3 }, bytes)
    };
    sums.chunks(BLOCK).map(block).collect()
}

/// Run on disk. Blocks are read rather than mapped, since pages read through a mapping stay in memory.
struct Run {
    /// Position of each block in the file, and its entry.
    cells: BTreeMap<Cell, Vec<(u64, Block)>>,
    path: PathBuf,
    file: File,
}

impl Run {
    fn open(folder: &Path, name: &RunName) -> Result<Self, FileError> {
        let (index, path) = (name.index(folder), name.sums(folder));
        let entries: Vec<Block> = json::read(&index, "an index of points")?;
        let (mut cells, mut end) = (BTreeMap::<Cell, Vec<_>>::new(), 0_u64);
        for block in entries {
            if !(1..=BLOCK).contains(&block.sums) {
                let expected = format!("blocks of 1 to {BLOCK} sums");
                return Err(FileError::content(expected, block.sums.to_string(), &index));
            }
            cells.entry(block.cell).or_default().push((end, block));
            end = end.saturating_add(block.bytes);
        }
        let (file, found) = open_regular(&path)?;
        if end != found {
            return Err(FileError::content(format!("{end} bytes"), format!("{found} bytes"), &path));
        }
        Ok(Self { cells, path, file })
    }

    /// Reads the sums of a part and appends them to `to`. Validates their checksums.
    fn read(&self, part: &Part, to: &mut Vec<VoxelSum>) -> Result<(), FileError> {
        let Some(blocks) = self.cells.get(&part.cell) else { return Ok(()) };
        let first = blocks.partition_point(|(_, block)| block.key <= part.keys.start).saturating_sub(1);
        for (position, block) in blocks[first..].iter().take_while(|(_, block)| block.key < part.keys.end) {
            let mut bytes = vec![0; block.bytes as usize];
            self.file.read_exact_at(&mut bytes, *position).map_err(FileError::io("read", &self.path))?;
            let name = || format!("sums of {:?}", block.cell);
            let sums = decode(&bytes, block.sums);
            let sums = sums.ok_or_else(|| FileError::content(name(), "other bytes", &self.path))?;
            block.xxh3.check(&sums, name, &self.path)?;
            let from = sums.partition_point(|sum| sum.key < part.keys.start);
            let to_end = sums.partition_point(|sum| sum.key < part.keys.end);
            to.extend(&sums[from..to_end]);
        }
        Ok(())
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

    /// Splits cells into parts of about [`PART`] sums at most, if they may be split.
    pub(super) fn parts(&self, cells: &[Cell], may_split: impl Fn(Cell) -> bool) -> Vec<Part> {
        let mut parts = Vec::new();
        for &cell in cells {
            let blocks = self.0.iter().filter_map(|run| run.cells.get(&cell)).flatten();
            let mut blocks: Vec<_> = blocks.map(|(_, block)| (block.key, block.sums)).collect();
            blocks.sort_unstable();
            let (mut start, mut sums) = (0, 0);
            for (key, count) in blocks {
                if sums + count > PART && key > start && sums > 0 && may_split(cell) {
                    parts.push(Part { cell, keys: start..key, sums, is_last: false });
                    (start, sums) = (key, 0);
                }
                sums += count;
            }
            parts.push(Part { cell, keys: start..u64::MAX, sums, is_last: true });
        }
        parts
    }

    /// Passes what `map` makes of the merged sums of each part to `take`, in the order of the list. Merges a
    /// few parts in parallel, while `take` runs on this thread for the previous ones.
    ///
    /// # Errors
    /// Fails if a run cannot be read or is damaged. Returns any error of `take`.
    pub(super) fn merged<T: Send, E: From<FileError>>(
        &self,
        parts: &[Part],
        map: impl Fn(Cell, Vec<VoxelSum>) -> T + Sync,
        mut take: impl FnMut(&Part, T) -> Result<(), E>,
    ) -> Result<(), E> {
        let of = |part: &Part| {
            let mut sums = Vec::with_capacity(part.sums);
            self.0.iter().try_for_each(|run| run.read(part, &mut sums))?;
            Ok::<_, FileError>(map(part.cell, merge_sorted(sums)))
        };
        let (mut ready, mut rest) = ((&[] as &[Part], Vec::new()), parts);
        loop {
            let (some, others) = rest.split_at(batch(rest));
            let mut merged: Result<Vec<_>, FileError> = Ok(Vec::new());
            rayon::in_place_scope(|scope| {
                scope.spawn(|_| merged = some.par_iter().map(of).collect());
                ready.0.iter().zip(ready.1.drain(..)).try_for_each(|(part, mapped)| take(part, mapped))
            })?;
            if some.is_empty() {
                return Ok(());
            }
            (ready, rest) = ((some, merged?), others);
        }
    }
}

/// Returns how many of the next parts are merged in parallel.
fn batch(parts: &[Part]) -> usize {
    let allowed = PART * rayon::current_num_threads();
    let mut sums = 0;
    let fits = |part: &&Part| {
        sums += part.sums;
        sums <= allowed
    };
    parts.iter().take_while(fits).count().max(1).min(parts.len())
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
    let encoded: Vec<_> = cells.into_par_iter().map(|(cell, sums)| blocks(cell, &sums)).collect();
    name.write(folder, |write| encoded.into_iter().try_for_each(write))?;
    names.push(name);
    loop {
        let level = names.last().map_or(0, |name| name.level);
        let first = names.partition_point(|name| name.level > level);
        if names.len() - first < FAN_IN || level == LAST_LEVEL {
            return Ok(names);
        }
        let runs = Runs::open(folder, &names[first..])?;
        let parts = runs.parts(&runs.cells(), |_| true);
        let merged = next(level + 1);
        let encoded = |cell, sums: Vec<VoxelSum>| blocks(cell, &sums);
        merged.write(folder, |write| runs.merged(&parts, encoded, |_, blocks| write(blocks)))?;
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

    fn merged(runs: &Runs, parts: &[Part]) -> Result<BTreeMap<Cell, Vec<VoxelSum>>, FileError> {
        let mut found = BTreeMap::<Cell, Vec<VoxelSum>>::new();
        let keep = |part: &Part, sums: Vec<VoxelSum>| {
            assert!(
                found.get(&part.cell).and_then(|sums| sums.last()).is_none_or(|last| last.key < sums[0].key)
            );
            found.entry(part.cell).or_default().extend(sums);
            Ok::<_, FileError>(())
        };
        runs.merged(parts, |_, sums| sums, keep)?;
        Ok(found)
    }

    #[test]
    fn runs_are_merged_and_nothing_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let (mut names, mut expected) = (Vec::new(), BTreeMap::<Cell, Vec<VoxelSum>>::new());
        for frame in 0..1100 {
            for (cell, sums) in cells(frame) {
                expected.entry(cell).or_default().extend(sums);
            }
            names = push(folder.path(), names, cells(frame)).unwrap();
            assert!(names.len() < frame as usize / 64 + 2 * FAN_IN, "{names:?}");
        }
        assert_eq!(names.iter().filter(|name| name.level == LAST_LEVEL).count(), 1100 / 64);
        let runs = Runs::open(folder.path(), &names).unwrap();
        let expected: BTreeMap<Cell, Vec<VoxelSum>> =
            expected.into_iter().map(|(cell, sums)| (cell, merge(sums))).collect();
        assert!(merged(&runs, &runs.parts(&runs.cells(), |_| true)).unwrap() == expected);
    }

    /// Cells of more points than a part, in runs whose blocks overlap.
    #[test]
    fn large_cells_are_merged_in_parts() {
        let folder = tempfile::tempdir().unwrap();
        let (cell, small) = (Cell::Chunk([1, 0, 0]), Cell::Chunk([0; 3]));
        let voxels = Voxels { side_m: 0.02 };
        let run = |run: usize| {
            let at =
                |i: usize| DVec3::new((i % 800) as f64 * 0.04, (i / 800) as f64 * 0.04, run as f64 * 0.01);
            merge((0..PART / 3).map(|i| voxels.sum(at(i), [run as u8; 3], 0)).collect())
        };
        let push = |names, i: usize| {
            push(folder.path(), names, vec![(small, sums(i as u64)), (cell, run(i))]).unwrap()
        };
        let runs = Runs::open(folder.path(), &(0..7).fold(Vec::new(), push)).unwrap();
        let parts = runs.parts(&runs.cells(), |_| true);
        let of_cell: Vec<&Part> = parts.iter().filter(|part| part.cell == cell).collect();
        assert!(of_cell.len() >= 3 && of_cell.iter().all(|part| part.sums <= PART), "{parts:?}");
        assert_eq!(parts.iter().filter(|part| part.is_last).count(), 2);
        let expected = merge((0..7).flat_map(run).collect());
        assert!(merged(&runs, &parts).unwrap()[&cell] == expected);
        let whole = runs.parts(&runs.cells(), |of| of != cell);
        assert_eq!(whole.len(), 2);
        assert!(merged(&runs, &whole).unwrap()[&cell] == expected);
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
        let bytes = std::fs::read(&path).unwrap();
        let runs = Runs::open(folder.path(), &names).unwrap();
        let [first, last] = [0, 1].map(|i| runs.parts(&runs.cells(), |_| true)[i..=i].to_vec());
        let (second, whole) = (runs.0[0].cells[&last[0].cell][0].0 as usize, merged(&runs, &last).unwrap());
        let mut found = 0;
        for at in second..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            std::fs::write(&path, changed).unwrap();
            merged(&runs, &first).unwrap();
            match merged(&runs, &last) {
                // A copy of bytes may have several sources.
                Ok(sums) => assert!(sums == whole),
                Err(error) => {
                    let text = error.to_string();
                    assert!(text.contains("expected sums of Track { log: 0, track: 0 }"), "{text}");
                    assert!(text.ends_with("run-000000.sums"), "{text}");
                    found += 1;
                }
            }
        }
        assert!(found * 10 > (bytes.len() - second) * 9, "{found} of {}", bytes.len() - second);
    }
}
