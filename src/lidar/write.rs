//! Files of a sweep: its points, a range image to look at, and `lidar.json`.

use std::io::Write;
use std::path::Path;

use serde::Serialize;

use super::sweep::{LidarReturn, LidarSweep, RangeImage};
use crate::cloud::npy::write_header;
use crate::conditions::DepthBins;
use crate::conditions::write::png;
use crate::error::FileError;
use crate::files::{write_json, write_whole};
use crate::geometry::ImageSize;
use crate::{named, named_in_files};

/// Range of the last color of range images, meters.
const SHOWN_M: f32 = 80.0;
/// Least height of a range image, pixels: beams are repeated.
const HEIGHT: usize = 128;
/// Columns of an NPY file.
const NPY_COLUMNS: usize = 9;
/// Last line of a PCD header.
const PCD_DATA: &str = "DATA binary\n";

/// Type of the numbers in a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LidarNumber {
    /// Unsigned, 8 bits.
    U8,
    /// Unsigned, 16 bits.
    U16,
    /// Unsigned, 32 bits.
    U32,
    /// Floating point, 32 bits.
    F32,
}

impl LidarNumber {
    /// Returns the size in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }
}

/// File format of a sweep's points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LidarFormat {
    /// `lidar.pcd.bin`, as nuScenes: x, y, z, intensity and ring in `f32`.
    #[default]
    Bin,
    /// `lidar.pcd`, binary: x y z intensity ring device class instance time.
    Pcd,
    /// `lidar.npy`, `f32` `[N, 9]`: the same columns.
    Npy,
}

named!(LidarFormat, "LiDAR format" {
    Bin => "bin", "As nuScenes: x y z intensity ring in float32";
    Pcd => "pcd", "Binary PCD: x y z intensity ring device class instance time";
    Npy => "npy", "NumPy array [N, 9] in float32 of the same columns";
});
named_in_files!(LidarFormat);

impl LidarFormat {
    /// Returns the name of the file.
    pub fn file(self) -> &'static str {
        match self {
            Self::Bin => "lidar.pcd.bin",
            Self::Pcd => "lidar.pcd",
            Self::Npy => "lidar.npy",
        }
    }

    /// Returns the columns of the points, in the order of their bytes.
    pub fn columns(self) -> Vec<(&'static str, LidarNumber)> {
        use LidarNumber::{F32, U8, U16, U32};
        let point = ["x", "y", "z", "intensity"].map(|name| (name, F32));
        let more = ["ring", "device", "class", "instance", "time"];
        let types = match self {
            Self::Bin => &[F32] as &[_],
            Self::Pcd => &[U16, U8, U8, U32, F32],
            Self::Npy => &[F32; 5],
        };
        point.into_iter().chain(more.into_iter().zip(types.iter().copied())).collect()
    }

    /// Returns the rows of an encoded file, without its header; `None` if it is no file of this format.
    pub fn rows(self, file: &[u8]) -> Option<&[u8]> {
        let data = PCD_DATA.as_bytes();
        let begin = match self {
            Self::Bin => 0,
            Self::Pcd => file.windows(data.len()).position(|window| window == data)? + data.len(),
            Self::Npy => 10 + usize::from(u16::from_le_bytes([*file.get(8)?, *file.get(9)?])),
        };
        let rows = file.get(begin..)?;
        let row: usize = self.columns().iter().map(|(_, number)| number.bytes()).sum();
        rows.len().is_multiple_of(row).then_some(rows)
    }

    /// Encodes the points of a sweep.
    ///
    /// # Errors
    /// Never fails in practice: the header is written to memory.
    pub fn encode(self, sweep: &LidarSweep) -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        match self {
            Self::Bin => {
                sweep.returns().for_each(|r| bytes.extend(bin_row(&r).map(f32::to_le_bytes).as_flattened()))
            }
            Self::Pcd => {
                bytes.extend(pcd_header(sweep.count()).bytes());
                sweep.returns().for_each(|r| push_pcd_row(&mut bytes, &r));
            }
            Self::Npy => {
                write_header::<f32>(&mut bytes, &[sweep.count() as u64, NPY_COLUMNS as u64])?;
                sweep.returns().for_each(|r| bytes.extend(npy_row(&r).map(f32::to_le_bytes).as_flattened()));
            }
        }
        Ok(bytes)
    }
}

