//! What is drawn: the options of maps that a page can change, each of the type that the command line has.

use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;

use point_skeleton::MapOptions;
use point_skeleton::conditions::birdseye::BirdseyeOptions;
use point_skeleton::conditions::{ColorFilter, ConditionOptions, ImageSize, MapKind, MapSet, Occlusion};
use point_skeleton::dataset::{ActorEdits, Appearance};
use point_skeleton::raster::SplatSchedule;
use point_skeleton::scene::{SelectionOptions, SubstituteOptions, TemplateFit};
use point_skeleton::skeleton::AugmentOptions;
use serde::{Deserialize, Deserializer, Serialize};

/// Name of the recorded image among the maps.
pub(crate) const RECORDED: &str = "recorded";
/// Name of the generated image among the maps.
pub(crate) const GENERATED: &str = pskel_sim::report::images::GENERATED;
/// Maps that a page can show, without [`RECORDED`] and [`GENERATED`].
pub(crate) const KINDS: [MapKind; 6] =
    [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance, MapKind::Boxes, MapKind::Map];
/// Size of the maps if the page wants no other.
pub(crate) const SIZE: ImageSize = ImageSize { height: 256, width: 448 };
/// Maximum number of pixels of a map: a recorded image, and a bit.
const MAX_PIXELS: u64 = 1 << 22;
/// Maximum number of maps that a page shows of a camera.
const MAX_MAPS: usize = 8;
/// Maximum number of actors that are hidden, held or replaced.
const MAX_EDITED: usize = 1000;

/// Image format of the maps that are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Codec {
    /// Colors as on the contact sheet, JPEG.
    #[default]
    Jpeg,
    /// The bytes of the files that `pskel render` and `simulate` write.
    Png,
}

/// Bird's-eye view that is sent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Birdseye {
    /// Distance from the ego to the middle of each side, meters, 5 to 500.
    pub(crate) reach_m: f64,
    /// Height and width, pixels, 64 to 2048.
    pub(crate) side_px: u32,
}

/// What is drawn of a state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct View {
    /// Maps of all cameras that are not in `cameras`.
    pub(crate) maps: Vec<Shown>,
    /// Maps of some cameras, by name.
    pub(crate) cameras: BTreeMap<String, Vec<Shown>>,
    /// Height and width of the maps, pixels.
    pub(crate) size: [u32; 2],
    /// Whether maps are rendered at the size of the cameras and then reduced, as for training; slower.
    pub(crate) reduce: bool,
    /// Image format.
    pub(crate) codec: Codec,
    /// Splat radius by depth.
    pub(crate) splat: String,
    /// Radius of the crop around the ego, meters.
    pub(crate) radius_m: f64,
    /// Reduction of color.
    pub(crate) color_filter: ColorFilter,
    /// Actors with more points are rendered with their own points in geometry maps.
    pub(crate) min_actor_points: usize,
    /// Size of templates.
    pub(crate) template_fit: TemplateFit,
    /// Occluders of actors.
    pub(crate) occlusion: Occlusion,
    /// Whether the built-in templates are used.
    pub(crate) default_templates: bool,
    /// Augmentation, as on the command line; `None` for none.
    pub(crate) augment: Option<String>,
    /// Track ids of actors that are not drawn.
    pub(crate) hide: BTreeSet<String>,
    /// Edits of the log's actors.
    #[serde(flatten)]
    pub(crate) edits: ActorEdits,
    /// Bird's-eye view; `None` for none.
    pub(crate) birdseye: Option<Birdseye>,
    #[serde(skip)]
    schedule: SplatSchedule,
    #[serde(skip)]
    augmentation: Option<AugmentOptions>,
}

/// Map that is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shown {
    /// Rendered map.
    Map(MapKind),
    /// Recorded image.
    Recorded,
    /// Generated image.
    Generated,
}

/// What there is beside the maps of every log.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Offered {
    /// Whether the log has an HD map.
    pub(crate) map: bool,
    /// Whether there is a generator.
    pub(crate) generator: bool,
}

/// Change of a view; fields that are not given stay.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct ViewChange {
    maps: Option<MapChoice>,
    size: Option<[u32; 2]>,
    reduce: Option<bool>,
    codec: Option<Codec>,
    splat: Option<String>,
    radius_m: Option<f64>,
    color_filter: Option<String>,
    min_actor_points: Option<usize>,
    template_fit: Option<String>,
    occlusion: Option<String>,
    default_templates: Option<bool>,
    #[serde(deserialize_with = "given")]
    augment: Option<Option<String>>,
    hide: Option<BTreeSet<String>>,
    hold: Option<BTreeMap<String, i64>>,
    replace: Option<BTreeMap<String, String>>,
    #[serde(deserialize_with = "given")]
    birdseye: Option<Option<Birdseye>>,
}

