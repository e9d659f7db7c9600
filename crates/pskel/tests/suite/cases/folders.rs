//! Output folders that cannot be renamed or locked.
