/// Class number of motor vehicles in a class map.
pub const VEHICLE_CLASS: u8 = 1;

/// Returns the mask of motor vehicles that segmentation is compared with (pseudo label): `class == 1` after a
/// morphological closing by 3x3 pixels, as in OpenCV. Class maps are sparse where points are: the closing fills gaps of
/// one or two pixels and retains every pixel of the class. `class` is row by row, with `width` pixels per row; the mask
/// has the same size.
pub fn vehicle_mask(class: &[u8], width: usize) -> Vec<bool> {
    let mask: Vec<bool> = class.iter().map(|class| *class == VEHICLE_CLASS).collect();
    let wider = has_near(&mask, width, true);
    has_near(&wider, width, false).into_iter().map(|has_gap| !has_gap).collect()
}

/// Returns whether a value is among the up to 3x3 pixels of the image around each pixel.
fn has_near(mask: &[bool], width: usize, value: bool) -> Vec<bool> {
    let height = mask.len().checked_div(width).unwrap_or(0);
    let near = |at: usize, length: usize| at.saturating_sub(1)..(at + 2).min(length);
    let pixel = |i: usize| {
        near(i / width, height).any(|y| near(i % width, width).any(|x| mask[y * width + x] == value))
    };
    (0..height * width).map(pixel).collect()
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
    fn masks_by_hand() {
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
