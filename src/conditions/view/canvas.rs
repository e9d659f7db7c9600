//! Drawing of text and rectangles into RGB images.

use font8x8::legacy::BASIC_LEGACY;

use crate::conditions::ImageSize;

/// RGB image to draw into; clips drawing to its bounds.
pub struct Canvas {
    /// Size.
    pub size: ImageSize,
    /// Row-major RGB.
    pub pixels: Vec<[u8; 3]>,
}

/// Side of a glyph at scale 1, pixels.
pub(crate) const GLYPH: u32 = 8;

impl Canvas {
    /// Creates a canvas filled with one color.
    pub fn new(size: ImageSize, rgb: [u8; 3]) -> Self {
        Self { size, pixels: vec![rgb; size.width as usize].repeat(size.height as usize) }
    }

    /// Fills a rectangle with one color.
    pub(crate) fn fill(&mut self, at: [u32; 2], size: ImageSize, rgb: [u8; 3]) {
        self.rows(at, size).for_each(|row| row.fill(rgb));
    }

    /// Applies a function to every pixel of a rectangle; the function also gets the position within the
    /// rectangle.
    pub fn map(
        &mut self,
        [left, top]: [u32; 2],
        size: ImageSize,
        mut change: impl FnMut([u8; 3], [u32; 2]) -> [u8; 3],
    ) {
        for (y, row) in (0..).zip(self.rows([left, top], size)) {
            for (x, pixel) in (0..).zip(row) {
                *pixel = change(*pixel, [x, y]);
            }
        }
    }

    /// Copies an image to a position.
    pub(crate) fn blit(&mut self, at: [u32; 2], size: ImageSize, pixels: &[[u8; 3]]) {
        let source = pixels.chunks_exact(size.width.max(1) as usize);
        self.rows(at, size).zip(source).for_each(|(row, from)| row.copy_from_slice(&from[..row.len()]));
    }

    /// Returns the rows of a rectangle.
    fn rows(&mut self, [left, top]: [u32; 2], size: ImageSize) -> impl Iterator<Item = &mut [[u8; 3]]> {
        let width = self.size.width as usize;
        let columns = (left as usize).min(width)..(left as usize + size.width as usize).min(width);
        let rows = self.pixels.chunks_exact_mut(width.max(1));
        rows.skip(top as usize).take(size.height as usize).map(move |row| &mut row[columns.clone()])
    }

    /// Draws ASCII text with `at` as its upper left corner; other characters become `?`. Returns the width,
    /// pixels.
    pub fn text(&mut self, [left, top]: [u32; 2], scale: u32, rgb: [u8; 3], text: &str) -> u32 {
        let side = GLYPH * scale;
        let cell = ImageSize { height: side, width: side };
        for (place, character) in (0..).zip(text.chars()) {
            let code = if character.is_ascii() { character as usize } else { '?' as usize };
            let glyph = BASIC_LEGACY[code];
            // Each row is one byte; its lowest bit is the leftmost pixel.
            let inked = |[x, y]: [u32; 2]| glyph[(y / scale) as usize] >> (x / scale) & 1 == 1;
            self.map([left + place * side, top], cell, |under, at| if inked(at) { rgb } else { under });
        }
        text_width(text, scale)
    }
}

/// Returns the width of a text, pixels.
pub(crate) fn text_width(text: &str, scale: u32) -> u32 {
    text.chars().count() as u32 * GLYPH * scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_drawn_and_cut_off() {
        let mut canvas = Canvas::new(ImageSize { height: 10, width: 12 }, [0; 3]);
        assert_eq!(canvas.text([1, 1], 1, [255; 3], "L\u{e9}"), 16);
        let row =
            |y: usize| (0..12).map(|x| u8::from(canvas.pixels[y * 12 + x] != [0; 3])).collect::<Vec<_>>();
        // The stem of the L is at its left.
        assert_eq!(row(3)[..8], [0, 0, 1, 1, 0, 0, 0, 0]);
        assert_eq!(row(0), [0; 12]);
    }
}
