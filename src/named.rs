//! Names of variants: one trait for values of options, names in files, and error messages.
//!
//! # How it works
//! [`named!`](crate::named!) states the name and the help of each variant in an enum once. The command line,
//! serde and the Python package read them from there, so a new variant needs one row. Variants with data are
//! listed with their default data.

use std::fmt;

/// Type whose variants have names.
pub trait Named: Copy + 'static {
    /// What a variant is, for messages: `rasterizer`.
    const KIND: &'static str;
    /// All variants, in the order of lists.
    const ALL: &'static [Self];

    /// Returns the name of a variant on the command line, in Python, and in files.
    fn name(self) -> &'static str;

    /// Returns a description in one sentence without a period; empty if the name says it all.
    fn help(self) -> &'static str;

    /// Returns the variant with a name.
    ///
    /// # Errors
    /// Returns an error that lists the names if there is none.
    fn from_name(name: &str) -> Result<Self, UnknownName> {
        Self::from_name_in(name, Self::ALL)
    }

    /// Returns the one of some variants that has a name.
    ///
    /// # Errors
    /// Returns an error that lists their names if there is none.
    fn from_name_in(name: &str, variants: &[Self]) -> Result<Self, UnknownName> {
        let found = variants.iter().find(|variant| variant.name() == name);
        found.copied().ok_or_else(|| UnknownName {
            kind: Self::KIND,
            names: variants.iter().map(|variant| variant.name()).collect(),
            found: name.to_owned(),
        })
    }
}

/// Error: an unknown name of a variant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct UnknownName {
    /// What was expected: `rasterizer`.
    pub kind: &'static str,
    /// Accepted names.
    pub names: Vec<&'static str>,
    /// The unknown name.
    pub found: String,
}

impl UnknownName {
    /// Returns what was expected: `the rasterizer auto, compute, graphics or cpu`.
    pub fn expected(&self) -> String {
        match self.names.as_slice() {
            [first @ .., last] if !first.is_empty() => {
                format!("the {} {} or {last}", self.kind, first.join(", "))
            }
            names => format!("the {} {}", self.kind, names.concat()),
        }
    }
}

impl fmt::Display for UnknownName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expected {}, found {:?}", self.expected(), self.found)
    }
}

/// Implements [`Named`], [`Display`](fmt::Display) and [`FromStr`](std::str::FromStr) for an enum, and the
/// inherent `ALL` and `name`, which need no import. A row is `VARIANT => NAME, HELP;`.
#[macro_export]
macro_rules! named {
    ($type:ident, $kind:literal {
        $($(#[$attribute:meta])* $variant:ident $({ $($field:ident: $value:expr),+ })? =>
            $name:literal, $help:expr;)+
    }) => {
        impl $type {
            /// All variants, in the order of lists.
            pub const ALL: [Self; <[Self]>::len(&[
                $($(#[$attribute])* Self::$variant $({ $($field: $value),+ })?),+
            ])] = [$($(#[$attribute])* Self::$variant $({ $($field: $value),+ })?),+];

            /// Returns the name on the command line, in Python, and in files.
            pub const fn name(self) -> &'static str {
                match self {
                    $($(#[$attribute])* Self::$variant $({ $($field: _),+ })? => $name,)+
                }
            }
        }

        impl $crate::named::Named for $type {
            const KIND: &'static str = $kind;
            const ALL: &'static [Self] = &<$type>::ALL;

            fn name(self) -> &'static str {
                <$type>::name(self)
            }

            fn help(self) -> &'static str {
                match self {
                    $($(#[$attribute])* Self::$variant $({ $($field: _),+ })? => $help,)+
                }
            }
        }

        impl ::std::fmt::Display for $type {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                f.pad(self.name())
            }
        }

        impl ::std::str::FromStr for $type {
            type Err = $crate::named::UnknownName;

            fn from_str(text: &str) -> ::std::result::Result<Self, $crate::named::UnknownName> {
                <Self as $crate::named::Named>::from_name(text)
            }
        }
    };
}

/// Implements serde's `Serialize` and `Deserialize` for [`Named`] enums without data: their names. Older
/// names are read too.
#[macro_export]
macro_rules! named_in_files {
    ($type:ident $(, $old:literal => $variant:ident)*) => {
        impl ::serde::Serialize for $type {
            fn serialize<S: ::serde::Serializer>(
                &self,
                serializer: S,
            ) -> ::std::result::Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name())
            }
        }

        impl<'de> ::serde::Deserialize<'de> for $type {
            fn deserialize<D: ::serde::Deserializer<'de>>(
                deserializer: D,
            ) -> ::std::result::Result<Self, D::Error> {
                let name = <::std::string::String as ::serde::Deserialize>::deserialize(deserializer)?;
                match name.as_str() {
                    $($old => ::std::result::Result::Ok(Self::$variant),)*
                    name => name.parse().map_err(::serde::de::Error::custom),
                }
            }
        }
    };
}

#[cfg(test)]
#[allow(unreachable_pub)] // of the macro
mod tests {
    use super::*;

    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Shape {
        Round,
        Flat { sides: u8 },
    }

    named!(Shape, "shape" {
        Round => "round", "Without corners";
        Flat { sides: 4 } => "flat", "";
    });

    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Size {
        Small,
        #[cfg(target_os = "none")]
        Huge,
        Large,
    }

    named!(Size, "size" {
        Small => "small", "";
        #[cfg(target_os = "none")]
        Huge => "huge", "";
        Large => "large", "";
    });
    named_in_files!(Size, "little" => Small);

    #[test]
    fn every_name_parses_to_its_variant() {
        for shape in Shape::ALL {
            assert_eq!(shape.to_string().parse(), Ok(shape));
        }
        assert_eq!(Shape::Flat { sides: 9 }.name(), "flat");
        assert_eq!([Shape::Round.help(), Shape::ALL[1].help()], ["Without corners", ""]);
        assert_eq!(Size::ALL, [Size::Small, Size::Large]);
    }

    #[test]
    fn unknown_names_list_the_known_ones() {
        let message = |name: &str| Shape::from_name(name).unwrap_err().to_string();
        assert_eq!(message("square"), "expected the shape round or flat, found \"square\"");
        let message = Shape::from_name_in("flat", &[Shape::Round]).unwrap_err().to_string();
        assert_eq!(message, "expected the shape round, found \"flat\"");
    }

    #[test]
    fn names_are_those_of_files() {
        assert_eq!(serde_json::to_string(&Size::ALL).unwrap(), r#"["small","large"]"#);
        assert_eq!(
            serde_json::from_str::<Vec<Size>>(r#"["large","little"]"#).unwrap(),
            [Size::Large, Size::Small]
        );
        assert!(serde_json::from_str::<Size>("\"huge\"").unwrap_err().to_string().contains("small or large"));
    }
}
