//! nuScenes.
use super::{Dataset, DatasetError, ImageRecord, Log, LogLocator, Sweep, SweepRecord};
/// Reader.
#[derive(Debug)]
pub struct NuScenes(Log);
impl NuScenes {
    /// Opens.
    pub fn open(_locator: &LogLocator) -> Result<Self, DatasetError> {
        unimplemented!()
    }
}
impl Dataset for NuScenes {
    fn log(&self) -> &Log {
        &self.0
    }
    fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
        unimplemented!()
    }
    fn read_image(&self, _: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        unimplemented!()
    }
}
