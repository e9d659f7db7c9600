//! Submits of a batch: one, or several while positions are streamed.

use std::sync::Arc;

use super::coverage::Coverage;
use super::record::{self, Resolve, Run};
use super::shared::Shared;
use super::slot::Slot;
use super::spread::Spread;
use super::store::ROW_BYTES;
use super::tables::ProjectBand;
use crate::gpu::{Device, GpuError, PendingSubmit, Scope};

/// Inputs for recording a batch.
pub(super) struct Phases<'w> {
    pub(super) device: &'w Device,
    pub(super) resolve: Resolve<'w>,
    pub(super) covering: Coverage,
    pub(super) bands: &'w [ProjectBand],
}

impl Phases<'_> {
    fn spread(&self) -> Spread<'_> {
        let Resolve { work, key_rows, .. } = self.resolve;
        Spread { schedule: work.job.schedule, bands: self.bands, pad: work.cut.pad, key_rows }
    }

    /// Projects resident chunks, with optional clear (`first`) and spread and resolve passes (`last`).
    pub(super) fn start(
        &self,
        flight: &mut PendingSubmit<Shared, Slot>,
        shared: &Arc<Shared>,
        (first, last): (bool, bool),
        runs: &[Run],
    ) -> Result<(), GpuError> {
        let work = self.resolve.work;
        let layers = work.layers.count;
        flight.start(shared, |recorder, shared, slot| {
            if first {
                let sizes = (work.cut.key_bytes(self.resolve.key_rows), work.numbering.blocks.len());
                record::clear_maps(recorder, slot, work.job, self.resolve.pixels)?;
                record::clear(recorder, shared, slot, sizes, layers)?;
            }
            record::project(recorder, shared, slot, runs, (self.covering, layers))?;
            if last && self.covering == Coverage::Spread {
                shared.spread.record(recorder, self.device, &slot.spread[..layers], &self.spread())?;
            }
            if last {
                self.resolve.record(recorder, self.device, shared, slot)?;
            }
            Ok(())
        })
    }

    /// Uploads the staged chunks into these rows and projects them.
    pub(super) fn stream(
        &self,
        flight: &mut PendingSubmit<Shared, Slot>,
        shared: &Arc<Shared>,
        rows: &[u32],
        runs: &[Run],
    ) -> Result<(), GpuError> {
        let work = self.resolve.work;
        let layers = work.layers.count;
        flight.start(shared, |recorder, shared, slot| {
            recorder.barrier(Scope::Compute, Scope::CopyWrite);
            if let Some(staging) = &slot.staging {
                for (first, count) in neighbours(rows, shared.store.page_rows) {
                    let (page, row) = shared.store.place(rows[first]);
                    let from = (&**staging, first as u64 * ROW_BYTES);
                    recorder.write_rows(from, &shared.store.pages[page].image, 0, row..row + count as u32)?;
                }
            }
            recorder.stamp("stream");
            record::project(recorder, shared, slot, runs, (self.covering, layers))
        })
    }
}

/// Splits ascending rows into consecutive runs within one page; returns the first index and count of each
/// run.
fn neighbours(rows: &[u32], page_rows: u32) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        match runs.last_mut() {
            Some((_, count)) if rows[i - 1] + 1 == *row && row % page_rows != 0 => *count += 1,
            _ => runs.push((i, 1)),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_at_gaps_and_page_ends() {
        assert_eq!(neighbours(&[3, 4, 5, 7, 8, 9], 8), [(0, 3), (3, 1), (4, 2)]);
        assert_eq!(neighbours(&[], 8), []);
    }
}
