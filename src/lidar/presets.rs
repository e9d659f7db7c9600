//! Presets: the beams of common devices.
//!
//! Elevations are nominal; a device's own calibration differs by hundredths of a degree. Sources are listed
//! in
//! `docs/src/guide/lidar.md`.

use std::path::Path;

use super::spec::{LidarDevice, LidarSpec, Mount};
use crate::error::FileError;
use crate::named;

/// A LiDAR whose beams are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Velodyne HDL-32E at 20 Hz, as on nuScenes' cars.
    Hdl32e,
    /// Velodyne VLP-32C at 10 Hz.
    Vlp32c,
    /// Hesai Pandar64 at 10 Hz, as on PandaSet's cars.
    Pandar64,
    /// Hesai Pandar128 at 10 Hz.
    Pandar128,
    /// Hesai AT128 at 10 Hz, which looks forward.
    At128,
    /// Two VLP-32C at 10 Hz, the lower one upside down, as on Argoverse 2's cars.
    Av2,
    /// Five merged devices at 20 Hz in the manner of nuPlan's cars.
    Nuplan,
}

named!(Preset, "LiDAR" {
    Hdl32e => "hdl-32e", "Velodyne HDL-32E at 20 Hz, as on nuScenes' cars: 32 beams, 1084 columns";
    Vlp32c => "vlp-32c", "Velodyne VLP-32C at 10 Hz: 32 beams, 1800 columns";
    Pandar64 => "pandar64", "Hesai Pandar64 at 10 Hz, as on PandaSet's cars: 64 beams, 1800 columns";
    Pandar128 => "pandar128", "Hesai Pandar128 at 10 Hz: 128 beams, 1800 columns";
    At128 => "at128", "Hesai AT128 at 10 Hz: 128 beams, 1200 columns, 120 degrees ahead";
    Av2 => "av2", "Two VLP-32C at 10 Hz, one upside down, as on Argoverse 2's cars";
    Nuplan => "nuplan", "Five merged devices at 20 Hz in the manner of nuPlan's cars";
});

/// Elevations of the VLP-32C from the lowest beam up, degrees.
const VLP_32C_DEG: [f64; 32] = [
    -25.0, -15.639, -11.31, -8.843, -7.254, -6.148, -5.333, -4.667, -4.0, -3.667, -3.333, -3.0, -2.667,
    -2.333, -2.0, -1.667, -1.333, -1.0, -0.667, -0.333, 0.0, 0.333, 0.667, 1.0, 1.333, 1.667, 2.333, 3.333,
    4.667, 7.0, 10.333, 15.0,
];
/// Elevations of the Pandar40P from the lowest beam up, degrees.
const PANDAR_40P_DEG: [f64; 40] = [
    -15.444, -14.543, -13.63, -12.705, -11.772, -10.826, -9.871, -8.908, -7.934, -6.957, -5.974, -5.647,
    -5.311, -4.986, -4.657, -4.321, -3.996, -3.663, -3.327, -3.0, -2.667, -2.331, -2.001, -1.667, -1.334,
    -1.001, -0.667, -0.334, 0.0, 0.333, 0.667, 1.001, 1.333, 1.667, 2.001, 2.999, 3.996, 4.988, 5.976, 6.96,
];
/// Elevations of the Pandar64 from the lowest beam up, degrees.
const PANDAR_64_DEG: [f64; 64] = [
    -24.897, -18.889, -13.93, -12.974, -12.006, -11.032, -9.885, -9.06, -8.059, -7.063, -6.061, -5.898,
    -5.726, -5.565, -5.391, -5.229, -5.057, -4.892, -4.72, -4.558, -4.385, -4.221, -4.05, -3.884, -3.712,
    -3.548, -3.375, -3.21, -3.04, -2.873, -2.7, -2.536, -2.365, -2.198, -2.028, -1.86, -1.688, -1.522,
    -1.351, -1.184, -1.013, -0.845, -0.675, -0.508, -0.337, -0.169, 0.0, 0.169, 0.337, 0.508, 0.675, 0.846,
    1.013, 1.184, 1.351, 1.522, 1.688, 1.86, 2.028, 3.04, 5.057, 8.059, 11.032, 14.882,
];
/// Elevations of the Pandar128 from the lowest beam up, degrees.
const PANDAR_128_DEG: [f64; 128] = [
    -25.016, -24.123, -23.678, -23.219, -22.768, -22.304, -21.848, -21.379, -20.918, -20.445, -19.978,
    -19.501, -19.03, -18.548, -18.072, -17.592, -17.106, -16.622, -16.135, -15.645, -15.154, -14.66, -14.166,
    -13.67, -13.173, -12.673, -12.174, -11.672, -11.17, -10.665, -10.16, -9.652, -9.149, -8.64, -8.134,
    -7.624, -7.117, -6.607, -6.1, -5.968, -5.843, -5.718, -5.589, -5.463, -5.336, -5.209, -5.081, -4.951,
    -4.824, -4.699, -4.571, -4.444, -4.318, -4.19, -4.062, -3.933, -3.806, -3.68, -3.552, -3.425, -3.299,
    -3.172, -3.044, -2.916, -2.789, -2.663, -2.535, -2.409, -2.282, -2.155, -2.027, -1.901, -1.773, -1.646,
    -1.519, -1.393, -1.266, -1.141, -1.012, -0.887, -0.76, -0.632, -0.506, -0.38, -0.254, -0.129, 0.0, 0.124,
    0.251, 0.379, 0.505, 0.63, 0.756, 0.88, 1.008, 1.13, 1.258, 1.386, 1.511, 1.637, 1.761, 1.885, 2.013,
    2.512, 3.013, 3.509, 4.007, 4.501, 4.996, 5.487, 5.978, 6.467, 6.953, 7.438, 7.921, 8.401, 8.88, 9.356,
    9.83, 10.305, 10.771, 11.239, 11.702, 12.165, 12.624, 13.082, 13.535, 14.436,
];