fn bin_row(r: &LidarReturn) -> [f32; 5] {
    let [x, y, z] = r.position;
    [x, y, z, r.intensity, f32::from(r.ring)]
}

fn npy_row(r: &LidarReturn) -> [f32; NPY_COLUMNS] {
    let [x, y, z, intensity, ring] = bin_row(r);
    let (device, class) = (f32::from(r.device), f32::from(r.class));
    [x, y, z, intensity, ring, device, class, r.instance as f32, r.offset_s]
}

fn pcd_header(points: usize) -> String {
    let columns = LidarFormat::Pcd.columns();
    let all = |text: &dyn Fn(&(&str, LidarNumber)) -> String| {
        columns.iter().map(text).collect::<Vec<_>>().join(" ")
    };
    let fields = all(&|(name, _)| (*name).to_owned());
    let sizes = all(&|(_, number)| number.bytes().to_string());
    let types = all(&|(_, number)| if *number == LidarNumber::F32 { "F" } else { "U" }.to_owned());
    let counts = all(&|_| "1".to_owned());
    format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\n\
         WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\n{PCD_DATA}"
    )
}

fn push_pcd_row(bytes: &mut Vec<u8>, r: &LidarReturn) {
    bytes.extend(r.position.map(f32::to_le_bytes).as_flattened());
    bytes.extend(r.intensity.to_le_bytes());
    bytes.extend(r.ring.to_le_bytes());
    bytes.extend([r.device, r.class]);
    bytes.extend(r.instance.to_le_bytes());
    bytes.extend(r.offset_s.to_le_bytes());
}

/// Content of `lidar.json`.
#[derive(Serialize)]
struct Meta<'a> {
    t_us: i64,
    /// The frame of the points: quaternion `w x y z` and meters.
    global_from_ego: PoseMeta,
    points: usize,
    file: &'static str,
    devices: Vec<DeviceMeta<'a>>,
    /// Track of each actor number, from 1 on.
    tracks: &'a [String],
}

#[derive(Serialize)]
struct PoseMeta {
    rotation: [f64; 4],
    translation: [f64; 3],
}

#[derive(Serialize)]
struct DeviceMeta<'a> {
    name: &'a str,
    beams: usize,
    columns: usize,
    first_ring: usize,
    points: usize,
}

impl<'a> DeviceMeta<'a> {
    fn new(image: &'a RangeImage) -> Self {
        let RangeImage { beams, columns, first_ring, .. } = *image;
        Self { name: &image.name, beams, columns, first_ring, points: image.count() }
    }
}

impl LidarSweep {
    /// Writes the points, a range image per device (`lidar.png`, `lidar_1.png`, ..), and `lidar.json` into an
    /// existing folder.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn write(&self, folder: &Path, format: LidarFormat) -> Result<(), FileError> {
        let path = folder.join(format.file());
        let bytes = format.encode(self).map_err(FileError::io("write", &path))?;
        write_whole(&path, |out| out.write_all(&bytes).map_err(FileError::io("write", &path)))?;
        for (number, image) in self.devices.iter().enumerate() {
            let name = if number == 0 { "lidar.png".to_owned() } else { format!("lidar_{number}.png") };
            let (size, pixels) = image.picture();
            png::write_rgb(&folder.join(name), &pixels, size)?;
        }
        write_json(&folder.join("lidar.json"), &self.meta(format))
    }

    fn meta(&self, format: LidarFormat) -> Meta<'_> {
        let (rotation, translation) =
            (self.global_from_ego.wxyz(), self.global_from_ego.translation.to_array());
        Meta {
            t_us: self.t_us,
            global_from_ego: PoseMeta { rotation, translation },
            points: self.count(),
            file: format.file(),
            devices: self.devices.iter().map(DeviceMeta::new).collect(),
            tracks: &self.tracks,
        }
    }
}

