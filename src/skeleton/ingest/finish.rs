//! The end of a build: merges the cells into the skeleton.

use std::path::Path;

use super::builder::Builder;
use super::cells::Cell;
use super::error::BuildError;
use super::runs::{Part, Runs};
use super::stream::Stream;
use super::sums::VoxelSum;
use crate::cloud::{Point, sort_in_space};
use crate::dataset::Frame;
use crate::error::FileError;
use crate::skeleton::{Asset, BuildReport, CHUNK_M, GenerateTemplates, SkeletonWriter, Source};

/// Note for a log whose actors are empty.
const NO_ACTOR: &str =
    "boxes of a log of which none has a colored point (do their times and poses fit the sweeps?)";

impl Builder<'_> {
    /// Merges the cells of all runs and writes the skeleton.
    pub(super) fn finish(&self, out: &Path, templates: &GenerateTemplates) -> Result<(), BuildError> {
        let report = self.report();
        if report.sweeps == 0 {
            let logs = self.streams.iter().map(|stream| stream.log.name.clone()).collect();
            let gap = self.streams.iter().find_map(|stream| stream.log.gaps.first());
            return Err(BuildError::NoSweeps { frames: self.done.frames, logs, gap: gap.cloned() });
        }
        if report.points_read > 0 && report.dropped_not_finite == report.points_read {
            return Err(BuildError::NotFinite { sweeps: report.sweeps, points: report.points_read });
        }
        if report.background_points == 0 && report.actor_points == 0 {
            let BuildReport { sweeps, points_read: points, images, notes, .. } = report;
            return Err(BuildError::Empty { sweeps, points, images, notes });
        }
        let runs = Runs::open(self.work.path(), &self.done.runs)?;
        // Without voxels, points are sorted by time in runs, and in space at the end.
        let is_sorted = |cell| self.cells.voxels(cell).side_m > 0.0;
        let parts = runs.parts(&self.ordered(runs.cells())?, is_sorted);
        self.run.progress.start("merge points", parts.len());
        let logs: Vec<String> = self.streams.iter().map(|stream| stream.log.fingerprint()).collect();
        let points = |cell, sums: Vec<VoxelSum>| {
            let (voxels, class) = (self.cells.voxels(cell), self.class_of(cell));
            let mut points: Vec<Point> = sums.iter().map(|sum| voxels.mean(sum, class)).collect();
            if !is_sorted(cell) {
                sort_in_space(&mut points);
            }
            points
        };
        SkeletonWriter::write_by(out, self.work.work(), &logs, |writer| {
            runs.merged(&parts, points, |part, points| {
                self.run.progress.step();
                if self.run.progress.is_stopped() {
                    return Err(BuildError::Stopped);
                }
                self.write_part(writer, part, &points)
            })?;
            writer.templates_from(templates)?;
            let sources = self.streams.iter().map(source).collect();
            Ok(writer.finish(sources, self.options.clone(), report.clone())?)
        })
    }

    /// Returns the report with the notes of the logs, and with the boxes of each log that received no point
    /// at all.
    fn report(&self) -> BuildReport {
        let mut report = self.done.report.clone();
        for (log, stream) in self.streams.iter().enumerate() {
            for (kind, count) in &stream.log.notes {
                *report.notes.entry(kind.clone()).or_default() += count;
            }
            let is_own = |cell: &Cell| matches!(cell, Cell::Track { log: other, .. } if *other == log);
            let boxes: usize = stream.frames.iter().map(|frame| frame.boxes.len()).sum();
            // Without any point, the cause is another one.
            if boxes > 0 && report.background_points > 0 && !self.done.track_sweeps.keys().any(is_own) {
                *report.notes.entry(NO_ACTOR.to_owned()).or_default() += boxes;
            }
        }
        report
    }

    /// Orders chunks first, then tracks by id. Track indices follow the ids within one log only.
    fn ordered(&self, mut cells: Vec<Cell>) -> Result<Vec<Cell>, FileError> {
        let known = |cell: &Cell| match *cell {
            Cell::Chunk(_) => true,
            Cell::Track { log, track } => self.streams.get(log).is_some_and(|s| track < s.log.tracks.len()),
        };
        if let Some(cell) = cells.iter().find(|cell| !known(cell)) {
            return Err(FileError::content("tracks of the logs", format!("{cell:?}"), self.work.path()));
        }
        cells.sort_by_key(|cell| match *cell {
            Cell::Chunk(_) => (*cell, ""),
            Cell::Track { log, track } => {
                (Cell::Track { log: usize::MAX, track: 0 }, self.streams[log].log.tracks[track].id.as_str())
            }
        });
        Ok(cells)
    }

    fn class_of(&self, cell: Cell) -> u8 {
        match cell {
            Cell::Chunk(_) => 0,
            Cell::Track { log, track } => self.streams[log].log.tracks[track].class as u8,
        }
    }

    fn write_part(
        &self,
        writer: &mut SkeletonWriter,
        part: &Part,
        points: &[Point],
    ) -> Result<(), BuildError> {
        match part.cell {
            Cell::Chunk(place) => {
                writer.chunk_points(points)?;
                if part.is_last {
                    writer.end_chunk(place.map(|i| i as f64 * CHUNK_M));
                }
            }
            Cell::Track { log, track } => {
                let stream = &self.streams[log];
                let info = &stream.log.tracks[track];
                // A track with points has boxes.
                let Some(size) = stream.trajectories.median_size(track) else { return Ok(()) };
                writer.actor_points(points)?;
                if part.is_last {
                    writer.end_actor(|cloud, bounds| Asset {
                        log: stream.log.name.clone(),
                        track: info.id.clone(),
                        category: info.category.clone(),
                        class: info.class,
                        size: size.to_array(),
                        sweeps: self.done.track_sweeps.get(&part.cell).copied().unwrap_or(0),
                        points: cloud.points,
                        bounds,
                        xxh3: cloud.xxh3,
                    });
                }
            }
        }
        Ok(())
    }
}

fn source(stream: &Stream) -> Source {
    let time = |frame: Option<&&Frame>| frame.map_or(0, |f| f.t_us);
    Source {
        log: stream.log.name.clone(),
        location: stream.log.location.clone(),
        frames: stream.frames.len(),
        t_us: [time(stream.frames.first()), time(stream.frames.last())],
    }
}
