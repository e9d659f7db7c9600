use serde::Serialize;

/// Number of images, and the first of them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counted {
    /// Number.
    pub count: usize,
    /// File or frame of the first one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<String>,
}

/// Counts of images, after the references.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ImportCounts {
    /// Images that take part, of frames with images of all cameras.
    pub used: usize,
    /// Frames and cameras without an image.
    pub missing: Counted,
    /// Further images of the same frame and camera.
    pub doubled: Counted,
    /// Images of another size than the first one.
    pub wrong_size: Counted,
}

impl Counted {
    /// Adds an item.
    pub fn add(&mut self, name: impl FnOnce() -> String) {
        self.count += 1;
        self.first.get_or_insert_with(name);
    }

    fn merge(&mut self, other: Self) {
        self.count += other.count;
        self.first = self.first.take().or(other.first);
    }
}

impl ImportCounts {
    /// Adds the counts of another clip.
    pub fn merge(&mut self, other: Self) {
        self.used += other.used;
        self.missing.merge(other.missing);
        self.doubled.merge(other.doubled);
        self.wrong_size.merge(other.wrong_size);
    }
}
