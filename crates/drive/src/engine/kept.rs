use super::live::Beginning;
use super::look::Look;
use crate::generated::Mode;
use crate::view::View;

/// What an engine keeps when its log is edited.
pub(super) struct Kept {
    pub(super) view: View,
    pub(super) shown: Shown,
    pub(super) mode: Mode,
    /// Number of the last session of the generator.
    pub(super) session: u64,
    pub(super) frame: u64,
    pub(super) saved: usize,
}

/// What is shown.
pub(super) enum Shown {
    Look(Look),
    Live(Beginning),
}
