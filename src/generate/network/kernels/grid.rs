use serde::{Deserialize, Serialize};

/// Which tokens see each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Attend {
    /// All of one image.
    #[serde(rename = "s")]
    Space,
    /// A row of patches through all cameras of a frame, which stand side by side.
    #[serde(rename = "v")]
    Views,
    /// One place of one camera in all frames of the window.
    #[serde(rename = "t")]
    Time,
}

/// How tokens lie in memory: row `(((b L + l) V + v) h + y) w + x` of a matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Grid {
    /// Windows, B.
    pub(in super::super) windows: usize,
    /// Frames of a window, L.
    pub(in super::super) frames: usize,
    /// Cameras, V.
    pub(in super::super) views: usize,
    /// Patches down, h.
    pub(in super::super) height: usize,
    /// Patches across, w.
    pub(in super::super) width: usize,
}

impl Grid {
    /// Tokens, R.
    pub(in super::super) fn rows(&self) -> usize {
        self.windows * self.frames * self.image_rows()
    }

    /// Tokens of a frame.
    pub(in super::super) fn image_rows(&self) -> usize {
        self.views * self.height * self.width
    }

    /// Tokens that see each other.
    pub(super) fn group_len(&self, attend: Attend) -> usize {
        match attend {
            Attend::Space => self.height * self.width,
            Attend::Views => self.views * self.width,
            Attend::Time => self.frames,
        }
    }

    /// Row of a group's token.
    #[inline]
    pub(super) fn row(&self, attend: Attend, group: usize, token: usize) -> usize {
        match attend {
            Attend::Space => group * self.height * self.width + token,
            Attend::Views => {
                let (frame, y) = (group / self.height, group % self.height);
                let (view, x) = (token / self.width, token % self.width);
                ((frame * self.views + view) * self.height + y) * self.width + x
            }
            Attend::Time => {
                let per_frame = self.image_rows();
                ((group / per_frame) * self.frames + token) * per_frame + group % per_frame
            }
        }
    }

    /// The group of a row, and which of its tokens it is.
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
            Attend::Time => {
                let per_frame = self.image_rows();
                let (frame, place) = (row / per_frame, row % per_frame);
                ((frame / self.frames) * per_frame + place, frame % self.frames)
            }
        }
    }
}
