//! Values of options that name a variant of a library type.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use point_skeleton::named::Named;

/// Parser of an option, with the names and help of its values.
#[derive(Clone, Copy)]
pub(crate) struct Names<T: 'static>(&'static [T]);

/// Parses the names of all variants.
pub(crate) fn names<T: Named>() -> Names<T> {
    Names(T::ALL)
}

/// Parses the names of some variants.
pub(crate) fn names_of<T: Named>(variants: &'static [T]) -> Names<T> {
    Names(variants)
}

impl<T: Named + Send + Sync> TypedValueParser for Names<T> {
    type Value = T;

    fn parse_ref(
        &self,
        command: &clap::Command,
        arg: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<T, clap::Error> {
        let name = PossibleValuesParser::new(self.values()).parse_ref(command, arg, value)?;
        T::from_name_in(&name, self.0).map_err(|_| clap::Error::new(clap::error::ErrorKind::InvalidValue))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.values()))
    }
}

impl<T: Named> Names<T> {
    fn values(self) -> impl Iterator<Item = PossibleValue> {
        let value = |variant: &T| (variant.name(), Some(variant.help()).filter(|help| !help.is_empty()));
        self.0.iter().map(value).map(|(name, help)| PossibleValue::new(name).help(help))
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use point_skeleton::cloud::PointFormat;
    use point_skeleton::conditions::{
        BinScale, ColorFilter, DepthEmbedding, LayoutLayers, LineWidth, MapFormat, MapKind,
    };
    use point_skeleton::dataset::{ImageDistortion, MissingData, RingMeaning};
    use point_skeleton::raster::{Occlusion, RasterizerKind};
    use point_skeleton::scene::TemplateFit;
    use point_skeleton::skeleton::{Coloring, TemplateKind};
    use pskel_export::Layout;
    use pskel_sim::{ActorPolicy, EgoKind, Tracking};
    use serde::Serialize;
    use serde::de::DeserializeOwned;

    use super::*;

    /// Checks that every name parses to its variant, and that messages list all names.
    fn check<T: Named + Send + Sync + PartialEq + Debug>() {
        let command = clap::Command::new("test");
        for variant in T::ALL {
            let parsed = names::<T>().parse_ref(&command, None, OsStr::new(variant.name())).unwrap();
            assert_eq!((parsed, T::from_name(variant.name())), (*variant, Ok(*variant)));
        }
        let message = names::<T>().parse_ref(&command, None, OsStr::new("nothing")).unwrap_err().to_string();
        let unknown = T::from_name("nothing").unwrap_err().to_string();
        for variant in T::ALL {
            assert!(
                message.contains(variant.name()) && unknown.contains(variant.name()),
                "{message}{unknown}"
            );
        }
    }

    /// Checks this of an enum whose names are in files.
    fn check_in_files<T>()
    where
        T: Named + Send + Sync + PartialEq + Debug + Serialize + DeserializeOwned,
    {
        check::<T>();
        for variant in T::ALL {
            let text = serde_json::to_string(variant).unwrap();
            assert_eq!(text, format!("{:?}", variant.name()));
            assert_eq!(serde_json::from_str::<T>(&text).unwrap(), *variant);
        }
    }

    #[test]
    fn names_parse_to_their_variants() {
        check::<PointFormat>();
        check::<ImageDistortion>();
        check::<RingMeaning>();
        check::<RasterizerKind>();
        check::<EgoKind>();
        check_in_files::<MapFormat>();
        check_in_files::<MapKind>();
        check_in_files::<BinScale>();
        check_in_files::<DepthEmbedding>();
        check_in_files::<ColorFilter>();
        check_in_files::<LineWidth>();
        check_in_files::<LayoutLayers>();
        check_in_files::<MissingData>();
        check_in_files::<Occlusion>();
        check_in_files::<TemplateFit>();
        check_in_files::<Coloring>();
        check_in_files::<TemplateKind>();
        check_in_files::<Layout>();
        check_in_files::<Tracking>();
        check_in_files::<ActorPolicy>();
    }

    #[cfg(feature = "network")]
    #[test]
    fn names_of_the_generator_parse_to_their_variants() {
        check::<pskel_generate::Strategy>();
        check::<pskel_generate::SamplerOptions>();
        check::<pskel_generate::GuidedConditions>();
        for strategy in pskel_generate::Strategy::ALL {
            let in_files = serde_json::to_string(&strategy).unwrap();
            assert!(in_files.contains(&format!("{:?}", strategy.name())), "{in_files}");
        }
    }
}
