//! Conditions of frames: how they are rendered, and which of them a network sees.

pub(super) mod condition;
pub(super) mod conditioner;
pub(super) mod frame_conditions;
pub(super) mod preset;
pub(super) mod recipe;
