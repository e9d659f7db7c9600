use point_skeleton::named;
use serde::Serialize;

/// Class number of motor vehicles in a class map.
pub const VEHICLE_CLASS: u8 = 1;

/// How the mask of vehicles is computed from a class map, which is sparse where points are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskRule {
    /// Morphological closing by 3x3 pixels, with no vehicle beyond the image. It fills gaps of one or two
    /// pixels, retains every pixel of the class and moves no edge.
    #[default]
    Closing,
    /// Gaussian blur of 3x3 pixels as OpenCV's `GaussianBlur(mask, (3, 3), 0)`, then at least half of the
    /// maximum. Source: the paper *Point as Skeleton*, which does not specify the threshold.
    Paper,
}

named!(MaskRule, "mask rule" {
    Closing => "closing", "Closing by 3x3 pixels";
    Paper => "paper", "Gaussian blur of 3x3 pixels, at least half of the maximum, as in the paper";
});

/// Returns the mask of motor vehicles that segmentation is compared with (pseudo label), from `class == 1`.
/// `class` is row by row, with `width` pixels per row; the mask has the same size.
pub fn vehicle_mask(class: &[u8], width: usize, rule: MaskRule) -> Vec<bool> {
    match rule {
        MaskRule::Closing => closed(class, width),
        MaskRule::Paper => blurred(class, width),
    }
}

fn closed(class: &[u8], width: usize) -> Vec<bool> {
    let height = class.len().checked_div(width).unwrap_or(0);
    let is_vehicle = |y: usize, x: usize| y < height && x < width && class[y * width + x] == VEHICLE_CLASS;
    // Pixels with a vehicle among the 3x3 around them, in an image with one more pixel at each side.
    let wider_width = width + 2;
    let wider: Vec<bool> = (0..(height + 2) * wider_width)
        .map(|i| {
            around(i / wider_width, i % wider_width)
                .any(|(y, x)| is_vehicle(y.wrapping_sub(2), x.wrapping_sub(2)))
        })
        .collect();
    (0..height * width)
        .map(|i| around(i / width, i % width).all(|(y, x)| wider[y * wider_width + x]))
        .collect()
}

/// Returns the 3x3 pixels that begin with row `y` and column `x`.
fn around(y: usize, x: usize) -> impl Iterator<Item = (usize, usize)> {
    (y..y + 3).flat_map(move |y| (x..x + 3).map(move |x| (y, x)))
}

/// Weights 1, 2, 1 in both directions. Beyond the image are its pixels, reflected at the center of the outer
/// ones (OpenCV's default).
fn blurred(class: &[u8], width: usize) -> Vec<bool> {
    const HALF: u32 = 8; // of the sum of the weights
    let height = class.len().checked_div(width).unwrap_or(0);
    let weight = |y: usize, x: usize| u32::from(class[y * width + x] == VEHICLE_CLASS);
    let across = |y: usize, x: usize| {
        let [left, right] = neighbors(x, width);
        weight(y, left) + 2 * weight(y, x) + weight(y, right)
    };
    let sum = |y: usize, x: usize| {
        let [above, below] = neighbors(y, height);
        across(above, x) + 2 * across(y, x) + across(below, x)
    };
    (0..height * width).map(|i| sum(i / width, i % width) >= HALF).collect()
}

/// Returns the places before and after `at` of `count`.
fn neighbors(at: usize, count: usize) -> [usize; 2] {
    let before = at.checked_sub(1).unwrap_or(1.min(count - 1));
    let after = if at + 1 < count { at + 1 } else { count.saturating_sub(2) };
    [before, after]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: [&str; 5], rule: MaskRule) -> Vec<String> {
        let class: Vec<u8> = rows.iter().flat_map(|row| row.bytes().map(|b| b - b'0')).collect();
        let width = rows[0].len();
        let row = |row: &[bool]| row.iter().map(|m| if *m { '1' } else { '0' }).collect();
        vehicle_mask(&class, width, rule).chunks(width).map(row).collect()
    }

    #[test]
    fn closing_fills_small_gaps() {
        let mask = |rows| mask(rows, MaskRule::Closing);
        // Sparse points become an area; lines, specks and edges remain as they are; other classes are none.
        let sparse = ["1010100", "0000000", "1010100", "0000002", "1010103"];
        assert_eq!(mask(sparse), ["1111100"; 5]);
        let solid = ["0000000", "0111010", "0111010", "0111010", "0000000"];
        let closed = ["0000000", "0111110", "0111110", "0111110", "0000000"];
        assert_eq!(mask(solid), closed);
        let apart = ["1000010", "0000000", "0000000", "1111111", "0000000"];
        assert_eq!(mask(apart)[3], "1111111");
        assert_eq!(mask(["1000000", "0000000", "0000000", "0000000", "0000001"])[1..4], ["0000000"; 3]);
        assert_eq!(vehicle_mask(&[1], 1, MaskRule::Closing), [true]);
        assert_eq!(vehicle_mask(&[], 0, MaskRule::Closing), [false; 0]);
    }

    /// The expected masks are `cv2.GaussianBlur(255 * mask, (3, 3), 0) > 127` of OpenCV 5.0.
    #[test]
    fn blur_is_that_of_opencv() {
        let mask = |rows| mask(rows, MaskRule::Paper);
        for (rows, expected) in BLURRED {
            assert_eq!(mask(rows), expected, "{rows:?}");
        }
        for (class, width, expected) in [
            (&[1][..], 1, &[true][..]),
            (&[1, 0], 2, &[true, true]),
            (&[1, 0], 1, &[true, true]),
            (&[], 0, &[]),
        ] {
            assert_eq!(vehicle_mask(class, width, MaskRule::Paper), expected, "{class:?}");
        }
    }

    const BLURRED: [([&str; 5], [&str; 5]); 4] = [
        (["1010100", "0000000", "1010100", "0000002", "1010103"], ["0000000"; 5]),
        (
            ["0000000", "0111010", "0111010", "0111010", "0000000"],
            ["0010000", "0111000", "1111111", "0111000", "0010000"],
        ),
        (
            ["1000010", "0000000", "0000000", "1111111", "0000000"],
            ["0000000", "0000000", "0000000", "1111111", "1111111"],
        ),
        (
            ["1100000", "1100011", "0000111", "0000111", "0110010"],
            ["1100001", "1100011", "0000111", "0000111", "0000111"],
        ),
    ];
}
