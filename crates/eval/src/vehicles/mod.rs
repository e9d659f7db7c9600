//! Masks of vehicles in images.

pub(super) mod differences;
pub(super) mod masks;
pub(super) mod pseudo_label;
