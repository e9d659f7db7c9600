/// Pixel counts for the overlap of two masks, over any number of images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Overlap {
    /// Pixels in both masks.
    pub both: u64,
    /// Pixels in at least one mask.
    pub either: u64,
}

impl Overlap {
    /// Adds a pixel that is or is not in each of the two masks.
    pub fn add(&mut self, a: bool, b: bool) {
        self.both += u64::from(a && b);
        self.either += u64::from(a || b);
    }

    /// Adds the pixels of two masks, each given as a map and a predicate; both maps are of one size.
    pub fn add_maps<A, B>(
        &mut self,
        (a, in_a): (&[A], impl Fn(&A) -> bool),
        (b, in_b): (&[B], impl Fn(&B) -> bool),
    ) {
        a.iter().zip(b).for_each(|(a, b)| self.add(in_a(a), in_b(b)));
    }

    /// Adds the pixels of two masks of one size.
    pub fn add_masks(&mut self, a: &[bool], b: &[bool]) {
        a.iter().zip(b).for_each(|(a, b)| self.add(*a, *b));
    }

    /// Adds the counts of another overlap.
    pub fn join(&mut self, other: &Self) {
        self.both += other.both;
        self.either += other.either;
    }

    /// Intersection over union, 0 to 1; `None` if both masks are empty.
    pub fn iou(&self) -> Option<f64> {
        (self.either > 0).then(|| self.both as f64 / self.either as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computes_iou() {
        let mut overlap = Overlap::default();
        assert_eq!(overlap.iou(), None);
        let (a, b) = ([1, 1, 2, 0, 0], [7, 0, 7, 7, 0]);
        overlap.add_maps((&a, |a| *a == 1), (&b, |b| *b == 7));
        assert_eq!((overlap, overlap.iou()), (Overlap { both: 1, either: 4 }, Some(0.25)));
        // Over several images, pixels are summed; the ratios are not averaged.
        overlap.add_maps((&[1; 4], |a| *a == 1), (&[7; 4], |b| *b == 7));
        assert_eq!(overlap.iou(), Some(5.0 / 8.0));
        overlap.join(&Overlap { both: 1, either: 2 });
        overlap.add_masks(&[true, true, false], &[true, false, false]);
        assert_eq!(overlap.iou(), Some(7.0 / 12.0));
        let mut same = Overlap::default();
        same.add_maps((&a, |a| *a > 0), (&a, |a| *a > 0));
        assert_eq!(same.iou(), Some(1.0));
    }
}
