//! Limits of coordinates and box sizes that files may declare.
//!
//! Everything read from a file is checked against these limits, so that later arithmetic (means and ratios of
//! sizes, squared distances in `f32`) neither overflows nor becomes NaN.

use glam::DVec3;

/// Maximum absolute coordinate, meters. Every map projection and geocentric frame of the Earth fits.
pub const MAX_COORDINATE_M: f64 = 1e8;
/// Maximum side of a box, meters.
pub const MAX_SIDE_M: f64 = 1e5;
/// Minimum side of a box, meters.
pub const MIN_SIDE_M: f64 = 1e-4;

/// Returns whether all coordinates (meters) are finite and at most [`MAX_COORDINATE_M`].
pub fn is_position(position: DVec3) -> bool {
    // Comparisons with NaN are false.
    position.abs().cmple(DVec3::splat(MAX_COORDINATE_M)).all()
}

/// Returns whether all sides (meters) are within [`MIN_SIDE_M`] to [`MAX_SIDE_M`].
pub fn is_size(size: DVec3) -> bool {
    (size.cmpge(DVec3::splat(MIN_SIDE_M)) & size.cmple(DVec3::splat(MAX_SIDE_M))).all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_inclusive_and_nan_is_outside() {
        assert!(is_position(DVec3::new(-1e8, 1e8, 0.0)) && is_size(DVec3::new(1e-4, 1e5, 1.0)));
        for far in [1.000_001e8, -1e20, f64::MAX, f64::INFINITY, f64::NAN] {
            assert!(!is_position(DVec3::new(0.0, far, 0.0)), "{far}");
        }
        for side in [0.0, -1.0, 9e-5, 1.1e5, 1e308, f64::MIN_POSITIVE, f64::INFINITY, f64::NAN] {
            assert!(!is_size(DVec3::new(1.0, side, 1.0)), "{side}");
        }
    }
}
