//! Pillow's BILINEAR: a triangle filter widened by the scale, so reductions are antialiased.
//!
//! # How it works
//! Layouts are mostly black, and black pixels contribute nothing. So the image is passed row by row as
//! colored spans, and only output pixels that overlap a span are computed: first horizontally, rounded to
//! bytes, then vertically, in Pillow's fixed-point arithmetic. Only a few rows are in memory at a time.

use std::ops::Range;

use rayon::prelude::*;

use crate::bits::Ones;
use crate::geometry::ImageSize;

/// Fraction bits of Pillow's weights.
const PIL_BITS: u32 = 22;
/// Half of the last retained bit, for rounding.
const HALF: u64 = 1 << (PIL_BITS - 1);
/// Shift for the second of two channels in one word.
const SECOND: u32 = 32;

/// Filter weights of one axis, in units of 1/2²². Windows advance monotonically and have the same number of
/// weights.
#[derive(Clone, Debug)]
struct Axis {
    /// First source index of each output.
    first: Vec<u32>,
    /// [`Axis::taps`] weights per output; zero beyond the window.
    weights: Vec<u64>,
    taps: usize,
    /// For each source index, the range of outputs that read it: first and end.
    seen_by: Vec<[u32; 2]>,
}

impl Axis {
    fn new(from: u32, to: u32) -> Self {
        let scale = f64::from(from) / f64::from(to);
        let support = scale.max(1.0);
        let window = |i: u32| {
            let center = (f64::from(i) + 0.5) * scale;
            let first = (center - support + 0.5).max(0.0) as u32;
            let end = ((center + support + 0.5) as u32).min(from);
            (center, first..end)
        };
        let taps = (0..to).map(|i| window(i).1.len()).max().unwrap_or(0);
        let mut axis =
            Self { first: Vec::new(), weights: Vec::new(), taps, seen_by: vec![[to, 0]; from as usize] };
        for i in 0..to {
            let (center, window) = window(i);
            let weight = |s: u32| (1.0 - ((f64::from(s) - center + 0.5) / support).abs()).max(0.0);
            let sum: f64 = window.clone().map(weight).sum();
            let fixed = |s: u32| (weight(s) / sum * f64::from(1 << PIL_BITS) + 0.5) as u64;
            axis.weights.extend(window.clone().map(fixed));
            axis.weights.resize((i as usize + 1) * taps, 0);
            axis.first.push(window.start);
            for seen_by in &mut axis.seen_by[window.start as usize..window.end as usize] {
                *seen_by = [seen_by[0].min(i), i + 1];
            }
        }
        axis
    }

    /// Returns the first source index of an output's window, and its weights.
    fn window(&self, output: usize) -> (usize, &[u64]) {
        (self.first[output] as usize, &self.weights[output * self.taps..][..self.taps])
    }
}

/// Pixel packed in two words: red and green, blue.
type Words = [u64; 2];

fn words([r, g, b]: [u8; 3]) -> Words {
    [u64::from(r) | u64::from(g) << SECOND, u64::from(b)]
}

/// Weighted sum of pixels, rounded to bytes. Weights sum to about 2²², so no channel overflows into its
/// neighbor.
fn weighted<'a>(pixels: impl Iterator<Item = &'a Words>, weights: &[u64]) -> [u8; 3] {
    let mut sum = [HALF | HALF << SECOND, HALF];
    for (pixel, weight) in pixels.zip(weights) {
        sum[0] += pixel[0] * weight;
        sum[1] += pixel[1] * weight;
    }
    let byte = |word: u64| ((word as u32) >> PIL_BITS).min(255) as u8;
    [byte(sum[0]), byte(sum[0] >> SECOND), byte(sum[1])]
}

/// Bit set of columns.
#[derive(Clone, Debug)]
struct Columns(Vec<u64>);

impl Columns {
    fn none(width: u32) -> Self {
        Self(vec![0; width.div_ceil(u64::BITS) as usize])
    }

    fn insert(&mut self, [first, end]: [u32; 2]) {
        let mut at = first;
        while at < end {
            let (word, bit) = (at / u64::BITS, at % u64::BITS);
            let count = (end - at).min(u64::BITS - bit);
            self.0[word as usize] |= (u64::MAX >> (u64::BITS - count)) << bit;
            at += count;
        }
    }

