//! Line rasterization on the host, row by row.
//!
//! # How it works
//! Layouts are mostly black, so visiting all of their pixels would dominate the cost. [`LineRows`] computes
//! the covered columns of each row from [`LineTest`]s, and callers touch only these.

pub(super) mod line_test;

use std::ops::Range;

use self::line_test::LineTest;
use super::Segment;
use crate::geometry::ImageSize;

/// Coverage of lines in an image, row by row.
#[derive(Clone, Debug)]
pub(crate) struct LineRows {
    width: u32,
    /// In drawing order.
    lines: Vec<Line>,
    /// Indices of the lines not reached yet, lowest start row last.
    waiting: Vec<u32>,
    /// Indices of the lines that may intersect the row, in drawing order.
    active: Vec<u32>,
}

#[derive(Clone, Debug)]
struct Line {
    test: LineTest,
    rgb: [u8; 3],
    rows: Range<u32>,
}

impl LineRows {
    /// Prepares segments `width_px` wide with butt ends, later ones over earlier ones, in an image of this
    /// size. A pixel is covered if its center lies in the segment's rectangle. Segments of zero length, with
    /// non-finite coordinates, or outside the image cover nothing.
    pub(crate) fn new(segments: &[Segment], size: ImageSize, width_px: f32) -> Self {
        Self::of_widths(segments.iter().map(|segment| (segment, width_px)), size)
    }

    /// As [`LineRows::new`], for segments of different widths in pixels.
    pub(crate) fn of_widths<'a>(segments: impl Iterator<Item = (&'a Segment, f32)>, size: ImageSize) -> Self {
        let sides = [size.width, size.height];
        let line = |(segment, width_px): (&Segment, f32)| {
            let test = LineTest::new(segment, width_px / 2.0, sides)?;
            Some(Line { test, rgb: segment.rgb, rows: test.rows(size.height) })
        };
        let lines: Vec<Line> = segments.filter_map(line).collect();
        let mut waiting: Vec<u32> = (0..lines.len() as u32).collect();
        waiting.sort_by_key(|number| std::cmp::Reverse(lines[*number as usize].rows.start));
        Self { width: size.width, lines, waiting, active: Vec::new() }
    }

    /// Calls `paint` with the columns and the color of each line in a row, in drawing order. Rows must be
    /// requested in ascending order.
    pub(crate) fn row(&mut self, row: u32, mut paint: impl FnMut(Range<usize>, [u8; 3])) {
        let lines = &self.lines;
        self.active.retain(|number| lines[*number as usize].rows.end > row);
        let met = self.active.len();
        while let Some(number) = self.waiting.pop_if(|number| lines[*number as usize].rows.start <= row) {
            self.active.push(number);
        }
        if self.active.len() > met {
            self.active.sort_unstable();
        }
        for number in &self.active {
            let line = &lines[*number as usize];
            let columns = line.test.columns(row, self.width);
            if !columns.is_empty() {
                paint(columns.start as usize..columns.end as usize, line.rgb);
            }
        }
    }

    /// Draws all rows of a black image with this size.
    pub(crate) fn image(mut self, size: ImageSize) -> Vec<[u8; 3]> {
        let mut image = vec![[0; 3]; size.pixels()];
        for (row, pixels) in (0..size.height).zip(image.chunks_exact_mut(size.width.max(1) as usize)) {
            self.row(row, |columns, rgb| pixels[columns].fill(rgb));
        }
        image
    }
}

