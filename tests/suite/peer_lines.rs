//! Lines compared with those that Pillow draws (`tests/peers/lines.py`).

use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{Segment, draw_lines};

#[derive(serde::Deserialize)]
struct Peer {
    height: u32,
    width: u32,
    /// End points, x and y; line `i` is drawn with number `i + 1`.
    lines: Vec<[f32; 4]>,
    /// Run lengths: a number, then how many consecutive pixels have it.
    runs: Vec<u16>,
}

/// Returns how many pixels of `number` in one image have no such pixel within 1 px in the other, and their
/// total number.
fn far_off(number: u8, one: &[u8], other: &[u8], width: usize) -> [usize; 2] {
    let pixels: Vec<usize> = (0..one.len()).filter(|i| one[*i] == number).collect();
    let near = |i: &&usize| {
        let (row, column) = (**i / width, **i % width);
        let rows = row.saturating_sub(1)..(row + 2).min(one.len() / width);
        rows.into_iter().any(|y| {
            (column.saturating_sub(1)..(column + 2).min(width)).any(|x| other[y * width + x] == number)
        })
    };
    [pixels.len() - pixels.iter().filter(near).count(), pixels.len()]
}

#[test]
fn lines_lie_within_a_pixel_of_pillows() {
    let peer: Peer = serde_json::from_str(include_str!("../peers/lines.json")).unwrap();
    let runs = peer.runs.chunks_exact(2).flat_map(|run| vec![run[0] as u8; usize::from(run[1])]);
    let expected: Vec<u8> = runs.collect();
    let segment = |(number, [a, b, c, d]): (u8, &[f32; 4])| Segment {
        from: [*a, *b],
        to: [*c, *d],
        rgb: [number, 0, 0],
    };
    let draw = |segments: &[Segment]| -> Vec<u8> {
        let image = draw_lines(segments, ImageSize { height: peer.height, width: peer.width }, 8.0);
        image.iter().map(|rgb| rgb[0]).collect()
    };
    let segments: Vec<Segment> = (1..).zip(&peer.lines).map(segment).collect();
    let found = draw(&segments);
    assert_eq!(found.len(), expected.len());
    // Images that differ: by a shift of 2 px, by the drawing order.
    let shift =
        |s: &Segment| Segment { from: [s.from[0] + 2.0, s.from[1]], to: [s.to[0] + 2.0, s.to[1]], ..*s };
    let shifted = draw(&segments.iter().map(shift).collect::<Vec<_>>());
    let turned = draw(&segments.iter().rev().copied().collect::<Vec<_>>());
    let width = peer.width as usize;
    let worst = |picture: &[u8]| {
        let share = |number: u8| {
            [(picture, expected.as_slice()), (&expected, picture)].map(|(one, other)| {
                let [off, all] = far_off(number, one, other, width);
                assert!(all > 0, "line {number}");
                off as f64 / all as f64
            })
        };
        (1..=peer.lines.len() as u8).flat_map(share).fold(0.0, f64::max)
    };
    assert!(worst(&found) <= 1e-3, "{}", worst(&found));
    assert!(worst(&shifted) > 0.05 && worst(&turned) > 0.05, "{} {}", worst(&shifted), worst(&turned));
}