    fn insert_all(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(word, other)| *word |= other);
    }

    fn clear(&mut self) {
        self.0.fill(0);
    }

    /// Visits all columns in ascending order.
    fn each(&self, mut each: impl FnMut(usize)) {
        for (index, word) in self.0.iter().enumerate() {
            Ones(*word).for_each(|bit| each(index * u64::BITS as usize + bit));
        }
    }
}

/// Source row that spans are painted into; black elsewhere.
#[derive(Debug)]
pub(in super::super) struct PaintedRow {
    pixels: Vec<Words>,
    spans: Vec<Range<usize>>,
}

impl PaintedRow {
    /// Paints columns over earlier ones, clipped to the image.
    pub(in super::super) fn fill(&mut self, columns: Range<usize>, rgb: [u8; 3]) {
        let columns = columns.start..columns.end.min(self.pixels.len());
        if !columns.is_empty() {
            self.pixels[columns.clone()].fill(words(rgb));
            self.spans.push(columns);
        }
    }

    /// Paints a row of pixels into a row that is still black.
    fn copy(&mut self, row: &[[u8; 3]]) {
        let colored = |pixel: &[u8; 3]| *pixel != [0; 3];
        let (Some(first), Some(last)) = (row.iter().position(colored), row.iter().rposition(colored)) else {
            return;
        };
        let columns = first..last + 1;
        self.pixels[columns.clone()]
            .iter_mut()
            .zip(&row[columns.clone()])
            .for_each(|(to, rgb)| *to = words(*rgb));
        self.spans.push(columns);
    }
}

/// Row after the horizontal pass; black outside its columns.
#[derive(Clone, Debug)]
struct AcrossRow {
    pixels: Vec<Words>,
    columns: Columns,
}

/// Filter from one size to another.
#[derive(Clone, Debug)]
pub(in super::super) struct PilBilinear {
    from: ImageSize,
    to: ImageSize,
    columns: Axis,
    rows: Axis,
}

impl PilBilinear {
    /// Computes the weights.
    pub(in super::super) fn new(from: ImageSize, to: ImageSize) -> Self {
        let (columns, rows) = (Axis::new(from.width, to.width), Axis::new(from.height, to.height));
        Self { from, to, columns, rows }
    }

    /// Returns the size of the image and of the result.
    pub(in super::super) fn sizes(&self) -> [ImageSize; 2] {
        [self.from, self.to]
    }

    /// Filters an image. `paint` paints one row; it is called for each row once, in ascending order.
    pub(in super::super) fn filter(&self, paint: impl FnMut(u32, &mut PaintedRow)) -> Vec<[u8; 3]> {
        self.part(0..self.to.height as usize, paint)
    }

    /// Computes a range of output rows.
    fn part(&self, outputs: Range<usize>, mut paint: impl FnMut(u32, &mut PaintedRow)) -> Vec<[u8; 3]> {
        let width = self.to.width as usize;
        let mut result = vec![[0; 3]; outputs.len() * width];
        let mut painted = PaintedRow { pixels: vec![[0; 2]; self.from.width as usize], spans: Vec::new() };
        let none = AcrossRow { pixels: vec![[0; 2]; width], columns: Columns::none(self.to.width) };
        // Ring buffer: a source row occupies the slot of its number until no output row needs it.
        let mut across = vec![none; self.rows.taps];
        let mut columns = Columns::none(self.to.width);
        let mut next = 0;
        for (output, pixels) in outputs.zip(result.chunks_exact_mut(width)) {
            let (first, weights) = self.rows.window(output);
            let rows = first..(first + weights.len()).min(self.from.height as usize);
            for row in rows.start.max(next)..rows.end {
                paint(row as u32, &mut painted);
                self.across(&mut painted, &mut across[row % self.rows.taps]);
            }
            next = rows.end;
            let window: Vec<&AcrossRow> = rows.map(|row| &across[row % self.rows.taps]).collect();
            window.iter().for_each(|row| columns.insert_all(&row.columns));
            columns.each(|x| pixels[x] = weighted(window.iter().map(|row| &row.pixels[x]), weights));
            columns.clear();
        }
        result
    }

