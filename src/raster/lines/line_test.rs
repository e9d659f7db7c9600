use std::ops::Range;

use crate::raster::Segment;

/// Margin of rectangles in the search for covered pixels, far above the rounding of `f32`, pixels.
const SLACK_PX: f64 = 0.05;

/// Rectangle of a segment, which determines the pixels that it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct LineTest {
    /// One end, pixels.
    pub(in super::super) from: [f32; 2],
    /// Unit vector along the segment.
    pub(in super::super) along: [f32; 2],
    /// Length, pixels.
    pub(in super::super) length: f32,
    /// Half of the width, pixels.
    pub(in super::super) half_width: f32,
}

impl LineTest {
    /// Creates the test of a segment that can reach a `width × height` image. Returns `None` for segments
    /// that cannot, of zero length, or with non-finite numbers. Parts far outside are clipped first, in
    /// `f64`; the rest is small enough for exact positions in `f32`.
    pub(in super::super) fn new(segment: &Segment, half_width: f32, size: [u32; 2]) -> Option<Self> {
        if !(half_width > 0.0 && half_width.is_finite()) {
            return None;
        }
        // A covered pixel is at most half the width away from the line.
        let margin = f64::from(half_width) + 2.0;
        let (from, to) = clip(segment, margin, size)?;
        let d = [to[0] - from[0], to[1] - from[1]];
        let length = (d[0] * d[0] + d[1] * d[1]).sqrt();
        let along = [d[0] / length, d[1] / length];
        (length > 0.0).then_some(Self { from, along, length, half_width })
    }

    /// Returns whether a pixel center at `x`, `y` lies inside: the near end and one side inclusive, the
    /// others exclusive.
    pub(in super::super) fn covers(&self, x: f32, y: f32) -> bool {
        let (dx, dy) = (x - self.from[0], y - self.from[1]);
        let along = dx * self.along[0] + dy * self.along[1];
        let across = dy * self.along[0] - dx * self.along[1];
        along >= 0.0 && along < self.length && across >= -self.half_width && across < self.half_width
    }

    /// Returns a range of image rows that contains all covered pixels.
    pub(in super::super) fn rows(&self, height: u32) -> Range<u32> {
        let (a, b) = (self.from[1], self.from[1] + self.along[1] * self.length);
        let low = (a.min(b) - self.half_width - 1.0).max(0.0) as u32;
        let high = (a.max(b) + self.half_width + 1.0).clamp(0.0, height as f32) as u32;
        low..high.saturating_add(1).min(height)
    }

    /// Returns the columns that [`LineTest::covers`] accepts in a row. They are contiguous: each of its four
    /// comparisons changes at most once along a row, since rounding is monotonic.
    pub(in super::super) fn columns(&self, row: u32, width: u32) -> Range<u32> {
        let y = row as f32 + 0.5;
        let Some([low, high]) = self.reach(f64::from(y)) else { return 0..0 };
        let mut start = (low - 0.5).floor().clamp(0.0, f64::from(width)) as u32;
        let mut end = (high + 0.5).ceil().clamp(f64::from(start), f64::from(width)) as u32;
        while start < end && !self.covers(start as f32 + 0.5, y) {
            start += 1;
        }
        while start < end && !self.covers((end - 1) as f32 + 0.5, y) {
            end -= 1;
        }
        start..end
    }

    /// Returns the x range of the rectangle at `y`, slightly enlarged; `None` if it is empty.
    fn reach(&self, y: f64) -> Option<[f64; 2]> {
        let [along_x, along_y] = self.along.map(f64::from);
        let (x, dy) = (f64::from(self.from[0]), y - f64::from(self.from[1]));
        let half = f64::from(self.half_width) + SLACK_PX;
        let (along, across) = (dy * along_y, dy * along_x);
        let mut reach = [f64::NEG_INFINITY, f64::INFINITY];
        within(&mut reach, along_x, [-SLACK_PX - along, f64::from(self.length) + SLACK_PX - along])?;
        within(&mut reach, -along_y, [-half - across, half - across])?;
        (reach[0] <= reach[1]).then_some(reach.map(|dx| x + dx))
    }
}

/// Intersects `reach` with the numbers whose product with `factor` lies in a range. Returns `None` if
/// `factor` is zero and the range excludes zero.
fn within(reach: &mut [f64; 2], factor: f64, [low, high]: [f64; 2]) -> Option<()> {
    if factor == 0.0 {
        return (low <= 0.0 && 0.0 <= high).then_some(());
    }
    let (a, b) = (low / factor, high / factor);
    *reach = [reach[0].max(a.min(b)), reach[1].min(a.max(b))];
    Some(())
}

/// Clips a segment to the image grown by a margin, one border after the other (Cohen and Sutherland). Ends
/// inside are unchanged.
fn clip(segment: &Segment, margin: f64, size: [u32; 2]) -> Option<([f32; 2], [f32; 2])> {
    let (mut from, mut to) = (segment.from.map(f64::from), segment.to.map(f64::from));
    if !from.iter().chain(&to).all(|v| v.is_finite()) {
        return None;
    }
    for axis in 0..2 {
        for (border, inward) in [(-margin, 1.0), (f64::from(size[axis]) + margin, -1.0)] {
            let inside = |p: &[f64; 2]| (p[axis] - border) * inward >= 0.0;
            match (inside(&from), inside(&to)) {
                (true, true) => {}
                (false, true) => from = cut(to, from, axis, border),
                (true, false) => to = cut(from, to, axis, border),
                (false, false) => return None,
            }
        }
    }
    Some((from.map(|v| v as f32), to.map(|v| v as f32)))
}

/// Returns the intersection of the line from `inside` to `outside` with a border, computed from `inside`,
/// where numbers are small.
fn cut(inside: [f64; 2], outside: [f64; 2], axis: usize, border: f64) -> [f64; 2] {
    let share = (border - inside[axis]) / (outside[axis] - inside[axis]);
    let mut point = [0, 1].map(|i| inside[i] + (outside[i] - inside[i]) * share);
    point[axis] = border;
    point
}

#[cfg(test)]
mod tests {
    use super::*;

    fn test(from: [f32; 2], to: [f32; 2]) -> Option<LineTest> {
        LineTest::new(&Segment { from, to, rgb: [0; 3] }, 4.0, [100, 50])
    }

    #[test]
    fn ends_inside_are_unchanged() {
        let line = test([10.0, 20.0], [13.0, 24.0]).unwrap();
        assert_eq!((line.from, line.length, line.along), ([10.0, 20.0], 5.0, [0.6, 0.8]));
    }

    #[test]
    fn far_ends_are_clipped_outside_the_image() {
        let line = test([-1e30, 25.0], [1e30, 25.0]).unwrap();
        assert_eq!((line.from, line.length), ([-6.0, 25.0], 112.0));
        assert!(line.covers(0.5, 28.5) && line.covers(99.5, 21.5) && !line.covers(50.5, 29.5));
    }

    #[test]
    fn undrawable_segments_are_none() {
        assert_eq!(test([5.0, 5.0], [5.0, 5.0]), None);
        assert_eq!(test([-50.0, 5.0], [-10.0, 5.0]), None);
        assert_eq!(test([f32::NAN, 5.0], [9.0, 5.0]), None);
        assert_eq!(test([f32::INFINITY, 5.0], [9.0, 5.0]), None);
        assert_eq!(LineTest::new(&Segment { from: [0.0; 2], to: [9.0; 2], rgb: [0; 3] }, 0.0, [9, 9]), None);
    }
}