impl LidarSpec {
    /// Returns the LiDAR that a text names: a preset, or the path of a JSON file that ends in `.json`.
    ///
    /// # Errors
    /// Fails if there is no such preset, or if the file cannot be read or is invalid.
    pub fn named(text: &str) -> Result<Self, FileError> {
        let path = Path::new(text);
        if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json")) {
            return Self::read(path);
        }
        text.parse::<Preset>().map(Preset::spec).map_err(|error| {
            let expected = format!("{}, or a file that ends in .json", error.expected());
            FileError::content(expected, format!("{text:?}"), Path::new("--lidar"))
        })
    }
}

impl Preset {
    /// Returns the devices. A single one is mounted where the log's LiDAR is.
    pub fn spec(self) -> LidarSpec {
        let devices = match self {
            Self::Hdl32e => vec![device("LIDAR_TOP", hdl_32e(), 1084, [0.9, 100.0], 0.05)],
            Self::Vlp32c => vec![device("LIDAR_TOP", VLP_32C_DEG.to_vec(), 1800, [1.0, 200.0], 0.1)],
            Self::Pandar64 => vec![device("LIDAR_TOP", PANDAR_64_DEG.to_vec(), 1800, [0.3, 200.0], 0.1)],
            Self::Pandar128 => vec![device("LIDAR_TOP", PANDAR_128_DEG.to_vec(), 1800, [0.3, 200.0], 0.1)],
            Self::At128 => vec![at128()],
            Self::Av2 => av2(),
            Self::Nuplan => nuplan(),
        };
        LidarSpec { devices, seed: 0 }
    }
}

/// Creates a device that turns clockwise from behind, with the time stamp at its end.
fn device(
    name: &str,
    elevations_deg: Vec<f64>,
    columns: usize,
    range_m: [f64; 2],
    sweep_s: f64,
) -> LidarDevice {
    LidarDevice {
        name: name.to_owned(),
        elevations_deg,
        azimuth_offsets_deg: Vec::new(),
        columns,
        azimuth_deg: [180.0, -180.0],
        range_m,
        ego_from_lidar: None,
        sweep_s,
        stamp: 1.0,
        dropout: 0.0,
    }
}

/// 32 beams every 4/3 degree, the highest at 10.67.
fn hdl_32e() -> Vec<f64> {
    (0..32).map(|beam| (f64::from(beam) * 4.0 - 92.0) / 3.0).collect()
}

