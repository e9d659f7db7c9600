//! Causes of differences between the mask of vehicles from a class map and the true mask.

use point_skeleton::named;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use super::pseudo_label::VEHICLE_CLASS;

/// Depths that differ by more than this are of different surfaces, meters.
const SURFACE_M: f32 = 0.5;

/// Cause of a pixel that is in only one of the two masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MaskDifference {
    /// Missing, beside a pixel without a vehicle.
    MissingEdge,
    /// Missing: no point, or one of a surface behind.
    Gap,
    /// Missing: a point of a surface in front.
    Covered,
    /// Missing: a point of the surface itself, with another class.
    OtherClass,
    /// Added within the reach of a splat from the true mask.
    SplatEdge,
    /// Added by the mask rule farther away.
    Filled,
    /// Added: a vehicle behind a surface that has no points here.
    SeenThrough,
    /// Added: points beside the true vehicle.
    Beside,
}

named!(MaskDifference, "cause of a mask difference" {
    MissingEdge => "missing at edges", "Beside a pixel without a vehicle";
    Gap => "gaps", "No point, or one of a surface behind";
    Covered => "covered", "A point of a surface in front";
    OtherClass => "other class", "A point of the surface with another class";
    SplatEdge => "added at edges", "Within the reach of a splat from the true mask";
    Filled => "filled", "By the mask rule";
    SeenThrough => "seen through", "A vehicle behind a surface without points";
    Beside => "beside", "Points beside the true vehicle";
});

/// Two masks of an image, and the maps that explain their differences; all have the same size.
#[derive(Clone, Copy, Debug)]
pub struct MaskPair<'a> {
    /// Pixels per row.
    pub width: usize,
    /// Mask of vehicles from the class map.
    pub mask: &'a [bool],
    /// Class map.
    pub class: &'a [u8],
    /// Depth map, meters; not positive or not finite where it is empty.
    pub depth_m: &'a [f32],
    /// True mask.
    pub truth: &'a [bool],
    /// True depth, meters.
    pub true_depth_m: &'a [f32],
}

/// Pixel counts of two masks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskDifferences {
    /// Pixels in both masks.
    pub both: u64,
    /// Pixels in one of them, in the order of [`MaskDifference::ALL`].
    pub causes: [u64; MaskDifference::ALL.len()],
}

impl MaskDifferences {
    /// Returns the pixels in at least one of the masks.
    pub fn either(&self) -> u64 {
        self.both + self.causes.iter().sum::<u64>()
    }

    /// Returns a share of the pixels in at least one of the masks; `None` if both are empty.
    pub fn share(&self, pixels: u64) -> Option<f64> {
        let either = self.either();
        (either > 0).then(|| pixels as f64 / either as f64)
    }

    /// Adds the counts of others.
    pub fn join(&mut self, other: &Self) {
        self.both += other.both;
        self.causes.iter_mut().zip(other.causes).for_each(|(sum, count)| *sum += count);
    }

    fn add(&mut self, cause: Option<MaskDifference>) {
        match cause {
            None => self.both += 1,
            Some(cause) => self.causes[cause as usize] += 1,
        }
    }
}

/// Writes the IoU, the pixels of the union, and the share of the union by cause.
impl Serialize for MaskDifferences {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("pixels", &self.either())?;
        map.serialize_entry("iou", &self.share(self.both))?;
        for (cause, count) in MaskDifference::ALL.into_iter().zip(self.causes) {
            map.serialize_entry(cause.name(), &self.share(count))?;
        }
        map.end()
    }
}

