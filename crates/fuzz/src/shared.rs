//! Synthetic logs that are shared with the library's test suite.
#![allow(dead_code, clippy::unwrap_used, missing_docs)]

#[path = "../../pskel/tests/suite/av2_log.rs"]
pub(crate) mod av2_log;
#[path = "../../pskel/tests/suite/nuplan_made.rs"]
pub(crate) mod nuplan_made;
