use serde::{Deserialize, Serialize};

/// Groups of tokens that attend to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Attend {
    /// All patches of one image.
    #[serde(rename = "s")]
    Space,
    /// A row of patches across all cameras of a frame, side by side.
    #[serde(rename = "v")]
    Views,
    /// One patch location of one camera in all frames of the window.
    #[serde(rename = "t")]
    Time,
}

/// Memory layout of tokens: row `((l V + v) h + y) w + x` of a matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Grid {
    /// Number of frames in the window, L.
    pub(in super::super) frames: usize,
    /// Number of cameras, V.
    pub(in super::super) views: usize,
    /// Number of patch rows, h.
    pub(in super::super) height: usize,
    /// Number of patch columns, w.
    pub(in super::super) width: usize,
}

impl Grid {
    /// Number of tokens, R.
    pub(in super::super) fn rows(&self) -> usize {
        self.frames * self.image_rows()
    }

    /// Number of tokens in a frame.
    pub(in super::super) fn image_rows(&self) -> usize {
        self.views * self.height * self.width
    }

    /// Number of tokens in a group.
    pub(super) fn group_len(&self, attend: Attend) -> usize {
        match attend {
            Attend::Space => self.height * self.width,
            Attend::Views => self.views * self.width,
            Attend::Time => self.frames,
        }
    }

    /// Returns the row of a group's token.
    #[inline]
    pub(super) fn row(&self, attend: Attend, group: usize, token: usize) -> usize {
        match attend {
            Attend::Space => group * self.height * self.width + token,
            Attend::Views => {
                let (frame, y) = (group / self.height, group % self.height);
                let (view, x) = (token / self.width, token % self.width);
                ((frame * self.views + view) * self.height + y) * self.width + x
            }
            Attend::Time => token * self.image_rows() + group,
        }
    }

    /// Returns the group of a row, and the index of its token in the group.
    #[inline]
    pub(super) fn place(&self, attend: Attend, row: usize) -> (usize, usize) {
        match attend {
            Attend::Space => {
                let per_image = self.height * self.width;
                (row / per_image, row % per_image)
            }
            Attend::Views => {
                let (x, rest) = (row % self.width, row / self.width);
                let (y, rest) = (rest % self.height, rest / self.height);
                let (view, frame) = (rest % self.views, rest / self.views);
                (frame * self.height + y, view * self.width + x)
            }
            Attend::Time => (row % self.image_rows(), row / self.image_rows()),
        }
    }
}
