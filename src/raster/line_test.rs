use super::Segment;

/// The rectangle of a segment: what decides, on the CPU and in `glsl/line.frag` alike, which pixels it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LineTest {
    /// One end, pixels.
    pub(super) from: [f32; 2],
    /// Unit vector along the segment.
    pub(super) along: [f32; 2],
    /// Pixels.
    pub(super) length: f32,
    /// Pixels.
    pub(super) half_width: f32,
}

impl LineTest {
    /// For a segment that can reach a `width × height` image; `None` for one that cannot, one without length, and
    /// numbers that are not finite. What is far outside is cut off first, in `f64`: the rest is small enough for
    /// exact positions in `f32`.
    pub(super) fn new(segment: &Segment, half_width: f32, size: [u32; 2]) -> Option<Self> {
        if !(half_width > 0.0 && half_width.is_finite()) {
            return None;
        }
        // A pixel that is covered is at most half the width away from the line.
        let margin = f64::from(half_width) + 2.0;
        let (from, to) = clip(segment, margin, size)?;
        let d = [to[0] - from[0], to[1] - from[1]];
        let length = (d[0] * d[0] + d[1] * d[1]).sqrt();
        let along = [d[0] / length, d[1] / length];
        (length > 0.0).then_some(Self { from, along, length, half_width })
    }

    /// Whether the centre of a pixel at `x`, `y` lies inside: on the near end and the one side, not on the others.
    pub(super) fn covers(&self, x: f32, y: f32) -> bool {
        let (dx, dy) = (x - self.from[0], y - self.from[1]);
        let along = dx * self.along[0] + dy * self.along[1];
        let across = dy * self.along[0] - dx * self.along[1];
        along >= 0.0 && along < self.length && across >= -self.half_width && across < self.half_width
    }

    /// Columns and rows of a `width × height` image among which all covered pixels are.
    pub(super) fn bounds(&self, size: [u32; 2]) -> [std::ops::Range<u32>; 2] {
        std::array::from_fn(|axis| {
            let (a, b) = (self.from[axis], self.from[axis] + self.along[axis] * self.length);
            let low = (a.min(b) - self.half_width - 1.0).max(0.0) as u32;
            let high = (a.max(b) + self.half_width + 1.0).clamp(0.0, size[axis] as f32) as u32;
            low..high.saturating_add(1).min(size[axis])
        })
    }
}

/// The part of a segment inside the image grown by a margin, cut at one border after the other (Cohen and
/// Sutherland). Ends inside stay as they are.
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

/// Where the way from `inside` to `outside` meets a border; measured from inside, where numbers are small.
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
    fn ends_inside_stay_as_they_are() {
        let line = test([10.0, 20.0], [13.0, 24.0]).unwrap();
        assert_eq!((line.from, line.length, line.along), ([10.0, 20.0], 5.0, [0.6, 0.8]));
    }

    #[test]
    fn far_ends_are_cut_outside_of_the_image() {
        let line = test([-1e30, 25.0], [1e30, 25.0]).unwrap();
        assert_eq!((line.from, line.length), ([-6.0, 25.0], 112.0));
        assert!(line.covers(0.5, 28.5) && line.covers(99.5, 21.5) && !line.covers(50.5, 29.5));
    }

    #[test]
    fn what_cannot_be_drawn_is_none() {
        assert_eq!(test([5.0, 5.0], [5.0, 5.0]), None);
        assert_eq!(test([-50.0, 5.0], [-10.0, 5.0]), None);
        assert_eq!(test([f32::NAN, 5.0], [9.0, 5.0]), None);
        assert_eq!(test([f32::INFINITY, 5.0], [9.0, 5.0]), None);
        assert_eq!(LineTest::new(&Segment { from: [0.0; 2], to: [9.0; 2], rgb: [0; 3] }, 0.0, [9, 9]), None);
    }
}