/// 128 beams every 0.2 degree, and columns every 0.1 degree.
fn at128() -> LidarDevice {
    let elevations = (0..128).map(|beam| f64::from(beam) / 5.0 - 12.5).collect();
    let ahead = device("LIDAR_FRONT", elevations, 1200, [0.5, 200.0], 0.1);
    LidarDevice { azimuth_deg: [60.0, -60.0], ..ahead }
}

/// The sweep has the time stamp of its first return; both devices turn half a turn apart.
fn av2() -> Vec<LidarDevice> {
    let up = device("up_lidar", VLP_32C_DEG.to_vec(), 1800, [1.0, 200.0], 0.1);
    let mount = |z, rotation| Some(Mount { translation: [1.35, 0.0, z], rotation });
    let down = LidarDevice {
        name: "down_lidar".into(),
        azimuth_deg: [0.0, 360.0],
        ego_from_lidar: mount(1.525, [0.0, 1.0, 0.0, 0.0]),
        stamp: 0.0,
        ..up.clone()
    };
    vec![LidarDevice { ego_from_lidar: mount(1.64, [1.0, 0.0, 0.0, 0.0]), stamp: 0.0, ..up }, down]
}

/// One device of 40 beams on the roof, and four of 20 beams around the car, with every second of its beams.
fn nuplan() -> Vec<LidarDevice> {
    let few: Vec<f64> = PANDAR_40P_DEG.into_iter().step_by(2).collect();
    let at = |name, beams: &[f64], position| LidarDevice {
        ego_from_lidar: Some(Mount::level(position)),
        stamp: 0.5,
        ..device(name, beams.to_vec(), 1800, [0.5, 200.0], 0.05)
    };
    vec![
        at("top", &PANDAR_40P_DEG, [1.4, 0.0, 1.9]),
        at("front", &few, [3.9, 0.0, 0.7]),
        at("left", &few, [2.6, 1.0, 0.9]),
        at("right", &few, [2.6, -1.0, 0.9]),
        at("rear", &few, [-1.0, 0.0, 0.9]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_their_beams_rise() {
        let beams = Preset::ALL.map(|preset| preset.spec().beams());
        assert_eq!(beams, [32, 32, 64, 128, 128, 64, 120]);
        for preset in Preset::ALL {
            let spec = preset.spec();
            assert_eq!(spec.fault(), None, "{preset}");
            for device in &spec.devices {
                assert!(device.elevations_deg.windows(2).all(|pair| pair[0] < pair[1]), "{preset}");
            }
        }
        let hdl = hdl_32e();
        assert!((hdl[0] + 30.667).abs() < 1e-3 && (hdl[31] - 10.667).abs() < 1e-3);
    }

    #[test]
    fn texts_name_presets_or_files() {
        assert_eq!(LidarSpec::named("av2").unwrap(), Preset::Av2.spec());
        let message = LidarSpec::named("hdl-99").unwrap_err().to_string();
        assert!(
            message.contains("hdl-32e") && message.contains(".json") && message.contains("hdl-99"),
            "{message}"
        );
        let message = LidarSpec::named("none/lidar.JSON").unwrap_err().to_string();
        assert!(message.contains("cannot read") && message.contains("none/lidar.JSON"), "{message}");
    }

    /// The lower device of Argoverse 2 is upside down: what is above it in its own frame is below it on the
    /// car, and its columns turn clockwise on the car, half a turn from the upper one's.
    #[test]
    fn a_device_upside_down_turns_like_the_other_one() {
        let [up, down] = <[LidarDevice; 2]>::try_from(Preset::Av2.spec().devices).unwrap();
        let ahead = |device: &LidarDevice, beam, column| {
            device.ego_from_lidar().rotation * device.direction(beam, column)
        };
        assert!(ahead(&up, 31, 0).z > 0.25 && ahead(&down, 31, 0).z < -0.25);
        for column in [0, 450, 1100] {
            let (a, b) = (ahead(&up, 20, column), ahead(&down, 20, column));
            assert!((a.truncate() + b.truncate()).length() < 1e-9, "{a} {b}");
        }
    }
}
