use super::solids::SolidError;

/// Reason why a sweep could not be rendered.
#[derive(Debug, thiserror::Error)]
pub enum LidarError {
    /// A value of the spec is out of range.
    #[error("expected {expected}, found {found}")]
    Spec {
        /// Accepted values.
        expected: String,
        /// The value.
        found: String,
    },
    /// Surfaces could not be made of points.
    #[error("{0}")]
    Solid(#[from] SolidError),
}