/// Maps of all cameras, or of some.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum MapChoice {
    All(Vec<String>),
    Of(BTreeMap<String, Vec<String>>),
}

/// Distinguishes `null` from a field that is not given.
fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(value: D) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(value).map(Some)
}

impl Shown {
    /// Returns the name in messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Map(kind) => kind.name(),
            Self::Recorded => RECORDED,
            Self::Generated => GENERATED,
        }
    }
}

impl Serialize for Shown {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl FromStr for Shown {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let all = KINDS.map(Self::Map).into_iter().chain([Self::Recorded, Self::Generated]);
        all.clone().find(|shown| shown.name() == name).ok_or_else(|| {
            let names: Vec<&str> = all.map(Self::name).collect();
            format!("expected the maps {}, found {name:?}", names.join(", "))
        })
    }
}

impl Default for View {
    fn default() -> Self {
        let (options, selection) = (ConditionOptions::default(), SelectionOptions::default());
        Self {
            maps: vec![Shown::Map(MapKind::Color)],
            cameras: BTreeMap::new(),
            size: [SIZE.height, SIZE.width],
            reduce: false,
            codec: Codec::Jpeg,
            splat: options.splat.to_string(),
            radius_m: options.radius_m,
            color_filter: options.color_filter,
            min_actor_points: selection.min_actor_points,
            template_fit: selection.template_fit,
            occlusion: options.occlusion,
            default_templates: true,
            augment: None,
            hide: BTreeSet::new(),
            edits: ActorEdits::default(),
            birdseye: Some(Birdseye { reach_m: 50.0, side_px: 480 }),
            schedule: options.splat,
            augmentation: None,
        }
    }
}

impl View {
    /// Returns the view after a change; the view is unchanged if a value is invalid.
    ///
    /// # Errors
    /// Returns what was expected and what was found.
    pub(crate) fn changed(
        &self,
        change: ViewChange,
        cameras: &[&str],
        offered: Offered,
    ) -> Result<Self, String> {
        let mut view = self.clone();
        let parsed = |names: Vec<String>| shown(&names, offered);
        match change.maps {
            Some(MapChoice::All(names)) => (view.maps, view.cameras) = (parsed(names)?, BTreeMap::new()),
            Some(MapChoice::Of(choices)) => {
                for (camera, names) in choices {
                    if !cameras.contains(&camera.as_str()) {
                        return Err(format!("expected a camera of {}, found {camera:?}", cameras.join(", ")));
                    }
                    view.cameras.insert(camera, parsed(names)?);
                }
            }
            None => {}
        }
        if let Some([height, width]) = change.size {
            let pixels = u64::from(height) * u64::from(width);
            if height < 16 || width < 16 || pixels > MAX_PIXELS {
                return Err(format!("expected maps of 16x16 to {MAX_PIXELS} pixels, found {height}x{width}"));
            }
            view.size = [height, width];
        }
        if let Some(text) = change.splat {
            view.schedule = text.parse().map_err(|error| format!("{error}"))?;
            view.splat = view.schedule.to_string();
        }
        if let Some(radius_m) = change.radius_m {
            if !ConditionOptions::is_distance_m(radius_m) {
                return Err(format!("expected a positive radius in meters, found {radius_m}"));
            }
            view.radius_m = radius_m;
        }
        if let Some(text) = change.augment {
            view.augmentation =
                text.as_deref().map(str::parse).transpose().map_err(|error| format!("{error}"))?;
            view.augment = text;
        }
        if let Some(tracks) = change.hide {
            check_count(tracks.len())?;
            view.hide = tracks;
        }
        if let Some(tracks) = change.hold {
            check_count(tracks.len())?;
            view.edits.hold = tracks;
        }
        if let Some(tracks) = change.replace {
            check_count(tracks.len())?;
            view.edits.replace =
                tracks.into_iter().map(|(track, by)| (track, Appearance::from(by.as_str()))).collect();
        }
        if let Some(birdseye) = change.birdseye {
            let fits = |b: &Birdseye| (5.0..=500.0).contains(&b.reach_m) && (64..=2048).contains(&b.side_px);
            if let Some(found) = birdseye.filter(|birdseye| !fits(birdseye)) {
                return Err(format!("expected a view of 5 to 500 m and 64 to 2048 pixels, found {found:?}"));
            }
            view.birdseye = birdseye;
        }
        set(&mut view.color_filter, change.color_filter)?;
        set(&mut view.template_fit, change.template_fit)?;
        set(&mut view.occlusion, change.occlusion)?;
        view.reduce = change.reduce.unwrap_or(view.reduce);
        view.codec = change.codec.unwrap_or(view.codec);
        view.min_actor_points = change.min_actor_points.unwrap_or(view.min_actor_points);
        view.default_templates = change.default_templates.unwrap_or(view.default_templates);
        Ok(view)
    }

