//! Colors of points: the views of a point and the estimate on which they agree.

pub(super) mod estimator;
pub(super) mod views;