    /// Filters a row horizontally and resets it to black.
    fn across(&self, from: &mut PaintedRow, to: &mut AcrossRow) {
        to.columns.each(|x| to.pixels[x] = [0; 2]);
        to.columns.clear();
        for span in &from.spans {
            let [first, last] = [span.start, span.end - 1].map(|at| self.columns.seen_by[at]);
            to.columns.insert([first[0], last[1]]);
        }
        to.columns.each(|x| {
            let (first, weights) = self.columns.window(x);
            to.pixels[x] = words(weighted(from.pixels[first..].iter(), weights));
        });
        for span in from.spans.drain(..) {
            from.pixels[span].fill([0; 2]);
        }
    }
}

/// Output rows per parallel task.
const ROWS_AT_ONCE: usize = 32;

/// Filters a whole image of `from.pixels()` pixels.
pub fn pil_bilinear(map: &[[u8; 3]], from: ImageSize, to: ImageSize) -> Vec<[u8; 3]> {
    if from == to {
        return map.to_vec();
    }
    let (filter, width, height) = (PilBilinear::new(from, to), from.width as usize, to.height as usize);
    let part = |part: usize| {
        let outputs = part * ROWS_AT_ONCE..height.min((part + 1) * ROWS_AT_ONCE);
        filter.part(outputs, |row, painted| painted.copy(&map[row as usize * width..][..width]))
    };
    (0..height.div_ceil(ROWS_AT_ONCE)).into_par_iter().flat_map_iter(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::{LineRows, Segment, draw_lines};

    #[test]
    fn span_filter_matches_whole_image_filter() {
        let size = |height, width| ImageSize { height, width };
        let segment = |from, to, rgb| Segment { from, to, rgb };
        for (from, to) in [
            (size(90, 160), size(26, 45)),
            (size(90, 160), size(90, 160)),
            (size(37, 500), size(31, 131)),
            (size(20, 30), size(41, 77)),
            (size(64, 64), size(1, 1)),
        ] {
            let (w, h) = (from.width as f32, from.height as f32);
            let segments = [
                segment([3.0, 2.0], [w - 2.0, h - 4.0], [255, 1, 77]),
                segment([0.0, h / 2.0], [w, h / 2.0], [255; 3]),
                segment([w - 3.0, 0.0], [w - 9.0, h * 0.4], [0, 200, 0]),
                segment([w / 2.0, h], [w / 3.0, h / 3.0], [0; 3]),
            ];
            let mut asked = Vec::new();
            let mut rows = LineRows::new(&segments, from, 5.0);
            let found = PilBilinear::new(from, to).filter(|row, painted| {
                asked.push(row);
                rows.row(row, |columns, rgb| painted.fill(columns, rgb));
            });
            assert!(found == pil_bilinear(&draw_lines(&segments, from, 5.0), from, to), "{from} {to}");
            assert!(found.contains(&[0; 3]) || to.pixels() == 1);
            assert_eq!(asked, (0..from.height).collect::<Vec<_>>());
        }
    }

    #[test]
    fn filters_keep_no_state_between_images() {
        let (from, to) = (ImageSize { height: 30, width: 200 }, ImageSize { height: 10, width: 70 });
        let filter = PilBilinear::new(from, to);
        let white = filter.filter(|_, row| row.fill(0..500, [255; 3]));
        assert!(white.iter().all(|pixel| *pixel == [255; 3]), "columns beyond the image are left out");
        assert!(filter.filter(|_, _| ()).iter().all(|pixel| *pixel == [0; 3]));
        // A single lit row: output rows that do not read it are black.
        let one = filter.filter(|at, row| {
            if at == 15 {
                row.fill(64..130, [255; 3])
            }
        });
        let lit: Vec<usize> = (0..10).filter(|row| one[row * 70..][..70].iter().any(|p| p[0] > 0)).collect();
        assert_eq!(lit, [4, 5]);
        let columns: Vec<usize> = (0..70).filter(|x| one[5 * 70 + x][0] > 0).collect();
        assert_eq!(columns, (22..=45).collect::<Vec<_>>());
    }

    #[test]
    fn column_sets_return_inserted_columns() {
        let mut columns = Columns::none(200);
        for range in [[0, 1], [63, 65], [100, 100], [128, 200], [130, 131]] {
            columns.insert(range);
        }
        let mut found = Vec::new();
        columns.each(|x| found.push(x));
        assert_eq!(found, [0, 63, 64].into_iter().chain(128..200).collect::<Vec<_>>());
        columns.clear();
        columns.each(|x| panic!("{x}"));
    }
}