    /// Returns the maps of a camera.
    pub(crate) fn shown(&self, camera: &str) -> &[Shown] {
        self.cameras.get(camera).unwrap_or(&self.maps)
    }

    /// Returns the size of the maps.
    pub(crate) fn image_size(&self) -> ImageSize {
        ImageSize { height: self.size[0], width: self.size[1] }
    }

    /// Returns all maps that some of the cameras show.
    pub(crate) fn kinds(&self, cameras: &[&str]) -> MapSet {
        let shown = cameras.iter().flat_map(|camera| self.shown(camera));
        let kinds = shown.filter_map(|shown| match shown {
            Shown::Map(kind) => Some(*kind),
            Shown::Recorded | Shown::Generated => None,
        });
        MapSet::of(&kinds.collect::<Vec<_>>())
    }

    /// Returns the options for rendering some maps.
    pub(crate) fn options(&self, maps: MapSet) -> MapOptions {
        let defaults = ConditionOptions::default();
        let conditions = ConditionOptions {
            maps,
            splat: self.schedule.clone(),
            radius_m: self.radius_m,
            size: (!self.reduce).then_some(self.image_size()),
            out_size: self.reduce.then_some(self.image_size()),
            color_filter: self.color_filter,
            occlusion: self.occlusion,
            depth_bins: point_skeleton::conditions::DepthBins {
                far_m: self.radius_m as f32,
                ..defaults.depth_bins
            },
            ..defaults
        };
        let selection =
            SelectionOptions { min_actor_points: self.min_actor_points, template_fit: self.template_fit };
        MapOptions::new(conditions, selection)
    }

    /// Returns the options for rendering some maps at the size of the recorded cameras.
    pub(crate) fn full_size(&self, maps: MapSet) -> MapOptions {
        let MapOptions { conditions, selection } = self.options(maps);
        MapOptions::new(ConditionOptions { size: None, out_size: None, ..(*conditions).clone() }, selection)
    }

    /// Returns the options of templates and augmentation.
    pub(crate) fn substitutes(&self, library: Option<&std::path::Path>) -> SubstituteOptions {
        SubstituteOptions {
            library: library.map(Into::into),
            use_default: self.default_templates,
            augment: self.augmentation,
            ..SubstituteOptions::default()
        }
    }

    /// Returns the options of the bird's-eye view.
    pub(crate) fn birdseye_options(&self) -> Option<BirdseyeOptions> {
        self.birdseye.map(|Birdseye { reach_m, side_px }| BirdseyeOptions { side_px, reach_m })
    }

    /// Returns the arguments of `pskel render` and `pskel simulate` for the maps of this view, without those
    /// that have their default values.
    pub(crate) fn arguments(&self, maps: MapSet) -> Vec<String> {
        let usual = Self::default();
        let mut arguments = Vec::new();
        let mut add = |name: &str, value: String, is_usual: bool| {
            if !is_usual {
                arguments.extend([format!("--{name}"), value]);
            }
        };
        let names: Vec<&str> =
            KINDS.iter().filter(|kind| maps.contains(**kind)).map(|kind| kind.name()).collect();
        add("maps", names.join(","), names.is_empty());
        let size = if self.reduce { "out-size" } else { "size" };
        add(size, format!("{}x{}", self.size[0], self.size[1]), false);
        add("splat", self.splat.clone(), self.splat == usual.splat);
        add("radius", self.radius_m.to_string(), self.radius_m == usual.radius_m);
        add("color-filter", self.color_filter.to_string(), self.color_filter == usual.color_filter);
        let points = self.min_actor_points;
        add("min-actor-points", points.to_string(), points == usual.min_actor_points);
        add("template-fit", self.template_fit.to_string(), self.template_fit == usual.template_fit);
        add("occlusion", self.occlusion.to_string(), self.occlusion == usual.occlusion);
        let hidden: Vec<&str> = self.hide.iter().map(String::as_str).collect();
        add("hide", hidden.join(","), hidden.is_empty());
        let ActorEdits { hold, replace, .. } = &self.edits;
        let held: Vec<String> = hold.iter().map(|(track, t_us)| format!("{track}@{t_us}")).collect();
        add("hold", held.join(","), held.is_empty());
        let replaced: Vec<String> = replace.iter().map(|(track, by)| format!("{track}={by}")).collect();
        add("replace", replaced.join(","), replaced.is_empty());
        if !self.default_templates {
            arguments.push("--no-default-templates".to_owned());
        }
        if let Some(augment) = &self.augment {
            arguments.push(format!("--augment={augment}"));
        }
        arguments
    }
}

/// Limits the number of edited actors.
fn check_count(tracks: usize) -> Result<(), String> {
    match tracks {
        0..=MAX_EDITED => Ok(()),
        _ => Err(format!("expected at most {MAX_EDITED} actors, found {tracks}")),
    }
}

