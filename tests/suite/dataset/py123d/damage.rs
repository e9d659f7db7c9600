//! Damaged and incomplete logs.
