use bytemuck::{Pod, Zeroable};

/// Point layout in device memory and in the program's own files: 16 bytes, little-endian.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Point {
    /// Meters, in the cloud's local frame.
    pub position: [f32; 3],
    /// Packed `r | g << 8 | b << 16 | class << 24`.
    pub rgb_class: u32,
}

impl Point {
    /// Creates a point from a position in meters, a color and a class.
    pub fn new(position: [f32; 3], rgb: [u8; 3], class: u8) -> Self {
        Self { position, rgb_class: u32::from_le_bytes([rgb[0], rgb[1], rgb[2], class]) }
    }

    /// Returns red, green, blue.
    pub fn rgb(&self) -> [u8; 3] {
        let [r, g, b, _] = self.rgb_class.to_le_bytes();
        [r, g, b]
    }

    /// Returns whether all coordinates are finite; other points are never drawn.
    pub fn is_finite(&self) -> bool {
        self.position.iter().all(|v| v.is_finite())
    }

    /// Returns the class, as in the class map.
    pub fn class(&self) -> u8 {
        self.rgb_class.to_le_bytes()[3]
    }
}

/// Axis-aligned bounds of a cloud, meters. NaN coordinates are ignored.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Bounds {
    /// Minimum coordinates.
    pub min: [f32; 3],
    /// Maximum coordinates.
    pub max: [f32; 3],
}

impl Bounds {
    /// Returns the bounds of points; `None` if there are none or all are NaN.
    pub fn of<'p>(points: impl IntoIterator<Item = &'p Point>) -> Option<Self> {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for point in points {
            for axis in 0..3 {
                min[axis] = min[axis].min(point.position[axis]);
                max[axis] = max[axis].max(point.position[axis]);
            }
        }
        (0..3).all(|axis| min[axis] <= max[axis]).then_some(Self { min, max })
    }

    /// Returns the bounds of the points with finite coordinates; `None` if there are none.
    pub(crate) fn of_finite(points: &[Point]) -> Option<Self> {
        Self::of(points.iter().filter(|point| point.is_finite()))
    }

    /// Returns the bounds of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            min: [0, 1, 2].map(|axis| self.min[axis].min(other.min[axis])),
            max: [0, 1, 2].map(|axis| self.max[axis].max(other.max[axis])),
        }
    }

    /// Returns the eight corners, meters.
    pub fn corners(&self) -> [[f32; 3]; 8] {
        std::array::from_fn(|i| {
            std::array::from_fn(|axis| if i >> axis & 1 == 0 { self.min[axis] } else { self.max[axis] })
        })
    }
}
