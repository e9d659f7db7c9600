use serde::{Deserialize, Serialize};

/// Times at which the changes of a script begin and end, as far as they are known, absolute microseconds: one
/// pair per change.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Triggers(pub(super) Vec<[Option<i64>; 2]>);

impl Triggers {
    /// Returns whether there are no changes.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the begin of a change that applies at a time; `None` if it does not.
    pub(super) fn since(&self, change: usize, t_us: i64) -> Option<i64> {
        let [start, end] = self.0.get(change).copied()?;
        start.filter(|start| *start <= t_us && end.is_none_or(|end| t_us < end))
    }
}