impl RangeImage {
    /// Returns a picture of the ranges: columns from left to right, the highest beam first, in the colors of
    /// depth maps up to 80 m, black without a return.
    pub fn picture(&self) -> (ImageSize, Vec<[u8; 3]>) {
        let bins = DepthBins { far_m: SHOWN_M, ..DepthBins::default() };
        let colors = bins.colors();
        let repeats = HEIGHT.div_ceil(self.beams.max(1));
        let mut pixels = Vec::with_capacity(self.range_m.len() * repeats);
        for beam in (0..self.beams).rev() {
            let ranges = &self.range_m[beam * self.columns..][..self.columns];
            let row: Vec<[u8; 3]> =
                bins.bins(ranges).into_iter().map(|bin| colors[usize::from(bin)]).collect();
            (0..repeats).for_each(|_| pixels.extend(&row));
        }
        (ImageSize { height: (self.beams * repeats) as u32, width: self.columns as u32 }, pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    fn sweep() -> LidarSweep {
        let image = RangeImage {
            name: "top".into(),
            beams: 2,
            columns: 1,
            range_m: vec![0.0, 40.0],
            position: vec![[0.0; 3], [1.0, 2.0, 3.0]],
            class: vec![0, 1],
            instance: vec![0, 70_000],
            offset_s: vec![-0.05],
            ..RangeImage::default()
        };
        LidarSweep {
            name: "000000".into(),
            t_us: 7,
            global_from_ego: Pose::IDENTITY,
            tracks: vec!["a".into()],
            devices: vec![image],
        }
    }

    #[test]
    fn formats_have_their_columns() {
        let sweep = sweep();
        let bin = LidarFormat::Bin.encode(&sweep).unwrap();
        assert_eq!(bin, [1.0_f32, 2.0, 3.0, 0.0, 1.0].map(f32::to_le_bytes).as_flattened());
        let npy = LidarFormat::Npy.encode(&sweep).unwrap();
        assert_eq!(npyz::NpyFile::new(npy.as_slice()).unwrap().shape(), [1, 9]);
        let row = [1.0_f32, 2.0, 3.0, 0.0, 1.0, 0.0, 1.0, 70_000.0, -0.05];
        assert!(npy.ends_with(row.map(f32::to_le_bytes).as_flattened()));
        let pcd = LidarFormat::Pcd.encode(&sweep).unwrap();
        let header = "FIELDS x y z intensity ring device class instance time\nSIZE 4 4 4 4 2 1 1 4 4\n\
            TYPE F F F F U U U U F\nCOUNT 1 1 1 1 1 1 1 1 1\n";
        assert!(String::from_utf8_lossy(&pcd).contains(header));
    }

    #[test]
    fn rows_follow_the_header() {
        for (format, bytes) in [(LidarFormat::Bin, 20), (LidarFormat::Pcd, 28), (LidarFormat::Npy, 36)] {
            let file = format.encode(&sweep()).unwrap();
            let rows = format.rows(&file).unwrap();
            assert_eq!((rows.len(), &rows[..4]), (bytes, &1.0_f32.to_le_bytes()[..]), "{format:?}");
            assert!(file.ends_with(rows));
            assert_eq!(format.rows(&file[..file.len() - 1]), None, "{format:?}");
        }
    }

    /// The project's own reader reads the files.
    #[test]
    fn files_read_back() {
        let folder = tempfile::tempdir().unwrap();
        for format in LidarFormat::ALL {
            sweep().write(folder.path(), format).unwrap();
        }
        let names = ["lidar.pcd.bin", "lidar.pcd", "lidar.npy", "lidar.json", "lidar.png"];
        assert!(names.iter().all(|name| folder.path().join(name).is_file()));
        let text = std::fs::read_to_string(folder.path().join("lidar.json")).unwrap();
        let meta: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(
            (&meta["points"], &meta["devices"][0]["name"], &meta["file"]),
            (&1.into(), &"top".into(), &"lidar.npy".into())
        );
    }

    /// Half of the colors' range is in the middle of the colormap; the lowest beam is the last row.
    #[test]
    fn pictures_show_the_highest_beam_first() {
        let (size, pixels) = sweep().devices[0].picture();
        assert_eq!((size.height, size.width, pixels.len()), (128, 1, 128));
        let bins = DepthBins { far_m: SHOWN_M, ..DepthBins::default() };
        assert_eq!((pixels[0], pixels[127]), (bins.colors()[128], [0; 3]));
    }
}
