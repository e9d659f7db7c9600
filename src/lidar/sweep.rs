//! Returns of a sweep as range images and as a list.

use crate::dataset::SweepPoint;
use crate::geometry::Pose;

/// Returns of a LiDAR's devices.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarSweep {
    /// Name of the state.
    pub name: String,
    /// Time stamp, absolute microseconds.
    pub t_us: i64,
    /// Ego pose at the time stamp, in whose frame the positions are.
    pub global_from_ego: Pose,
    /// Track of each actor number, from 1 on.
    pub tracks: Vec<String>,
    /// Range images, in the order of the devices.
    pub devices: Vec<RangeImage>,
}

/// Returns of a device: arrays `[beams, columns]`, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RangeImage {
    /// Name of the device.
    pub name: String,
    /// Number of beams, in the order of the spec.
    pub beams: usize,
    /// Number of columns.
    pub columns: usize,
    /// Ring number of the first beam: how many beams the devices before it have.
    pub first_ring: usize,
    /// Ranges from where the device was, meters; 0 without a return.
    pub range_m: Vec<f32>,
    /// Positions in the ego frame at the time stamp, meters; zeros without a return.
    pub position: Vec<[f32; 3]>,
    /// Coarse classes, as in class maps.
    pub class: Vec<u8>,
    /// Actor numbers, as in instance maps.
    pub instance: Vec<u32>,
    /// Time of each column after the time stamp, seconds.
    pub offset_s: Vec<f32>,
}

/// A return of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarReturn {
    /// Meters, ego frame at the sweep's time stamp.
    pub position: [f32; 3],
    /// Reflected light, 0 to 255; 0, since skeletons do not keep it.
    pub intensity: f32,
    /// Ring number: the beam, counted through all devices.
    pub ring: u16,
    /// Index of the device.
    pub device: u8,
    /// Coarse class, as in class maps.
    pub class: u8,
    /// Actor number, as in instance maps.
    pub instance: u32,
    /// Time after the time stamp, seconds.
    pub offset_s: f32,
}

impl LidarSweep {
    /// Returns the number of returns.
    pub fn count(&self) -> usize {
        self.devices.iter().map(RangeImage::count).sum()
    }

    /// Iterates over the returns: device by device, column by column, beam by beam.
    pub fn returns(&self) -> impl Iterator<Item = LidarReturn> {
        self.devices.iter().zip(0..).flat_map(|(image, device)| image.returns(device))
    }

    /// Returns the points like a recorded sweep has them, in the ego frame.
    pub fn points(&self) -> Vec<SweepPoint> {
        let point = |LidarReturn { position, intensity, ring, .. }| SweepPoint { position, intensity, ring };
        self.returns().map(point).collect()
    }
}

impl RangeImage {
    /// Returns the number of returns.
    pub fn count(&self) -> usize {
        self.range_m.iter().filter(|range_m| **range_m > 0.0).count()
    }

    fn returns(&self, device: u8) -> impl Iterator<Item = LidarReturn> {
        let places = (0..self.columns).flat_map(|column| (0..self.beams).map(move |beam| (beam, column)));
        places.filter_map(move |(beam, column)| {
            let at = beam * self.columns + column;
            (self.range_m[at] > 0.0).then(|| LidarReturn {
                position: self.position[at],
                intensity: 0.0,
                ring: (self.first_ring + beam) as u16,
                device,
                class: self.class[at],
                instance: self.instance[at],
                offset_s: self.offset_s[column],
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn returns_are_in_the_order_of_columns() {
        let image = |first_ring| RangeImage {
            beams: 2,
            columns: 2,
            first_ring,
            range_m: vec![1.0, 0.0, 3.0, 4.0],
            position: [1.0, 0.0, 3.0, 4.0].map(|x| [x, 0.0, 0.0]).to_vec(),
            class: vec![0, 0, 1, 2],
            instance: vec![0, 0, 5, 6],
            offset_s: vec![-0.1, 0.0],
            ..RangeImage::default()
        };
        let sweep = LidarSweep {
            name: "0".into(),
            t_us: 0,
            global_from_ego: Pose::IDENTITY,
            tracks: Vec::new(),
            devices: vec![image(0), image(2)],
        };
        assert_eq!(sweep.count(), 6);
        let list: Vec<_> =
            sweep.returns().map(|r| (r.position[0], r.ring, r.device, r.instance, r.offset_s)).collect();
        assert_eq!(list[..3], [(1.0, 0, 0, 0, -0.1), (3.0, 1, 0, 5, -0.1), (4.0, 1, 0, 6, 0.0)]);
        assert_eq!((list[3].1, list[5].1, list[5].2, sweep.points().len()), (2, 3, 1, 6));
    }
}
