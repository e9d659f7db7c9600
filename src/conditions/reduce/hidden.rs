//! Points that a nearer surface would hide if its points were dense: the gaps between the points of a near
//! surface show the surface behind it.

use crate::geometry::ImageSize;

/// Fraction of its depth that a pixel may lie behind the surface in front of it.
const TOLERANCE: f32 = 0.1;
/// Distance that it may lie behind it in addition, meters.
const TOLERANCE_M: f32 = 0.3;
/// Vertical radius of the opening relative to the horizontal one: scan lines are farther apart than the
/// columns of a sweep.
const HEIGHT: usize = 2;

/// Returns the depths `[H, W]` (`f32::INFINITY` where empty); hidden pixels become empty. The surface in
/// front of a pixel is the morphological opening of depth by a rectangle of `2 radius + 1` columns and `4
/// radius + 1` rows: the farthest of the nearest depths of all rectangles, around pixels of the image, that
/// contain the pixel. A pixel is thus hidden only if every such rectangle contains something nearer.
pub(in super::super) fn without_hidden(depth_m: &[f32], size: ImageSize, radius: usize) -> Vec<f32> {
    let width = size.width as usize;
    let radii = [radius, HEIGHT * radius];
    let nearest = extrema(depth_m, width, radii, f32::min);
    let front = extrema(&nearest, width, radii, f32::max);
    let shown = |(depth, front): (&f32, f32)| {
        if *depth <= front * (1.0 + TOLERANCE) + TOLERANCE_M { *depth } else { f32::INFINITY }
    };
    depth_m.iter().zip(front).map(shown).collect()
}

/// Returns the least or greatest value of the rectangle around each pixel, with its radii along rows and
/// columns, as far as it lies inside the image.
fn extrema(values: &[f32], width: usize, radii: [usize; 2], of: fn(f32, f32) -> f32) -> Vec<f32> {
    let rows = |values: &[f32]| -> Vec<f32> {
        values.chunks(width).flat_map(|row| along(row, 1, radii[0], of)).collect()
    };
    along(&rows(values), width, radii[1], of)
}

/// Returns the least or greatest of the values at up to `radius` multiples of `stride` before and behind each
/// place.
fn along(values: &[f32], stride: usize, radius: usize, of: fn(f32, f32) -> f32) -> Vec<f32> {
    let mut result = values.to_vec();
    for shift in (1..=radius).map(|i| i * stride).take_while(|shift| *shift < values.len()) {
        let end = values.len() - shift;
        result[..end].iter_mut().zip(&values[shift..]).for_each(|(a, b)| *a = of(*a, *b));
        result[shift..].iter_mut().zip(&values[..end]).for_each(|(a, b)| *a = of(*a, *b));
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    const EMPTY: f32 = f32::INFINITY;

    fn shown(depth_m: &[f32], height: u32, radius: usize) -> Vec<bool> {
        let size = ImageSize { height, width: depth_m.len() as u32 / height };
        without_hidden(depth_m, size, radius).iter().map(|depth| depth.is_finite()).collect()
    }

    /// A wall at 20 m behind the gaps of a car at 5 m: hidden within the car, visible beside it.
    #[test]
    fn gaps_in_a_near_surface_hide_the_surface_behind() {
        let row = [20.0, 20.0, 20.0, 5.0, 20.0, 5.0, 20.0, EMPTY, 5.0, 20.0, 20.0, 20.0, 20.0];
        let seen = [true, true, true, true, false, true, false, false, true, true, true, true, true];
        assert_eq!(shown(&row, 1, 1), seen);
        assert_eq!(shown(&row, 1, 2), seen);
        // Across rows with half the radius.
        assert_eq!(shown(&row, 13, 1), seen);
        // A rectangle 3 columns wide fits into a gap of 3; one with 5 columns or rows does not.
        let wide = [5.0, 20.0, 20.0, 20.0, 5.0];
        assert_eq!(shown(&wide, 1, 1), [true; 5]);
        assert_eq!(shown(&wide, 1, 2), [true, false, false, false, true]);
        assert_eq!(shown(&wide, 5, 1), [true, false, false, false, true]);
    }

    /// A relief of up to 10 % and 0.3 m is visible through gaps, a second wall behind it is not.
    #[test]
    fn a_wall_close_behind_is_hidden() {
        assert_eq!(shown(&[6.0, 6.9, 6.8, 7.5, 6.0], 1, 2), [true, true, true, false, true]);
    }

    /// By the definition, pixel by pixel: the farthest of the nearest depths of all rectangles that contain
    /// the pixel.
    #[test]
    fn front_surface_is_the_morphological_opening() {
        let (height, width, radius) = (13_usize, 13_usize, 2_usize);
        let depth = |i: usize| if i % 7 == 3 { EMPTY } else { ((i * 7919) % 97) as f32 + 1.0 };
        let depths: Vec<f32> = (0..height * width).map(depth).collect();
        let around = |i: usize| {
            let span = |at: usize, side: usize| at.saturating_sub(radius)..(at + radius + 1).min(side);
            let columns = span(i % width, width);
            let rows = |at: usize| at.saturating_sub(2 * radius)..(at + 2 * radius + 1).min(height);
            rows(i / width).flat_map(move |y| columns.clone().map(move |x| y * width + x))
        };
        let nearest = |i: usize| around(i).map(|j| depths[j]).fold(EMPTY, f32::min);
        let front = |i: usize| around(i).map(nearest).fold(0.0, f32::max);
        let size = ImageSize { height: height as u32, width: width as u32 };
        let found = without_hidden(&depths, size, radius);
        let expected =
            (0..depths.len()).map(|i| if depths[i] <= front(i) * 1.1 + 0.3 { depths[i] } else { EMPTY });
        assert_eq!(found, expected.collect::<Vec<f32>>());
        let hidden = found.iter().zip(&depths).filter(|(found, depth)| found != depth).count();
        assert_eq!(hidden, 128);
    }

    #[test]
    fn slanted_surfaces_and_lone_points_are_visible() {
        let ground: Vec<f32> = (0..40).map(|i| 40.0 / (1.0 + i as f32 * 0.05)).collect();
        // At the border all rectangles reach 4 rows inward, where this slope is nearer by more than the
        // tolerance.
        let visible: Vec<bool> = (0..40).map(|row| row > 1).collect();
        assert_eq!(shown(&ground, 40, 2), visible);
        let lone = [EMPTY, EMPTY, 50.0, EMPTY, EMPTY, 3.0, EMPTY];
        assert_eq!(shown(&lone, 1, 2), [false, false, true, false, false, true, false]);
    }
}
