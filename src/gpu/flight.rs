//! Commands that run while the host goes on.

use std::sync::Arc;
use std::time::Duration;

use super::commands::{Commands, Submitted};
use super::{Device, GpuError, Recorder};

/// A command buffer, what it alone uses (`T`: buffers that the host fills and reads), and, while it runs, a share of
/// what all flights use (`S`).
///
/// What is recorded can only come from the two of them, and neither is let go or changed before it is done. Both own all
/// that they hold (`'static`), so that a flight which is never dropped keeps it alive too.
pub struct Flight<S: 'static, T: 'static> {
    commands: Commands,
    own: T,
    running: Option<(Submitted, Arc<S>)>,
}

impl<S: 'static, T: 'static> Flight<S, T> {
    /// A command buffer with its own things.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(device: &Arc<Device>, own: T) -> Result<Self, GpuError> {
        Ok(Self { commands: Commands::new(device)?, own, running: None })
    }

    /// Its own things. The host memory of buffers that it uses cannot be mapped while it runs.
    pub fn own(&self) -> &T {
        &self.own
    }

    /// Its own things, to be changed; waits first.
    ///
    /// # Errors
    /// The device's.
    pub fn own_mut(&mut self) -> Result<&mut T, GpuError> {
        self.wait()?;
        Ok(&mut self.own)
    }

    /// Records and starts; waits first for what it still runs.
    ///
    /// # Errors
    /// Those of the recording, the device's; nothing runs then.
    pub fn start<E: From<GpuError>>(
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

    /// Waits until it is done. Returns the time of each stage; nothing if it did not run.
    ///
    /// # Errors
    /// The device's, any message of the validation layer.
    pub fn wait(&mut self) -> Result<Vec<(&'static str, Duration)>, GpuError> {
        match self.running.take() {
            Some((submitted, _shared)) => self.commands.wait(submitted),
            None => Ok(Vec::new()),
        }
    }
}

impl<S: 'static, T: 'static> Drop for Flight<S, T> {
    fn drop(&mut self) {
        // A lost device runs nothing any more; there is nobody to tell.
        let _ = self.wait();
    }
}
