use image::RgbImage;

use super::luma::luma;

/// Sums of differences between neighboring pixels, across the borders of blocks and elsewhere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SeamSums {
    /// Across columns, and across rows.
    axes: [AxisSums; 2],
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxisSums {
    border: f64,
    borders: usize,
    other: f64,
    others: usize,
}

impl SeamSums {
    /// Computes the sums of an image for square blocks of `side` pixels: absolute differences of luma.
    pub fn of(image: &RgbImage, side: usize) -> Self {
        let (luma, width) = (luma(image), image.width() as usize);
        let mut sums = Self::default();
        for (i, here) in luma.iter().enumerate() {
            let (right, below) = (i % width + 1, i / width + 1);
            if right < width {
                sums.axes[0].add((luma[i + 1] - here).abs(), right.is_multiple_of(side));
            }
            if let Some(lower) = luma.get(i + width) {
                sums.axes[1].add((lower - here).abs(), below.is_multiple_of(side));
            }
        }
        sums
    }

    /// Adds the sums of other images.
    pub fn join(&mut self, other: &Self) {
        for (sums, other) in self.axes.iter_mut().zip(other.axes) {
            sums.border += other.border;
            sums.borders += other.borders;
            sums.other += other.other;
            sums.others += other.others;
        }
    }

    /// Returns the mean difference across borders relative to elsewhere, for the direction with the larger
    /// one. About 1 without seams; `None` if there is no border or no difference.
    pub fn ratio(&self) -> Option<f64> {
        let [columns, rows] = self.axes.map(|sums| sums.ratio());
        Some(columns?.max(rows?))
    }
}

impl AxisSums {
    fn add(&mut self, difference: f64, is_border: bool) {
        if is_border {
            (self.border, self.borders) = (self.border + difference, self.borders + 1);
        } else {
            (self.other, self.others) = (self.other + difference, self.others + 1);
        }
    }

    fn ratio(&self) -> Option<f64> {
        let has_both = self.borders > 0 && self.others > 0 && self.other > 0.0;
        has_both.then(|| (self.border / self.borders as f64) / (self.other / self.others as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(of: impl Fn(u32, u32) -> u8) -> RgbImage {
        RgbImage::from_fn(16, 12, |x, y| image::Rgb([of(x, y); 3]))
    }

    #[test]
    fn blocks_have_seams_and_ramps_have_none() {
        let ratio = |image: &RgbImage, side| SeamSums::of(image, side).ratio();
        let ramp = gray(|x, y| (5 * x + 3 * y) as u8);
        assert!(ratio(&ramp, 4).is_some_and(|ratio| (ratio - 1.0).abs() < 1e-12));
        // Columns step by 9 at borders and by 3 elsewhere; rows have no seams.
        let steps = gray(|x, y| (3 * x + 6 * (x / 4) + 2 * y) as u8);
        assert!(ratio(&steps, 4).is_some_and(|ratio| (ratio - 3.0).abs() < 1e-12));
        assert_eq!(ratio(&gray(|_, _| 7), 4), None);
        assert_eq!(ratio(&ramp, 16), None);
        let mut both = SeamSums::of(&ramp, 4);
        both.join(&SeamSums::of(&steps, 4));
        // Borders of columns: 5 and 9, others 5 and 3.
        assert!(both.ratio().is_some_and(|ratio| (ratio - 14.0 / 8.0).abs() < 1e-12));
    }
}