/// Draws segments `width_px` wide with butt ends, later ones over earlier ones, on black. A pixel is covered
/// if its center lies in the segment's rectangle. Returns `height * width` RGB pixels.
pub fn draw_lines(segments: &[Segment], size: ImageSize, width_px: f32) -> Vec<[u8; 3]> {
    LineRows::new(segments, size, width_px).image(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference: tests every pixel against every line.
    fn drawn_pixel_by_pixel(segments: &[Segment], size: ImageSize, width_px: f32) -> Vec<[u8; 3]> {
        let mut image = vec![[0; 3]; size.pixels()];
        for segment in segments {
            let Some(line) = LineTest::new(segment, width_px / 2.0, [size.width, size.height]) else {
                continue;
            };
            for (index, pixel) in image.iter_mut().enumerate() {
                let (row, column) = (index as u32 / size.width, index as u32 % size.width);
                if line.covers(column as f32 + 0.5, row as f32 + 0.5) {
                    *pixel = segment.rgb;
                }
            }
        }
        image
    }

    fn below(state: &mut u64, n: u64) -> u64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) % n
    }

    /// Ends in the image, around it, far away, coincident or non-finite; often horizontal, vertical or nearly
    /// so.
    fn random_segment(state: &mut u64) -> Segment {
        let mut end = || -> [f32; 2] {
            let reach = [1.0, 2.0, 100.0, 1e7, 1e30][below(state, 5) as usize];
            std::array::from_fn(|_| {
                let v =
                    (80.0 + (below(state, 1 << 20) as f64 / f64::from(1 << 19) - 1.0) * 80.0 * reach) as f32;
                if below(state, 2) == 0 { v.round() } else { v }
            })
        };
        let (from, mut to) = (end(), end());
        let axis = below(state, 2) as usize;
        match below(state, 8) {
            0 => to = from,
            1 => to[axis] = [f32::NAN, f32::INFINITY][below(state, 2) as usize],
            2 => to[axis] = from[axis],
            3 => to[axis] = from[axis] + [1e-4, -1e-3, 1e-2][below(state, 3) as usize],
            _ => {}
        }
        Segment { from, to, rgb: std::array::from_fn(|_| 1 + below(state, 255) as u8) }
    }

    #[test]
    fn rows_match_the_per_pixel_test() {
        let state = &mut 3;
        let mut covered = 0;
        for round in 0..400 {
            let size =
                ImageSize { height: 1 + below(state, 150) as u32, width: 1 + below(state, 200) as u32 };
            let segments: Vec<Segment> = (0..1 + below(state, 12)).map(|_| random_segment(state)).collect();
            let width_px = [8.0, 1.0, 0.3, 3.5, 40.0][below(state, 5) as usize];
            let expected = drawn_pixel_by_pixel(&segments, size, width_px);
            covered += expected.iter().filter(|p| **p != [0; 3]).count();
            assert_eq!(draw_lines(&segments, size, width_px), expected, "{round}: {segments:?} {width_px}");
        }
        assert!(covered > 100_000, "{covered}");
    }

    #[test]
    fn long_lines_in_large_images_are_exact_too() {
        let size = ImageSize { height: 40, width: 16_384 };
        let line = |from, to| Segment { from, to, rgb: [7; 3] };
        let segments = [
            line([-5.0, 3.0], [16_400.0, 3.001]),
            line([0.3, 37.2], [16_383.9, 12.9]),
            line([16_000.0, -30.0], [16_380.5, 60.0]),
            line([8191.5, 0.0], [8191.75, 40.0]),
        ];
        for width_px in [8.0, 0.7] {
            let expected = drawn_pixel_by_pixel(&segments, size, width_px);
            assert!(draw_lines(&segments, size, width_px) == expected, "{width_px}");
        }
    }

    #[test]
    fn rows_may_be_skipped() {
        let size = ImageSize { height: 60, width: 60 };
        let line = |from, to, rgb| Segment { from, to, rgb };
        let segments = [
            line([5.0, 50.0], [55.0, 8.0], [1; 3]),
            line([0.0, 30.0], [60.0, 30.0], [2; 3]),
            line([20.0, 0.0], [25.0, 60.0], [3; 3]),
        ];
        let image = draw_lines(&segments, size, 6.0);
        let mut rows = LineRows::new(&segments, size, 6.0);
        for row in [2, 3, 29, 31, 58] {
            let mut pixels = vec![[0; 3]; 60];
            rows.row(row, |columns, rgb| pixels[columns].fill(rgb));
            assert_eq!(pixels, image[row as usize * 60..][..60], "{row}");
        }
    }

    #[test]
    fn no_segments_and_invalid_widths_are_black() {
        let size = ImageSize { height: 3, width: 4 };
        assert_eq!(draw_lines(&[], size, 8.0), [[0; 3]; 12]);
        let segment = Segment { from: [0.0; 2], to: [4.0, 3.0], rgb: [9; 3] };
        for width_px in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(draw_lines(&[segment], size, width_px), [[0; 3]; 12]);
        }
    }
}
