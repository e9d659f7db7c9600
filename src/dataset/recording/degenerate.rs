//! Damaged map records: they are skipped and counted, so that one of them does not cost the map.

use glam::DVec2;

use super::notes::{Counts, count};
use crate::geometry::is_position;

/// Reason for which a record is skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Fault {
    /// Fewer than three corners that are not on a line, or a corner that is no position.
    NoArea,
    /// Fewer than two different points, or a point that is no position.
    NoLength,
    /// A reference to a record that does not exist.
    Dangling,
    /// The identifier of an earlier record.
    Twice,
}

/// Records of a layer that cannot be read at all.
#[derive(Clone, Debug)]
pub(in super::super) struct Unreadable<E> {
    count: usize,
    /// Error of the first one.
    first: Option<E>,
}

impl<E> Default for Unreadable<E> {
    fn default() -> Self {
        Self { count: 0, first: None }
    }
}

impl<E> Unreadable<E> {
    /// Adds a record; the function returns its error.
    pub(in super::super) fn add(&mut self, error: impl FnOnce() -> E) {
        self.count += 1;
        self.first.get_or_insert_with(error);
    }

    /// Counts them, beside `known` records of the layer that can be read.
    ///
    /// # Errors
    /// Returns the first error if there are no others: then the layer has another format.
    pub(in super::super) fn note(self, layer: &str, known: usize, notes: &mut Counts) -> Result<(), E> {
        match self.first {
            Some(error) if known == 0 => Err(error),
            _ => {
                count(notes, &format!("records of {layer} that cannot be read (skipped)"), self.count);
                Ok(())
            }
        }
    }
}

/// Counts a layer that a map lacks.
pub(in super::super) fn note_missing(notes: &mut Counts, layer: &str) {
    count(notes, &format!("maps without {layer}"), 1);
}

/// Returns the corners of a ring without repetitions of the first one at its end.
///
/// # Errors
/// Fails if they span no area.
pub(in super::super) fn ring(mut corners: Vec<DVec2>) -> Result<Vec<DVec2>, Fault> {
    while corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    let spans = || {
        let (first, rest) = corners.split_first()?;
        let along = rest.iter().map(|corner| *corner - *first).find(|side| *side != DVec2::ZERO)?;
        Some(rest.iter().any(|corner| (*corner - *first).perp_dot(along) != 0.0))
    };
    let is_sound = are_positions(&corners) && spans() == Some(true);
    if is_sound { Ok(corners) } else { Err(Fault::NoArea) }
}

/// Returns the points of a line.
///
/// # Errors
/// Fails if they have no length.
pub(in super::super) fn line(points: Vec<DVec2>) -> Result<Vec<DVec2>, Fault> {
    let is_sound = are_positions(&points) && points.windows(2).any(|pair| pair[0] != pair[1]);
    if is_sound { Ok(points) } else { Err(Fault::NoLength) }
}

/// Returns whether all coordinates are finite and within the limit of positions, so that later arithmetic
/// stays finite.
fn are_positions(points: &[DVec2]) -> bool {
    points.iter().all(|point| is_position(point.extend(0.0)))
}

/// Counts a record that is skipped; `layer` is its kind in the map.
pub(in super::super) fn note_fault(notes: &mut Counts, layer: &str, fault: Fault) {
    let what = match fault {
        Fault::NoArea => "without an area",
        Fault::NoLength => "without a length",
        Fault::Dangling => "that refer to a missing record",
        Fault::Twice => "with the identifier of another",
    };
    count(notes, &format!("{layer} {what} (skipped)"), 1);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_need_an_area() {
        let ring = |corners: &[(f64, f64)]| ring(corners.iter().map(|(x, y)| DVec2::new(*x, *y)).collect());
        let triangle = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0)];
        assert_eq!(ring(&triangle).unwrap().len(), 3);
        assert_eq!(
            ring(&[triangle[0], triangle[0], triangle[1], triangle[2], triangle[0]]).unwrap().len(),
            4
        );
        for bad in [
            &[][..],
            &triangle[..2],
            &[triangle[0]; 5],
            &[(0.0, 0.0), (1.0, 1.0), (3.0, 3.0), (2.0, 2.0)],
            &[(0.0, 0.0), (4.0, 0.0), (4.0, f64::NAN)],
            &[(0.0, 0.0), (4.0, 0.0), (f64::INFINITY, 3.0)],
            &[(0.0, 0.0), (4.0, 0.0), (1e150, 3.0)],
        ] {
            assert_eq!(ring(bad), Err(Fault::NoArea), "{bad:?}");
        }
    }

    #[test]
    fn lines_need_a_length() {
        let line = |points: &[(f64, f64)]| line(points.iter().map(|(x, y)| DVec2::new(*x, *y)).collect());
        assert_eq!(line(&[(0.0, 0.0), (0.0, 0.0), (1.0, 0.0)]).unwrap().len(), 3);
        for bad in [
            &[][..],
            &[(1.0, 1.0)],
            &[(1.0, 1.0), (1.0, 1.0)],
            &[(1.0, 1.0), (1.0, f64::NAN)],
            &[(1.0, 1.0), (1e150, 1.0)],
        ] {
            assert_eq!(line(bad), Err(Fault::NoLength), "{bad:?}");
        }
    }
}