impl MaskPair<'_> {
    /// Adds all pixels to the counts of their distance: that of the true vehicle, else of the map.
    /// `band_of` returns the index for a camera depth (meters), `reach_px` how many pixels a splat at a depth
    /// reaches, at least 1.
    pub fn add_to(
        &self,
        bands: &mut [MaskDifferences],
        band_of: impl Fn(f32) -> usize,
        reach_px: impl Fn(f32) -> usize,
    ) {
        for i in (0..self.mask.len()).filter(|&i| self.mask[i] || self.truth[i]) {
            let (depth_m, true_depth_m) = (self.map_depth_m(i), self.true_depth_m[i]);
            let of_map = depth_m.filter(|_| !self.truth[i]);
            if let Some(band) = bands.get_mut(band_of(of_map.unwrap_or(true_depth_m))) {
                band.add(self.cause(i, &reach_px));
            }
        }
    }

    fn map_depth_m(&self, i: usize) -> Option<f32> {
        Some(self.depth_m[i]).filter(|depth_m| depth_m.is_finite() && *depth_m > 0.0)
    }

    /// Returns the cause of a pixel in one of the masks; `None` for both.
    fn cause(&self, i: usize, reach_px: &impl Fn(f32) -> usize) -> Option<MaskDifference> {
        let (depth_m, true_depth_m) = (self.map_depth_m(i), self.true_depth_m[i]);
        Some(match (self.mask[i], self.truth[i]) {
            (true, true) => return None,
            (false, _) if self.is_near(i, 1, false) => MaskDifference::MissingEdge,
            (false, _) => match depth_m {
                Some(depth_m) if depth_m < true_depth_m - SURFACE_M => MaskDifference::Covered,
                Some(depth_m) if depth_m <= true_depth_m + SURFACE_M => MaskDifference::OtherClass,
                _ => MaskDifference::Gap,
            },
            (true, false) if self.is_near(i, depth_m.map_or(1, reach_px), true) => MaskDifference::SplatEdge,
            (true, false) if self.class[i] != VEHICLE_CLASS => MaskDifference::Filled,
            (true, false) => match depth_m {
                Some(depth_m) if true_depth_m < depth_m - SURFACE_M => MaskDifference::SeenThrough,
                _ => MaskDifference::Beside,
            },
        })
    }

    /// Returns whether the true mask has a value within some rows and columns of a pixel.
    fn is_near(&self, i: usize, reach_px: usize, value: bool) -> bool {
        let (x, y) = (i % self.width, i / self.width);
        let columns = x.saturating_sub(reach_px)..(x + reach_px + 1).min(self.width);
        let rows = y.saturating_sub(reach_px)..=y + reach_px;
        let rows = rows.filter_map(|y| self.truth.get(y * self.width..(y + 1) * self.width));
        rows.flat_map(|row| &row[columns.clone()]).any(|truth| *truth == value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of vehicles 10 m away in the middle of 5x9 pixels; each pixel of one mask has another cause.
    #[test]
    fn every_cause_is_recognized() {
        let at = |row: usize, column: usize| row * 9 + column;
        let is_true: Vec<bool> = (0..45).map(|i| (0..5).contains(&(i % 9))).collect();
        let (mut mask, mut class) = (is_true.clone(), vec![0; 45]);
        let (mut depth_m, mut true_depth_m) = (vec![10.0_f32; 45], vec![10.0_f32; 45]);
        is_true.iter().zip(&mut class).for_each(|(is, class)| *class = u8::from(*is));
        let mut differ = |at: usize, of_class: u8, depths_m: [f32; 2]| {
            (mask[at], class[at]) = (!mask[at], of_class);
            [depth_m[at], true_depth_m[at]] = depths_m;
        };
        differ(at(0, 4), 0, [90.0, 10.0]); // missing edge
        differ(at(1, 2), 0, [-300.0, 10.0]); // gap without a point
        differ(at(1, 1), 0, [10.6, 10.0]); // gap
        differ(at(2, 2), 2, [9.4, 10.0]); // covered
        differ(at(3, 2), 0, [10.4, 10.0]); // other class
        differ(at(0, 5), 1, [10.0, 50.0]); // within one pixel
        differ(at(2, 6), 1, [3.0, 50.0]); // within two, as near splats reach
        differ(at(3, 8), 0, [10.0, 50.0]); // filled
        differ(at(0, 8), 1, [10.0, 9.0]); // seen through
        differ(at(4, 8), 1, [10.0, 50.0]); // beside
        let truth = &is_true[..];
        let (mask, class, depth_m, true_depth_m) = (&mask[..], &class[..], &depth_m[..], &true_depth_m[..]);
        let pair = MaskPair { width: 9, mask, class, depth_m, truth, true_depth_m };
        let mut bands = [MaskDifferences::default(); 2];
        let reach_px = |depth_m: f32| if depth_m < 5.0 { 2 } else { 1 };
        pair.add_to(&mut bands, |depth_m| usize::from(depth_m >= 5.0), reach_px);
        assert_eq!(bands[0], MaskDifferences { both: 0, causes: [0, 0, 0, 0, 1, 0, 0, 0] });
        assert_eq!(bands[1], MaskDifferences { both: 20, causes: [1, 2, 1, 1, 1, 1, 1, 1] });
        assert_eq!((bands[1].either(), bands[1].share(bands[1].both)), (29, Some(20.0 / 29.0)));
        assert_eq!(MaskDifferences::default().share(0), None);
    }
}
