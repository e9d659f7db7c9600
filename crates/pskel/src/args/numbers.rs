//! Parsers of numeric arguments, with their valid ranges.

use point_skeleton::conditions::ConditionOptions;
use point_skeleton::scene::RATES_HZ;
use point_skeleton::skeleton::{BuildOptions, CHUNK_M};

/// Parses a voxel size.
pub(crate) fn voxel_m(text: &str) -> Result<f64, String> {
    finite(text).filter(|v| BuildOptions::is_voxel_m(*v)).ok_or_else(|| {
        format!("expected meters, 0 (keeps all points) or at least 0.0001 and at most {CHUNK_M}")
    })
}

/// Parses a distance of zero or more meters.
pub(crate) fn margin_m(text: &str) -> Result<f64, String> {
    finite(text).filter(|v| *v >= 0.0).ok_or_else(|| "expected meters, 0 or more".into())
}

/// Parses a distance of more than zero meters that is also finite as `f32`.
pub(crate) fn distance_m(text: &str) -> Result<f64, String> {
    finite(text)
        .filter(|v| ConditionOptions::is_distance_m(*v))
        .ok_or_else(|| "expected meters, more than 0".into())
}

/// Parses a rate of 0.1 to 100 per second.
pub(crate) fn rate_hz(text: &str) -> Result<f64, String> {
    finite(text)
        .filter(|hz| RATES_HZ.contains(hz))
        .ok_or_else(|| "expected a rate of 0.1 to 100 a second".into())
}

/// Parses a number of forecast steps, 1 to 100: all maps of a forecast are in memory at the same time.
pub(crate) fn forecast_steps(text: &str) -> Result<usize, String> {
    let count = text.trim().parse().ok().filter(|count| (1..=100).contains(count));
    count.ok_or_else(|| "expected 1 to 100 plan steps".into())
}

/// Parses a number of points: an integer, also like `4e6`, up to the maximum of one job.
pub(crate) fn points(text: &str) -> Result<usize, String> {
    const MAX_POINTS: u32 = u32::MAX - 1;
    finite(text)
        .filter(|n| n.fract() == 0.0 && (1.0..=f64::from(MAX_POINTS)).contains(n))
        .map(|n| n as usize)
        .ok_or_else(|| format!("expected 1 to {MAX_POINTS} points, like 4000000 or 4e6"))
}

pub(crate) fn finite(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|v: &f64| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_lengths() {
        assert_eq!([voxel_m("0"), voxel_m("0.0001")], [Ok(0.0), Ok(1e-4)]);
        for text in ["0.00001", "-1", "NaN", "inf", "x", ""] {
            assert!(voxel_m(text).is_err(), "{text}");
        }
        assert!(margin_m("0").is_ok() && margin_m("-0.1").is_err() && margin_m("NaN").is_err());
        assert!(distance_m("0").is_err() && distance_m("1e300").is_err() && distance_m("50").is_ok());
    }

    #[test]
    fn parses_factors_and_waits() {}

    #[test]
    fn parses_rates() {
        assert_eq!([rate_hz("6"), rate_hz("0.1"), rate_hz("100")], [Ok(6.0), Ok(0.1), Ok(100.0)]);
        for text in ["0", "0.09", "100.1", "-6", "NaN", "inf", "x", ""] {
            assert!(rate_hz(text).unwrap_err().contains("0.1 to 100"), "{text}");
        }
    }

    #[test]
    fn forecasts_have_a_limit() {
        assert_eq!([forecast_steps("1"), forecast_steps("100")], [Ok(1), Ok(100)]);
        for text in ["0", "101", "-1", "1e9", "99999999999999999999", "2.5", ""] {
            assert!(forecast_steps(text).unwrap_err().contains("1 to 100 plan steps"), "{text}");
        }
    }

    #[test]
    fn parses_point_counts() {
        assert_eq!([points("4000000"), points("4e6"), points("1")], [Ok(4_000_000), Ok(4_000_000), Ok(1)]);
        assert_eq!(points("4294967294"), Ok(4_294_967_294));
        for text in ["0", "-4", "4.5", "4294967295", "1e30", "NaN", "x", ""] {
            assert!(points(text).unwrap_err().contains("1 to 4294967294 points"), "{text}");
        }
    }
}
