//! Columns of sweeps: their meaning is recognized by content, never guessed from values or lengths.
