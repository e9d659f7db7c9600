use glam::{DVec3, Vec3};
use point_skeleton::hash::between;

use crate::Daylight;

/// Sun, sky and air of an image. Light is linear RGB; `exposure` scales it to the input of the tone curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Unit direction towards the sun, town frame.
    pub towards_sun: DVec3,
    /// Sunlight on a surface that faces the sun.
    pub sun: Vec3,
    /// Light of the sky overhead.
    pub zenith: Vec3,
    /// Light of the sky at the horizon.
    pub horizon: Vec3,
    /// Light reflected from the ground.
    pub ground: Vec3,
    /// Share of the sky with clouds, 0–1.
    pub clouds: f32,
    /// Shift of the cloud pattern.
    pub cloud_shift: f32,
    /// Share of light lost per meter of air.
    pub haze_per_m: f32,
    /// Brightness of lamps and rooms, 0–1.
    pub lamps: f32,
    /// Factor applied to light.
    pub exposure: f32,
    /// Shows bare vertex colors without lighting; the sky is black.
    pub bare: bool,
}

impl Light {
    /// Creates the light for a time of day; the seed selects the sun's position and the clouds.
    pub fn new(daylight: Daylight, seed: u64) -> Self {
        let pick = |number: i64, low: f64, high: f64| between(seed ^ 0x5ca1_ab1e, &[number], low, high);
        let azimuth = pick(0, 0.0, std::f64::consts::TAU);
        let towards = |elevation_deg: f64| {
            let up = elevation_deg.to_radians();
            DVec3::new(up.cos() * azimuth.cos(), up.cos() * azimuth.sin(), up.sin())
        };
        let cloud_shift = pick(2, 0.0, 40.0) as f32;
        match daylight {
            Daylight::Day => Self {
                towards_sun: towards(pick(1, 33.0, 52.0)),
                sun: Vec3::new(3.30, 3.05, 2.65),
                zenith: Vec3::new(0.24, 0.46, 0.95),
                horizon: Vec3::new(0.82, 1.00, 1.18),
                ground: Vec3::new(0.34, 0.32, 0.29),
                clouds: pick(3, 0.15, 0.55) as f32,
                cloud_shift,
                haze_per_m: 0.0012,
                lamps: 0.0,
                exposure: 0.50,
                bare: false,
            },
            Daylight::Dusk => Self {
                towards_sun: towards(pick(1, 7.0, 12.0)),
                sun: Vec3::new(1.75, 0.92, 0.42),
                zenith: Vec3::new(0.13, 0.20, 0.42),
                horizon: Vec3::new(0.78, 0.50, 0.38),
                ground: Vec3::new(0.13, 0.11, 0.11),
                clouds: pick(3, 0.3, 0.6) as f32,
                cloud_shift,
                haze_per_m: 0.0016,
                lamps: 1.0,
                exposure: 0.80,
                bare: false,
            },
            Daylight::Overcast => Self {
                towards_sun: towards(45.0),
                sun: Vec3::ZERO,
                zenith: Vec3::new(0.98, 1.02, 1.08),
                horizon: Vec3::new(0.84, 0.87, 0.91),
                ground: Vec3::new(0.33, 0.33, 0.32),
                clouds: 1.0,
                cloud_shift,
                haze_per_m: 0.0030,
                lamps: 0.15,
                exposure: 0.88,
                bare: false,
            },
        }
    }

    /// Returns a light that disables shading: every surface shows its vertex colors, the sky is black.
    pub fn bare() -> Self {
        Self { bare: true, ..Self::new(Daylight::Overcast, 0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_determines_the_sun() {
        for daylight in [Daylight::Day, Daylight::Dusk, Daylight::Overcast] {
            let [a, again, b] = [1, 1, 2].map(|seed| Light::new(daylight, seed));
            assert!(a == again && a.towards_sun != b.towards_sun, "{daylight:?}");
            assert!((a.towards_sun.length() - 1.0).abs() < 1e-12 && a.towards_sun.z > 0.1);
        }
        let elevation = |daylight| Light::new(daylight, 3).towards_sun.z.asin().to_degrees();
        assert!(elevation(Daylight::Dusk) < 12.0 && elevation(Daylight::Day) > 33.0);
    }
}
