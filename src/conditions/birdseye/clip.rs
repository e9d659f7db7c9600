//! Clipping in pixels, because tiny-skia stores coordinates in few bits.

use glam::DVec2;

/// Margin around the image within which geometry is drawn, pixels; more than the widest line.
const MARGIN_PX: f64 = 8.0;
/// Corners farther away are treated as invalid, pixels.
const FARTHEST_PX: f64 = 1e12;

/// Clips a ring to the image plus a margin (Sutherland and Hodgman 1974). The margin hides the edges that
/// clipping adds. Returns an empty ring if a coordinate is invalid.
pub(super) fn clipped(ring: &[DVec2], side: f64) -> Vec<DVec2> {
    if !ring.iter().all(|corner| corner.abs().max_element() < FARTHEST_PX) {
        return Vec::new();
    }
    let mut ring = ring.to_vec();
    for (axis, border, sign) in
        [0, 1].into_iter().flat_map(|a| [(a, -MARGIN_PX, 1.0), (a, side + MARGIN_PX, -1.0)])
    {
        let room = |p: DVec2| (p[axis] - border) * sign;
        let mut retained = Vec::with_capacity(ring.len() + 2);
        for (i, &to) in ring.iter().enumerate() {
            let from = ring[(i + ring.len() - 1) % ring.len()];
            if (room(from) < 0.0) != (room(to) < 0.0) {
                let mut cut = from + (to - from) * (room(from) / (room(from) - room(to)));
                cut[axis] = border;
                retained.push(cut);
            }
            if room(to) >= 0.0 {
                retained.push(to);
            }
        }
        ring = retained;
    }
    ring
}

/// Clips a segment to the image plus a margin (Liang and Barsky 1984).
pub(super) fn clipped_line([from, to]: [DVec2; 2], side: f64) -> Option<[DVec2; 2]> {
    if ![from, to].iter().all(|end| end.abs().max_element() < FARTHEST_PX) {
        return None;
    }
    let delta = to - from;
    let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
    for axis in [0, 1] {
        for (step, room) in
            [(-delta[axis], from[axis] + MARGIN_PX), (delta[axis], side + MARGIN_PX - from[axis])]
        {
            if step < 0.0 {
                enters = enters.max(room / step);
            } else if step > 0.0 {
                leaves = leaves.min(room / step);
            } else if room < 0.0 {
                return None;
            }
        }
    }
    (enters < leaves).then(|| [from + delta * enters, from + delta * leaves])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_are_cut_at_the_margin() {
        let square = |a: f64, b: f64| [[a, a], [b, a], [b, b], [a, b]].map(DVec2::from).to_vec();
        assert_eq!(clipped(&square(1.0, 9.0), 10.0), square(1.0, 9.0));
        let area = |ring: &[DVec2]| {
            let next = |i: usize| ring[(i + 1) % ring.len()];
            (0..ring.len()).map(|i| ring[i].perp_dot(next(i)) / 2.0).sum::<f64>()
        };
        // The image and its margin span -8..18.
        for (ring, expected) in [
            (square(-1e9, 1e9), 26.0 * 26.0),
            (square(8.0, 1e6), 10.0 * 10.0),
            (square(-100.0, 5.0), 13.0 * 13.0),
            ([[5.0, 5.0], [5.0, 105.0], [-95.0, 5.0]].map(DVec2::from).to_vec(), 13.0 * 13.0),
        ] {
            let cut = clipped(&ring, 10.0);
            assert!((area(&cut) - expected).abs() < 1e-6, "{cut:?}");
            assert!(cut.iter().all(|c| c.min_element() >= -8.0 - 1e-6 && c.max_element() <= 18.0 + 1e-6));
        }
        assert!(clipped(&square(19.0, 1e6), 10.0).is_empty() && clipped(&[], 10.0).is_empty());
        assert!(clipped(&[DVec2::ZERO, DVec2::NAN], 10.0).is_empty());
    }

    #[test]
    fn segments_are_cut_at_the_margin() {
        let ends =
            |line: [[f64; 2]; 2]| clipped_line(line.map(DVec2::from), 10.0).map(|l| l.map(|p| p.to_array()));
        assert_eq!(ends([[0.0, 0.0], [10.0, 5.0]]), Some([[0.0, 0.0], [10.0, 5.0]]));
        assert_eq!(ends([[-108.0, 5.0], [118.0, 5.0]]), Some([[-8.0, 5.0], [18.0, 5.0]]));
        assert_eq!([ends([[-9.0, 0.0], [-9.0, 5.0]]), ends([[-20.0, 3.0], [3.0, -20.0]])], [None; 2]);
    }
}
