//! Frames in flight: commands that the device runs while the host continues.

use std::sync::Arc;
use std::time::Duration;

use super::{Commands, Submitted};
use crate::gpu::{Device, GpuError, Recorder};

/// A frame in flight: a command buffer with resources of its own (`T`: buffers that the host fills and reads)
/// and, while it runs, a reference to resources shared by all flights (`S`).
///
/// Recorded commands can only use these two. Neither is dropped or changed before the commands complete. Both
/// own all of their resources (`'static`), so that a flight which is never dropped keeps them alive too.
pub(crate) struct PendingSubmit<S: 'static, T: 'static> {
    commands: Commands,
    own: T,
    running: Option<(Submitted, Arc<S>)>,
}

impl<S: 'static, T: 'static> PendingSubmit<S, T> {
    /// Creates a command buffer with resources of its own.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub(crate) fn new(device: &Arc<Device>, own: T) -> Result<Self, GpuError> {
        Ok(Self { commands: Commands::new(device)?, own, running: None })
    }

    /// Returns its own resources. The host memory of their buffers cannot be mapped while it runs.
    pub(crate) fn own(&self) -> &T {
        &self.own
    }

    /// Waits, then returns its own resources for modification.
    ///
    /// # Errors
    /// Returns any error of [`PendingSubmit::wait`].
    pub(crate) fn own_mut(&mut self) -> Result<&mut T, GpuError> {
        self.wait()?;
        Ok(&mut self.own)
    }

    /// Waits for the previous submit, then records and submits new commands.
    ///
    /// # Errors
    /// Returns any error of `record` or of the device; no commands run then.
    pub(crate) fn start<E: From<GpuError>>(
        &mut self,
        shared: &Arc<S>,
        record: impl for<'r> FnOnce(&mut Recorder<'r>, &'r S, &'r T) -> Result<(), E>,
    ) -> Result<(), E> {
        self.wait()?;
        let mut recorder = self.commands.begin()?;
        record(&mut recorder, shared, &self.own)?;
        let (_, submitted) = recorder.start()?;
        self.running = Some((submitted, shared.clone()));
        Ok(())
    }

    /// Waits for completion. Returns the duration of each stage; empty if it was not running.
    ///
    /// # Errors
    /// Fails on any error of the device or message of the validation layer.
    pub(crate) fn wait(&mut self) -> Result<Vec<(&'static str, Duration)>, GpuError> {
        match self.running.take() {
            Some((submitted, _shared)) => self.commands.wait(submitted),
            None => Ok(Vec::new()),
        }
    }
}

impl<S: 'static, T: 'static> Drop for PendingSubmit<S, T> {
    fn drop(&mut self) {
        // A lost device runs nothing, and a drop cannot return the error.
        let _ = self.wait();
    }
}
