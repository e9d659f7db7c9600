//! Rays, and what they meet.

use glam::DVec3;

/// Rays of an instant from a point: a column of a device, for example.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarRays {
    /// Time after the state's, seconds.
    pub after_s: f64,
    /// Meters, global frame.
    pub origin: DVec3,
    /// Unit vectors, global frame. Casting is fast if all are near a half-plane.
    pub directions: Vec<DVec3>,
}

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarHit {
    /// Meters along the ray.
    pub range_m: f64,
    /// Coarse class, as in class maps.
    pub class: u8,
    /// Actor number, as in instance maps.
    pub instance: u32,
}
