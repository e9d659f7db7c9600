//! Frame as it is sent: a header in JSON, then the images.

use serde::Serialize;

use crate::generated::GeneratedHeader;
use crate::message::to_json;

/// Header of a frame.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Header {
    /// Number of the frame.
    pub(crate) frame: u64,
    /// `look` or `simulate`.
    pub(crate) mode: &'static str,
    /// Time of the state, absolute microseconds.
    pub(crate) t_us: i64,
    /// Seconds since the first frame of the log.
    pub(crate) t_s: f64,
    /// Step of the simulation.
    pub(crate) step: Option<usize>,
    /// Step at which the log gave up the wheel.
    pub(crate) takeover: Option<usize>,
    /// Who drives.
    pub(crate) by: &'static str,
    /// Whether time runs.
    pub(crate) playing: bool,
    /// Times the real time.
    pub(crate) speed: f64,
    /// Why the simulation cannot go on.
    pub(crate) ended: Option<&'static str>,
    /// Number of the newest keys that the state follows from.
    pub(crate) keys_number: u64,
    /// State of the ego.
    pub(crate) ego: Ego,
    /// Displacement from the log.
    pub(crate) offset: Offset,
    /// New events.
    pub(crate) events: Vec<Event>,
    /// Cameras that are compared with their recorded images: PSNR of filled pixels, dB.
    pub(crate) psnr_db: Vec<(String, f64)>,
    /// Images, in the order of their bytes.
    pub(crate) images: Vec<ImageHeader>,
    /// Actors in the bird's-eye view.
    pub(crate) actors: Vec<Actor>,
    /// Range of the bird's-eye view, meters.
    pub(crate) reach_m: Option<f64>,
    /// Durations, milliseconds.
    pub(crate) times_ms: Times,
    /// State of the generator; `None` if nothing is generated.
    pub(crate) generated: Option<GeneratedHeader>,
    /// Command that writes the same maps.
    pub(crate) command: String,
}

/// State of the ego.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Ego {
    /// Global, meters.
    pub(crate) x: f64,
    /// Global, meters.
    pub(crate) y: f64,
    /// Global, meters.
    pub(crate) z: f64,
    /// Global yaw, radians.
    pub(crate) yaw_rad: f64,
    /// Meters per second.
    pub(crate) speed_mps: f64,
    /// Meters per second squared.
    pub acceleration_mps2: f64,
    /// Radians per second.
    pub(crate) yaw_rate_radps: f64,
    /// Radians.
    pub(crate) steering_rad: f64,
    /// Left of the recorded path, meters.
    pub(crate) lateral_m: Option<f64>,
    /// Left of the direction of the recorded path, radians.
    pub(crate) heading_rad: Option<f64>,
}

/// Displacement of the ego and its cameras.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Offset {
    /// Meters.
    pub(crate) forward_m: f64,
    /// Meters.
    pub(crate) left_m: f64,
    /// Meters.
    pub(crate) up_m: f64,
    /// Degrees.
    pub(crate) yaw_deg: f64,
    /// Degrees.
    pub(crate) pitch_deg: f64,
}

/// Event of a simulation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Event {
    /// Step.
    pub(crate) step: usize,
    /// Seconds since the first frame of the log.
    pub(crate) t_s: f64,
    /// What happened.
    pub(crate) text: String,
}

/// Description of an image.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ImageHeader {
    /// Name of the camera; empty for the bird's-eye view.
    pub(crate) camera: String,
    /// Name of the map.
    pub(crate) map: &'static str,
    /// `jpeg` or `png`.
    pub(crate) codec: &'static str,
    /// Number of bytes.
    pub(crate) bytes: usize,
    /// Pixels.
    pub(crate) width: u32,
    /// Pixels.
    pub(crate) height: u32,
}

/// Actor in the bird's-eye view.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Actor {
    /// Track id.
    pub(crate) track: String,
    /// Global center, meters.
    pub(crate) x: f64,
    /// Global center, meters.
    pub(crate) y: f64,
    /// Global yaw, radians.
    pub(crate) yaw_rad: f64,
    /// Meters.
    pub(crate) length: f64,
    /// Meters.
    pub(crate) width: f64,
}

/// Durations of a frame, milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Times {
    /// Simulation.
    pub(crate) step: f64,
    /// Rendering.
    pub(crate) draw: f64,
    /// Encoding.
    pub(crate) encode: f64,
}

/// Returns the bytes of a frame: the length of the header (4 bytes, little-endian), the header, the images.
pub(crate) fn packed(header: &Header, images: &[Vec<u8>]) -> Vec<u8> {
    let json = to_json(header);
    let length = 4 + json.len() + images.iter().map(Vec::len).sum::<usize>();
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(&(json.len() as u32).to_le_bytes());
    bytes.extend_from_slice(json.as_bytes());
    images.iter().for_each(|image| bytes.extend_from_slice(image));
    bytes
}
