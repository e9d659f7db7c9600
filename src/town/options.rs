/// What a town is like and how it is recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TownOptions {
    /// What everything follows from.
    pub seed: u64,
    /// Annotated frames.
    pub frames: usize,
    /// Annotated frames a second.
    pub hz: f64,
    /// LiDAR turns a second: 10 or 20.
    pub lidar_hz: f64,
    /// LiDAR beams: 32 or 64.
    pub beams: u16,
    /// Height and width of the images, pixels.
    pub size: [u32; 2],
    /// `None`: the seed chooses.
    pub daylight: Option<Daylight>,
}

/// Time of day and sky.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Daylight {
    /// Sun, blue sky.
    Day,
    /// A low sun, lamps are lit.
    Dusk,
    /// Grey sky, soft shadows.
    Overcast,
}

impl Default for TownOptions {
    fn default() -> Self {
        let (seed, frames) = (7, 40);
        Self { seed, frames, hz: 5.0, lidar_hz: 10.0, beams: 32, size: [450, 800], daylight: None }
    }
}

impl TownOptions {
    /// From the first frame to the last, seconds.
    pub fn duration_s(&self) -> f64 {
        self.frames.saturating_sub(1) as f64 / self.hz
    }
}
