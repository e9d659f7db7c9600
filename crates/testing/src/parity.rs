//! Compares maps with another implementation's by the share of pixels that differ.

/// Layout of several views' maps, `[view, height, width, channel]`.
#[derive(Clone, Copy)]
pub struct Layout {
    pub height: usize,
    pub width: usize,
    pub channels: usize,
    /// Width of the border that is not compared in any view, pixels.
    pub border: usize,
}

/// Returns the share of compared pixels for which `differs` is true in any channel.
pub fn differing<T: Copy>(
    found: &[T],
    expected: &[T],
    layout: Layout,
    differs: impl Fn(T, T) -> bool,
) -> f64 {
    assert_eq!(found.len(), expected.len());
    let Layout { height, width, channels, border } = layout;
    let inside = |at: usize, side: usize| at >= border && at < side - border;
    let (mut compared, mut off) = (0_usize, 0_usize);
    let pixels = found.chunks_exact(channels).zip(expected.chunks_exact(channels)).enumerate();
    for (pixel, (a, b)) in pixels {
        let (row, column) = (pixel / width % height, pixel % width);
        if inside(row, height) && inside(column, width) {
            compared += 1;
            off += usize::from(a.iter().zip(b).any(|(a, b)| differs(*a, *b)));
        }
    }
    assert!(compared > 0, "nothing to compare");
    off as f64 / compared as f64
}

/// Fails if more than `most` of the pixels differ; prints the share in either case.
pub fn assert_parity(what: &str, part: f64, most: f64) {
    eprintln!("{what}: {part:.2e} of the pixels differ, at most {most:.0e} may");
    assert!(part <= most, "{what}: {part:.2e} of the pixels differ, at most {most:.0e} may");
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: Layout = Layout { height: 10, width: 20, channels: 1, border: 1 };

    #[test]
    fn comparator_counts_differing_pixels() {
        let expected = vec![5.0_f32; 400];
        let mut found = expected.clone();
        found[23] = 5.1; // view 0, row 1, column 3
        found[200 + 45] = -300.0; // view 1, row 2
        found[7] = 9.0; // the border does not count
        let part = differing(&found, &expected, SMALL, |a, b| (a - b).abs() > 0.002);
        assert!((part - 2.0 / (2.0 * 8.0 * 18.0)).abs() < 1e-12);
        let rgb = Layout { channels: 3, ..SMALL };
        let mut found = vec![0_u8; 600];
        found[3 * 25..3 * 26].copy_from_slice(&[3, 3, 3]);
        assert!(differing(&found, &[0; 600], rgb, |a, b| a.abs_diff(b) > 2) > 0.0);
    }

    #[test]
    #[should_panic(expected = "of the pixels differ")]
    fn comparator_fails_on_too_many() {
        let part = differing(&[1_u8; 200], &[0; 200], SMALL, |a, b| a != b);
        assert_parity("class", part, 1e-4);
    }
}
