//! Projection of longitude and latitude (WGS 84) to meters of a UTM zone.

use glam::DVec2;
use proj4rs::Proj;
use proj4rs::adaptors::transform_xy;

/// Base EPSG codes; adding the zone number, 1 to 60, gives the code of a zone.
const NORTH: u32 = 32_600;
const SOUTH: u32 = 32_700;

/// UTM zone.
pub(super) struct Utm {
    geographic: Proj,
    projected: Proj,
}

impl Utm {
    /// Creates a zone from a name like `epsg:32611`; `None` if it is not a UTM zone of WGS 84.
    pub(super) fn from_epsg(name: &str) -> Option<Self> {
        let (authority, code) = name.trim().split_once(':')?;
        let code: u32 = code.parse().ok().filter(|_| authority.eq_ignore_ascii_case("epsg"))?;
        let (zone, south) = match code {
            c if (NORTH + 1..=NORTH + 60).contains(&c) => (c - NORTH, ""),
            c if (SOUTH + 1..=SOUTH + 60).contains(&c) => (c - SOUTH, " +south"),
            _ => return None,
        };
        let utm = format!("+proj=utm +zone={zone}{south} +datum=WGS84 +units=m");
        let geographic = Proj::from_proj_string("+proj=longlat +datum=WGS84").ok()?;
        Some(Self { geographic, projected: Proj::from_proj_string(&utm).ok()? })
    }

    /// Projects longitude and latitude in degrees to easting and northing; `None` where the projection is
    /// undefined.
    pub(super) fn project(&self, degrees: DVec2) -> Option<DVec2> {
        let in_range = degrees.is_finite() && degrees.x.abs() <= 180.0 && degrees.y.abs() <= 90.0;
        let (lon_rad, lat_rad) = (degrees.x.to_radians(), degrees.y.to_radians());
        let projected = transform_xy(&self.geographic, &self.projected, lon_rad, lat_rad);
        let (x, y) = projected.ok().filter(|_| in_range)?;
        Some(DVec2::new(x, y)).filter(|p| p.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference values from PROJ 9.5.1 (`Transformer.from_crs(4326, epsg, always_xy=True)`): the four nuPlan
    /// locations, the southern hemisphere, the edge of a zone.
    const EXPECTED: [(u32, [f64; 2], [f64; 2]); 7] = [
        (32_611, [-115.1729, 36.1101], [664451.5679640905, 3997705.8693559715]),
        (32_611, [-115.17272, 36.11027], [664467.4163169947, 3997725.032769178]),
        (32_617, [-79.9959, 40.4406], [585156.96230588, 4477145.419980212]),
        (32_619, [-71.0398, 42.3467], [331985.3642530128, 4690286.167626288]),
        (32_648, [103.7764, 1.2966], [363868.1770835093, 143346.39942356994]),
        (32_733, [18.4241, -33.9249], [816557.7955966464, 6240887.995569803]),
        (32_632, [5.9999, 59.5], [330180.4212608716, 6599561.604583353]),
    ];

    #[test]
    fn coordinates_match_proj() {
        for (code, degrees, expected) in EXPECTED {
            let utm = Utm::from_epsg(&format!("EPSG:{code}")).unwrap();
            let found = utm.project(DVec2::from(degrees)).unwrap();
            let off = found.distance(DVec2::from(expected));
            assert!(off < 1e-6, "{code} {degrees:?}: {off} m");
        }
    }

    #[test]
    fn other_systems_and_places_are_refused() {
        for name in
            ["epsg:4326", "epsg:32600", "epsg:32661", "epsg:32761", "32611", "esri:32611", "epsg:", ""]
        {
            assert!(Utm::from_epsg(name).is_none(), "{name}");
        }
        let utm = Utm::from_epsg("epsg:32611").unwrap();
        for degrees in [[f64::NAN, 36.0], [-115.0, f64::INFINITY], [1e9, 36.0], [-115.0, 91.0]] {
            assert!(utm.project(DVec2::from(degrees)).is_none(), "{degrees:?}");
        }
    }
}
