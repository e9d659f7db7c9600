//! Numbers and truth values of the tables as different writers store them: whole numbers as floats, unknown
//! counts as -1 or `null`, `true` as 1, and all of them as text.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Unexpected, Visitor};

use crate::dataset::clock::Unit;
use crate::dataset::limits::MAX_TIME_US;

/// Absolute microseconds, at most [`MAX_TIME_US`] from 1970. Fractions are rounded.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct TimeUs(pub(in super::super) i64);

impl<'de> Deserialize<'de> for TimeUs {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Time;
        impl Visitor<'_> for Time {
            type Value = TimeUs;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("microseconds")
            }

            fn visit_i64<E: Error>(self, t_us: i64) -> Result<TimeUs, E> {
                if t_us.unsigned_abs() > MAX_TIME_US.unsigned_abs() {
                    return Err(far(t_us as f64));
                }
                Ok(TimeUs(t_us))
            }

            fn visit_u64<E: Error>(self, t_us: u64) -> Result<TimeUs, E> {
                i64::try_from(t_us).map_err(|_| far(t_us as f64)).and_then(|t_us| self.visit_i64(t_us))
            }

            fn visit_f64<E: Error>(self, t_us: f64) -> Result<TimeUs, E> {
                // Whole numbers are exact up to 2^53 us, the year 2255, and within 2 us up to the limit.
                match t_us.abs() <= MAX_TIME_US as f64 {
                    true => Ok(TimeUs(t_us.round() as i64)),
                    false => Err(far(t_us)),
                }
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<TimeUs, E> {
                let text = text.trim();
                let number = text.parse().ok().filter(|t_us: &f64| t_us.is_finite());
                match (text.parse::<i64>(), number) {
                    (Ok(t_us), _) => self.visit_i64(t_us),
                    (_, Some(t_us)) => self.visit_f64(t_us),
                    _ => Err(E::invalid_type(Unexpected::Str(text), &self)),
                }
            }
        }
        from.deserialize_any(Time)
    }
}

fn far<E: Error>(t_us: f64) -> E {
    let hint = Unit::MICROS.hint(t_us);
    E::custom(format!("a time of {t_us} us, a thousand years from 1970 or more{hint}"))
}

/// `true` or `false`, also as a number or as text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Truth(pub(in super::super) bool);

impl<'de> Deserialize<'de> for Truth {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct AnyTruth;
        impl Visitor<'_> for AnyTruth {
            type Value = Truth;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a boolean")
            }

            fn visit_bool<E>(self, value: bool) -> Result<Truth, E> {
                Ok(Truth(value))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Truth, E> {
                self.visit_f64(value as f64)
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Truth, E> {
                self.visit_f64(value as f64)
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Truth, E> {
                match value {
                    0.0 => Ok(Truth(false)),
                    1.0 => Ok(Truth(true)),
                    other => Err(E::invalid_value(Unexpected::Float(other), &self)),
                }
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Truth, E> {
                match text.trim().to_ascii_lowercase().as_str() {
                    "true" | "t" | "yes" | "y" => Ok(Truth(true)),
                    "false" | "f" | "no" | "n" => Ok(Truth(false)),
                    other => match other.parse() {
                        Ok(number) => self.visit_f64(number),
                        Err(_) => Err(E::invalid_value(Unexpected::Str(text), &self)),
                    },
                }
            }
        }
        from.deserialize_any(AnyTruth)
    }
}

/// Count or size that may be unknown: a number from 0 to 2³² − 1, as an integer or a float, or anything else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in super::super) enum Whole {
    Known(u32),
    /// The value in the file.
    Other(Box<str>),
}

impl Whole {
    /// Returns the number, if it is known.
    pub(in super::super) fn get(&self) -> Option<u32> {
        match self {
            Self::Known(number) => Some(*number),
            Self::Other(_) => None,
        }
    }

    fn of_f64(value: f64) -> Self {
        let is_whole = value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value);
        if is_whole { Self::Known(value as u32) } else { Self::Other(value.to_string().into()) }
    }
}

impl Default for Whole {
    fn default() -> Self {
        Self::Other("none".into())
    }
}

impl fmt::Display for Whole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Known(number) => number.fmt(f),
            Self::Other(text) => text.fmt(f),
        }
    }
}

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(AnyValue)
    }
}

/// Accepts every value.
struct AnyValue;

