//! Words for numbers that are not finite, in files of text.

/// Parses the words for NaN and infinity of C, Python and Microsoft's runtime: `nan`, `-nan(ind)`, `1.#QNAN`,
/// `-1.#IND`, `inf`, `Infinity`, `1.#INF`, `1.#J`. `None` for other text.
pub(crate) fn not_finite(text: &str) -> Option<f64> {
    let unsigned = text.trim_start_matches(['-', '+']).to_ascii_lowercase();
    let sign = if text.starts_with('-') { -1.0 } else { 1.0 };
    if matches!(unsigned.as_str(), "inf" | "infinity") || unsigned.starts_with("1.#inf") || unsigned == "1.#j"
    {
        return Some(sign * f64::INFINITY);
    }
    let is_nan = unsigned == "nan" || unsigned.starts_with("nan(") || unsigned.starts_with("1.#");
    is_nan.then_some(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_non_finite_words() {
        for text in [
            "nan",
            "NaN",
            "-nan",
            "+NAN",
            "nan(0x7ff)",
            "nan(snan)",
            "-nan(ind)",
            "1.#QNAN",
            "-1.#IND",
            "-1.#IND00",
            "1.#SNAN",
            "1.#R",
        ] {
            assert!(not_finite(text).unwrap().is_nan(), "{text}");
        }
        for text in ["inf", "+Inf", "INF", "Infinity", "1.#INF", "1.#INF00", "1.#J"] {
            assert_eq!(not_finite(text), Some(f64::INFINITY), "{text}");
            let negative = format!("-{}", text.trim_start_matches('+'));
            assert_eq!(not_finite(&negative), Some(f64::NEG_INFINITY), "{text}");
        }
        for text in ["", "1.5", "nano", "info", "-", "1.", "n/a", "--"] {
            assert_eq!(not_finite(text), None, "{text}");
        }
    }
}
