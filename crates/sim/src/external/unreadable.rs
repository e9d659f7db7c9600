//! Replies that cannot be parsed.

use crate::peer::begin_of;

/// Describes a reply that is not the expected JSON: its beginning, and what is wrong.
pub(super) fn unreadable(answer: &[u8], error: &serde_json::Error) -> String {
    format!("{} ({error})", begin_of(answer))
}