impl<'de> Visitor<'de> for AnyValue {
    type Value = Whole;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number")
    }

    fn visit_u64<E>(self, value: u64) -> Result<Whole, E> {
        Ok(u32::try_from(value).map_or_else(|_| Whole::Other(value.to_string().into()), Whole::Known))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Whole, E> {
        Ok(u32::try_from(value).map_or_else(|_| Whole::Other(value.to_string().into()), Whole::Known))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Whole, E> {
        Ok(Whole::of_f64(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<Whole, E> {
        let number = value.trim().parse().ok().map(Whole::of_f64);
        let known = number.filter(|number| number.get().is_some());
        Ok(known.unwrap_or_else(|| Whole::Other(value.chars().take(40).collect::<String>().into())))
    }

    fn visit_bool<E>(self, value: bool) -> Result<Whole, E> {
        Ok(Whole::Other(value.to_string().into()))
    }

    fn visit_unit<E>(self) -> Result<Whole, E> {
        Ok(Whole::Other("null".into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<Whole, A::Error> {
        while array.next_element::<IgnoredAny>()?.is_some() {}
        Ok(Whole::Other("an array".into()))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Whole, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Whole::Other("an object".into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::json::parsed;

    #[test]
    fn whole_numbers_may_be_floats() {
        let whole = |text: &str| parsed::<Whole>(text.as_bytes()).unwrap();
        for (text, number) in
            [("7", 7), ("7.0", 7), ("0", 0), ("-0.0", 0), ("4294967295", u32::MAX), ("\"7\"", 7)]
        {
            assert_eq!(whole(text), Whole::Known(number), "{text}");
        }
        for (text, found) in [
            ("-1", "-1"),
            ("7.5", "7.5"),
            ("4294967296", "4294967296"),
            ("1e300", "1000"),
            ("null", "null"),
            ("NaN", "NaN"),
            ("true", "true"),
            ("[1, [2]]", "an array"),
            ("{\"a\": 1}", "an object"),
            ("\"many\"", "many"),
        ] {
            assert!(whole(text).to_string().starts_with(found), "{text}");
            assert_eq!(whole(text).get(), None, "{text}");
        }
    }

    #[test]
    fn fractions_of_microseconds_are_rounded() {
        let time = |text: &str| parsed::<TimeUs>(text.as_bytes()).map(|t| t.0);
        for (text, t_us) in [
            ("1557858039302414", 1_557_858_039_302_414),
            ("1557858039302414.0", 1_557_858_039_302_414),
            ("1557858039302414.25", 1_557_858_039_302_414),
            ("1557858039302414.75", 1_557_858_039_302_415),
            ("1.5578580393024145e15", 1_557_858_039_302_415),
            ("-0.2", 0),
            ("\"1557858039302414\"", 1_557_858_039_302_414),
            ("\" 1557858039302414.75 \"", 1_557_858_039_302_415),
        ] {
            assert_eq!(time(text), Ok(t_us), "{text}");
        }
        for (text, found) in [
            ("NaN", "NaN instead of microseconds"),
            ("null", "null instead of microseconds"),
            ("\"noon\"", "\"noon\" instead of microseconds"),
            ("\"\"", "instead of microseconds"),
            ("\"inf\"", "inf instead of microseconds"),
            ("1e20", "a time of 100000000000000000000 us, a thousand years from 1970 or more"),
            ("18446744073709551615", "a thousand years"),
        ] {
            assert!(time(text).unwrap_err().contains(found), "{text}: {:?}", time(text));
        }
    }

    #[test]
    fn booleans_have_many_spellings() {
        let truth = |text: &str| parsed::<Truth>(text.as_bytes()).map(|truth| truth.0);
        for text in ["true", "1", "1.0", "\"True\"", "\"1\"", "\" yes\"", "\"T\""] {
            assert_eq!(truth(text), Ok(true), "{text}");
        }
        for text in ["false", "0", "-0.0", "\"False\"", "\"0\"", "\"no\"", "\"0.0\""] {
            assert_eq!(truth(text), Ok(false), "{text}");
        }
        for text in ["2", "-1", "NaN", "\"maybe\"", "\"\"", "null", "[]"] {
            assert!(
                truth(text).unwrap_err().contains("instead of true or false"),
                "{text}: {:?}",
                truth(text)
            );
        }
    }
}
