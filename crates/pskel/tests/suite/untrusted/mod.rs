//! Data from strangers: files and names that must not do harm.

pub(super) mod files;
pub(super) mod guarded;
pub(super) mod names;
