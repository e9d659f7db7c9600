//! The same recordings through other readers.
