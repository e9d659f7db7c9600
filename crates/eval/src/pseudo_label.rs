/// Class number of motor vehicles in a class map.
pub const VEHICLE_CLASS: u8 = 1;

/// Returns the mask of motor vehicles that segmentation is compared with (pseudo label): `class == 1`, blurred by a
/// 3x3 Gaussian (weights 1 2 1 over 4 along each axis, mirrored about the border pixels, as in OpenCV), above 0.5.
/// `class` is row by row, with `width` pixels per row; the mask has the same size. Lines of one pixel and specks
/// vanish.
pub fn vehicle_mask(class: &[u8], width: usize) -> Vec<bool> {
    let height = class.len().checked_div(width).unwrap_or(0);
    let at = |y: usize, x: usize| u16::from(class[y * width + x] == VEHICLE_CLASS);
    let pixel = |y: usize, x: usize| {
        let (left, right) = beside(x, width);
        let across = |y: usize| at(y, left) + 2 * at(y, x) + at(y, right);
        let (above, below) = beside(y, height);
        across(above) + 2 * across(y) + across(below) > 8
    };
    (0..height * width).map(|i| pixel(i / width, i % width)).collect()
}

/// Returns both neighbors along an axis; beyond the border, the one on the other side.
fn beside(at: usize, length: usize) -> (usize, usize) {
    let last = length - 1;
    let before = if at == 0 { 1.min(last) } else { at - 1 };
    let behind = if at == last { last.saturating_sub(1) } else { at + 1 };
    (before, behind)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: [&str; 5]) -> Vec<bool> {
        let class: Vec<u8> = rows.iter().flat_map(|row| row.bytes().map(|b| b - b'0')).collect();
        vehicle_mask(&class, rows[0].len())
    }

    fn text(mask: &[bool], width: usize) -> Vec<String> {
        let row = |row: &[bool]| row.iter().map(|m| if *m { '1' } else { '0' }).collect();
        mask.chunks(width).map(row).collect()
    }

    #[test]
    fn masks_by_hand() {
        // Edges and corners remain; lines and other classes vanish.
        let found = mask(["0000000", "0111010", "0111010", "0111012", "0000010"]);
        assert_eq!(text(&found, 7), ["0000000", "0111000", "0111000", "0111000", "0000000"]);
        // The border is mirrored, so a corner there remains. Holes close, specks vanish.
        let found = mask(["1100010", "1100000", "0100000", "1103000", "1100000"]);
        assert_eq!(text(&found, 7), ["1100000"; 5]);
        assert_eq!(vehicle_mask(&[1], 1), [true]);
        assert_eq!(vehicle_mask(&[], 0), [false; 0]);
    }
}