/// Parses names of maps.
fn shown(names: &[String], offered: Offered) -> Result<Vec<Shown>, String> {
    if names.is_empty() || names.len() > MAX_MAPS {
        return Err(format!("expected 1 to {MAX_MAPS} maps of a camera, found {}", names.len()));
    }
    let shown: Vec<Shown> = names.iter().map(|name| name.parse()).collect::<Result<_, _>>()?;
    if shown.contains(&Shown::Map(MapKind::Map)) && !offered.map {
        return Err("expected maps without \"map\": the log has no HD map".to_owned());
    }
    if shown.contains(&Shown::Generated) && !offered.generator {
        return Err("expected maps without \"generated\": start with --generator".to_owned());
    }
    Ok(shown)
}

/// Sets a value to the one of a name, if it is given.
fn set<T: FromStr>(value: &mut T, name: Option<String>) -> Result<(), String>
where
    T::Err: std::fmt::Display,
{
    if let Some(name) = name {
        *value = name.parse().map_err(|error: T::Err| error.to_string())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(json: &str) -> ViewChange {
        serde_json::from_str(json).unwrap()
    }

    fn changed(json: &str) -> Result<View, String> {
        View::default().changed(change(json), &["A", "B"], Offered::default())
    }

    #[test]
    fn fields_that_are_not_given_stay() {
        let view = changed(r#"{"maps": {"B": ["depth", "recorded"]}, "splat": "10:3,50:0", "hide": ["7"]}"#)
            .unwrap();
        assert_eq!(view.shown("A"), [Shown::Map(MapKind::Color)]);
        assert_eq!(view.shown("B"), [Shown::Map(MapKind::Depth), Shown::Recorded]);
        assert_eq!(view.kinds(&["A", "B"]), MapSet::of(&[MapKind::Color, MapKind::Depth]));
        let other = view
            .changed(change(r#"{"maps": ["class"], "birdseye": null}"#), &["A"], Offered::default())
            .unwrap();
        assert_eq!((other.shown("B"), other.birdseye), (&[Shown::Map(MapKind::Class)][..], None));
        assert_eq!(other.splat, "10:3,50:0");
        let arguments = other.arguments(other.kinds(&["A"])).join(" ");
        assert_eq!(arguments, "--maps class --size 256x448 --splat 10:3,50:0 --hide 7");
    }

    #[test]
    fn edits_of_actors_are_arguments() {
        let json = r#"{"hold": {"a": 5, "b": 7}, "replace": {"a": "b", "c": "template"}, "maps": ["color"]}"#;
        let view = changed(json).unwrap();
        let arguments = view.arguments(MapSet::of(&[MapKind::Color])).join(" ");
        assert_eq!(arguments, "--maps color --size 256x448 --hold a@5,b@7 --replace a=b,c=template");
        let shown = serde_json::to_value(&view).unwrap();
        assert_eq!((&shown["hold"]["b"], &shown["replace"]["c"]), (&7.into(), &"template".into()));
        let undone = view.changed(change(r#"{"hold": {}, "replace": {}}"#), &["A"], Offered::default());
        assert!(undone.unwrap().edits.is_empty());
        let many: Vec<String> = (0..=MAX_EDITED).map(|i| format!("\"{i}\": 0")).collect();
        let message = changed(&format!(r#"{{"hold": {{{}}}}}"#, many.join(","))).unwrap_err();
        assert_eq!(message, "expected at most 1000 actors, found 1001");
    }

    #[test]
    fn wrong_values_are_refused() {
        for (json, expected) in [
            (
                r#"{"maps": ["point"]}"#,
                "expected the maps color, depth, class, instance, boxes, map, recorded, generated, found",
            ),
            (r#"{"maps": ["map"]}"#, "no HD map"),
            (r#"{"maps": []}"#, "1 to 8 maps"),
            (r#"{"maps": {"C": ["color"]}}"#, "a camera of A, B, found \"C\""),
            (r#"{"size": [1, 100]}"#, "found 1x100"),
            (r#"{"size": [60000, 60000]}"#, "found 60000x60000"),
            (r#"{"splat": "x"}"#, "expected a splat schedule"),
            (r#"{"radius_m": -1}"#, "found -1"),
            (r#"{"color_filter": "none"}"#, "the color filter"),
            (r#"{"augment": "share=7"}"#, "share"),
            (r#"{"birdseye": {"reach_m": 1e9, "side_px": 100}}"#, "5 to 500 m"),
        ] {
            let message = changed(json).unwrap_err();
            assert!(message.contains(expected), "{json}: {message}");
        }
        assert!(serde_json::from_str::<ViewChange>(r#"{"size": [1]}"#).is_err());
    }
}
