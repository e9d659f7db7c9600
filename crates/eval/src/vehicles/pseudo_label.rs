/// Class number of motor vehicles in a class map.
pub const VEHICLE_CLASS: u8 = 1;

/// Returns the mask of motor vehicles that segmentation is compared with (pseudo label): `class == 1` after a
/// morphological closing by 3x3 pixels, with no vehicle beyond the image. Class maps are sparse where points
/// are: the closing fills gaps of one or two pixels, retains every pixel of the class and moves no edge.
/// `class` is row by row, with `width` pixels per row; the mask has the same size.
pub fn vehicle_mask(class: &[u8], width: usize) -> Vec<bool> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: [&str; 5]) -> Vec<String> {
        let class: Vec<u8> = rows.iter().flat_map(|row| row.bytes().map(|b| b - b'0')).collect();
        let width = rows[0].len();
        let row = |row: &[bool]| row.iter().map(|m| if *m { '1' } else { '0' }).collect();
        vehicle_mask(&class, width).chunks(width).map(row).collect()
    }

    #[test]
    fn closing_fills_small_gaps() {
        // Sparse points become an area; lines, specks and edges remain as they are; other classes are none.
        let sparse = ["1010100", "0000000", "1010100", "0000002", "1010103"];
        assert_eq!(mask(sparse), ["1111100"; 5]);
        let solid = ["0000000", "0111010", "0111010", "0111010", "0000000"];
        let closed = ["0000000", "0111110", "0111110", "0111110", "0000000"];
        assert_eq!(mask(solid), closed);
        let apart = ["1000010", "0000000", "0000000", "1111111", "0000000"];
        assert_eq!(mask(apart)[3], "1111111");
        assert_eq!(mask(["1000000", "0000000", "0000000", "0000000", "0000001"])[1..4], ["0000000"; 3]);
        assert_eq!(vehicle_mask(&[1], 1), [true]);
        assert_eq!(vehicle_mask(&[], 0), [false; 0]);
    }
}
