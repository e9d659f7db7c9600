/// Number of frames in a window of a video.
pub const WINDOW_FRAMES: usize = 15;

/// Features `[N, D]`, a row per image or per window of a video.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureSet {
    columns: usize,
    values: Vec<f64>,
}

impl FeatureSet {
    /// Creates a set from `values`, row by row. `None` if they are not whole rows of `columns` values.
    pub fn new(columns: usize, values: Vec<f64>) -> Option<Self> {
        let whole = values.is_empty() || (columns > 0 && values.len().is_multiple_of(columns));
        whole.then_some(Self { columns, values })
    }

    /// Number of features per row, D.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows, N.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Iterates over the rows, `[D]` each.
    pub fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.columns.max(1))
    }

    /// All values, row by row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Appends a row; the first row sets the row length. Returns `false` and appends nothing if the length
    /// differs.
    pub fn push(&mut self, row: &[f64]) -> bool {
        if self.values.is_empty() {
            self.columns = row.len();
        }
        let fits = row.len() == self.columns;
        if fits {
            self.values.extend_from_slice(row);
        }
        fits
    }

    /// Appends all rows of another set. Returns `false` and appends nothing if their length differs.
    pub fn append(&mut self, other: &Self) -> bool {
        if other.is_empty() {
            return true;
        }
        if self.values.is_empty() {
            self.columns = other.columns;
        }
        let fits = other.columns == self.columns;
        if fits {
            self.values.extend_from_slice(&other.values);
        }
        fits
    }
}

/// Computes features of a video from features `[D]` of one camera's frames in order, `[N, 2·D]`. Each window
/// of [`WINDOW_FRAMES`] frames (stride 1) gives a row: the mean over time of the frames' features, then the
/// mean of the absolute differences between consecutive frames. Windows with a `None` frame are skipped. The
/// result is empty for shorter videos.
pub fn window_features(frames: &[Option<Vec<f64>>]) -> FeatureSet {
    let mut set = FeatureSet::default();
    for window in frames.windows(WINDOW_FRAMES) {
        let whole: Option<Vec<&[f64]>> = window.iter().map(|frame| frame.as_deref()).collect();
        if let Some(whole) = whole {
            set.push(&window_row(&whole));
        }
    }
    set
}

fn window_row(frames: &[&[f64]]) -> Vec<f64> {
    let columns = frames.first().map_or(0, |frame| frame.len());
    let mean = |c: usize| frames.iter().map(|frame| frame[c]).sum::<f64>() / frames.len() as f64;
    let change = |c: usize| {
        frames.windows(2).map(|pair| (pair[1][c] - pair[0][c]).abs()).sum::<f64>() / (frames.len() - 1) as f64
    };
    (0..columns).map(mean).chain((0..columns).map(change)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_rows_of_another_length() {
        assert_eq!(FeatureSet::new(2, vec![1.0; 3]), None);
        assert_eq!(FeatureSet::new(0, vec![1.0]), None);
        let mut set = FeatureSet::new(2, vec![1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!(!set.push(&[1.0]) && set.push(&[5.0, 6.0]));
        assert_eq!((set.len(), set.columns(), set.rows().last().unwrap()), (3, 2, [5.0, 6.0].as_slice()));
        let mut all = FeatureSet::default();
        assert!(all.is_empty() && all.append(&set) && all.append(&FeatureSet::default()));
        assert!(!all.append(&FeatureSet::new(1, vec![0.0]).unwrap()));
        assert_eq!(all, set);
    }

    #[test]
    fn computes_window_features() {
        // The first feature rises by 2 per frame, the second alternates, the third is constant.
        let frame = |i: usize| vec![2.0 * i as f64, (i % 2) as f64, 7.0];
        let mut frames: Vec<Option<Vec<f64>>> = (0..17).map(|i| Some(frame(i))).collect();
        let set = window_features(&frames);
        let rows: Vec<&[f64]> = set.rows().collect();
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[0], [14.0, 7.0 / 15.0, 7.0, 2.0, 1.0, 0.0]);
        assert_eq!(rows[2], [18.0, 7.0 / 15.0, 7.0, 2.0, 1.0, 0.0]);
        assert!(window_features(&frames[..14]).is_empty());
        frames[15] = None;
        assert_eq!(window_features(&frames).len(), 1);
    }
}
