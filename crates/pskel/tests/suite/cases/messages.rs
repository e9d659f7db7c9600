//! Messages name file, record and field, what was found, and what to do.
