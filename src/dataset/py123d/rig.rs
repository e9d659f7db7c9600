//! Cameras and rates of vehicles. Source: the enum `CameraID` of py123d, version 0.7.0.

/// Cameras clockwise from the front, by kind: pinhole, stereo, downward, fisheye, f-theta.
const RING: [&str; 23] = [
    "PCAM_F0",
    "PCAM_R0",
    "PCAM_R1",
    "PCAM_R2",
    "PCAM_B0",
    "PCAM_L2",
    "PCAM_L1",
    "PCAM_L0",
    "PCAM_STEREO_L",
    "PCAM_STEREO_R",
    "PCAM_D0",
    "FMCAM_L",
    "FMCAM_R",
    "FTCAM_F0",
    "FTCAM_TELE_F0",
    "FTCAM_R0",
    "FTCAM_R1",
    "FTCAM_R2",
    "FTCAM_B0",
    "FTCAM_TELE_B0",
    "FTCAM_L2",
    "FTCAM_L1",
    "FTCAM_L0",
];

/// Returns the key by which cameras are sorted: known ones around the vehicle, then others by name.
pub(super) fn place(name: &str) -> (usize, &str) {
    (RING.iter().position(|known| *known == name).unwrap_or(RING.len()), name)
}

/// Returns the simulation and planning steps per second of a data set, if others than those of the format.
pub(super) fn rates_hz(dataset: &str) -> Option<[f64; 2]> {
    (dataset == "nuscenes").then_some([12.0, 2.0])
}
