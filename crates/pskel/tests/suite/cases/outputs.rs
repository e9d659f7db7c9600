//! Outputs never replace inputs or files that no run wrote.
