//! Categories: words of data sets, and the class, layout color and templates that they stand for.
//!
//! nuScenes names categories by dotted groups (`vehicle.car`), other data sets by single words (`car`,
//! `other_vehicle`, `Pedestrian`). [`CategoryKind::of`] is the only place that interprets either.

#[cfg(feature = "av2")]
pub(super) mod argoverse;
mod words;

use serde::{Deserialize, Serialize};

pub(crate) use words::CategoryKind;
use words::{ADJECTIVES, GROUPS, VAGUE, WORDS};

/// Coarse class of a point or actor, as in the class map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Class {
    /// No object, or background.
    #[default]
    None = 0,
    /// Vehicle with four or more wheels, including trailers.
    MotorVehicle = 1,
    /// Person on foot, or pushing or riding something without pedals. In Argoverse 2 also the riders of
    /// cycles.
    Pedestrian = 2,
    /// Bicycle or motorcycle.
    Cycle = 3,
    /// Any other annotated object: cones, barriers, animals ...
    Object = 4,
}

impl Class {
    /// All classes, by number.
    pub const ALL: [Self; 5] = [Self::None, Self::MotorVehicle, Self::Pedestrian, Self::Cycle, Self::Object];

    /// Returns the class of a category; unknown words are objects.
    pub fn from_category(category: &str) -> Self {
        CategoryKind::of(category).map_or(Self::Object, CategoryKind::class)
    }
}

use CategoryKind::{
    AnyVehicle, Bicycle, Bus, Car, Construction, Emergency, Motorcycle, Object, Pedestrian, Trailer, Truck,
};

impl CategoryKind {
    /// Returns what a category stands for; `None` for unknown words. Upper case, spaces, `_`, `-`, `/`, `:`,
    /// plurals and remarks in parentheses are ignored; between a group of nuScenes and the rest they stand
    /// for a dot.
    pub(crate) fn of(category: &str) -> Option<Self> {
        Self::of_dotted(category).or_else(|| dotted(category).and_then(|category| Self::of_dotted(&category)))
    }

    fn of_dotted(category: &str) -> Option<Self> {
        let parts: Vec<String> = category.split('.').map(plain).collect();
        let (group, rest) = parts.split_first()?;
        if rest.is_empty() {
            return of_word(group);
        }
        match group.as_str() {
            "animal" => return Some(Object),
            "movableobject" | "staticobject" | "object" => {
                let mut words = rest.iter().filter(|word| !ADJECTIVES.contains(&word.as_str()));
                return Some(words.find_map(|word| of_word(word)).unwrap_or(Object));
            }
            _ => {}
        }
        let decisive = [(Bicycle, "bicycle"), (Motorcycle, "motorcycle"), (Pedestrian, "pedestrian")];
        let found = decisive.into_iter().find(|(_, word)| parts.iter().any(|part| part == word));
        if let Some((kind, _)) = found {
            return Some(kind);
        }
        // `other` is a vehicle here.
        let below = |word: &String| of_word(&format!("{word}vehicle")).or(of_vehicle(word));
        let vehicle = if group == "vehicle" { rest.iter().find_map(below) } else { None };
        vehicle.or_else(|| parts.iter().find_map(|word| of_word(word)))
    }

    /// Returns the coarse class.
    pub(crate) fn class(self) -> Class {
        match self {
            Car | Truck | Bus | Trailer | Construction | Emergency | AnyVehicle => Class::MotorVehicle,
            Pedestrian => Class::Pedestrian,
            Bicycle | Motorcycle => Class::Cycle,
            Object => Class::Object,
        }
    }
}

/// Returns the kind of a word below `vehicle`.
fn of_vehicle(word: &str) -> Option<CategoryKind> {
    of_word(word).filter(|_| !VAGUE.contains(&word))
}

/// Returns a category with dots in place of other separators after a group of nuScenes; `None` if it has
/// none. A rest that is known as a whole stays whole, like `bicycle_rack`.
fn dotted(category: &str) -> Option<String> {
    const SEPARATORS: [char; 5] = ['_', '/', ':', '-', ' '];
    let category = category.trim().to_lowercase();
    let (group, rest) = GROUPS.iter().find_map(|group| Some((group, category.strip_prefix(group)?)))?;
    let rest = rest.strip_prefix(SEPARATORS)?.trim_start_matches(SEPARATORS);
    let is_known = of_word(&plain(rest)).is_some();
    Some(format!("{group}.{}", if is_known { rest.to_owned() } else { rest.replace(SEPARATORS, ".") }))
}

/// Returns a part of a category as in [`WORDS`].
fn plain(part: &str) -> String {
    let part = part.split('(').next().unwrap_or_default().to_lowercase();
    // Waymo's names in protocol buffers.
    let part = part.strip_prefix("type_").unwrap_or(&part);
    part.chars().filter(|c| !matches!(c, ' ' | '_' | '-' | '/' | ':')).collect()
}

/// Returns the kind of a word or its plural.
fn of_word(word: &str) -> Option<CategoryKind> {
    let exact = |word: &str| WORDS.iter().find(|(_, words)| words.contains(&word)).map(|(kind, _)| *kind);
    let singular = |ending: &str| word.strip_suffix(ending).and_then(exact);
    exact(word).or_else(|| singular("s")).or_else(|| singular("es"))
}

/// Returns the color of a category's boxes in the layout image; `None` if they are not drawn. Source:
/// condition contract, `docs/src/reference/maps.md`.
pub fn layout_rgb(category: &str) -> Option<[u8; 3]> {
    match CategoryKind::of(category)? {
        Pedestrian => Some([255, 0, 0]),
        Bicycle => Some([128, 255, 0]),
        Motorcycle => Some([0, 255, 128]),
        Bus => Some([128, 0, 255]),
        Car | AnyVehicle => Some([0, 0, 255]),
        Construction => Some([128, 128, 255]),
        Emergency => Some([255, 128, 128]),
        Trailer => Some([255, 255, 255]),
        Truck => Some([255, 255, 0]),
        Object => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn categories_get_their_class() {
        let class = Class::from_category;
        assert_eq!(class("vehicle.car"), Class::MotorVehicle);
        assert_eq!(class("vehicle.emergency.ambulance"), Class::MotorVehicle);
        assert_eq!(class("vehicle"), Class::MotorVehicle);
        assert_eq!(class("human.pedestrian.adult"), Class::Pedestrian);
        assert_eq!(class("pedestrian"), Class::Pedestrian);
        assert_eq!(class("vehicle.bicycle"), Class::Cycle);
        assert_eq!(class("vehicle.motorcycle"), Class::Cycle);
        assert_eq!(class("movable_object.trafficcone"), Class::Object);
        assert_eq!(class("static_object.bicycle_rack"), Class::Object);
        assert_eq!(class("animal"), Class::Object);
    }

    /// The 23 categories of nuScenes and the 7 of nuPlan.
    #[test]
    fn dotted_categories_keep_their_kind() {
        for (category, kind) in [
            ("human.pedestrian.adult", Pedestrian),
            ("human.pedestrian.child", Pedestrian),
            ("human.pedestrian.wheelchair", Pedestrian),
            ("human.pedestrian.stroller", Pedestrian),
            ("human.pedestrian.personal_mobility", Pedestrian),
            ("human.pedestrian.police_officer", Pedestrian),
            ("human.pedestrian.construction_worker", Pedestrian),
            ("animal", Object),
            ("vehicle.car", Car),
            ("vehicle.motorcycle", Motorcycle),
            ("vehicle.bicycle", Bicycle),
            ("vehicle.bus.bendy", Bus),
            ("vehicle.bus.rigid", Bus),
            ("vehicle.truck", Truck),
            ("vehicle.construction", Construction),
            ("vehicle.emergency.ambulance", Emergency),
            ("vehicle.emergency.police", Emergency),
            ("vehicle.trailer", Trailer),
            ("movable_object.barrier", Object),
            ("movable_object.trafficcone", Object),
            ("movable_object.pushable_pullable", Object),
            ("movable_object.debris", Object),
            ("static_object.bicycle_rack", Object),
            ("vehicle", AnyVehicle),
            ("bicycle", Bicycle),
            ("pedestrian", Pedestrian),
            ("traffic_cone", Object),
            ("barrier", Object),
            ("czone_sign", Object),
            ("generic_object", Object),
            // Argoverse 2, as its reader names them.
            ("vehicle.car.regular_vehicle", Car),
            ("vehicle.bus.school_bus", Bus),
            ("vehicle.trailer.vehicular_trailer", Trailer),
            ("human.pedestrian.bicyclist", Pedestrian),
            ("object.spaceship", Object),
        ] {
            assert_eq!(CategoryKind::of(category), Some(kind), "{category}");
        }
    }

    #[test]
    fn plain_words_of_other_data_sets_are_known() {
        for (kind, words) in [
            (Car, &["car", "Car", "CAR", "Van", "Pickup Truck", "car.sedan", "Vehicle.Car"][..]),
            (Truck, &["truck", "Truck", "Semi-truck", "Medium-sized Truck", "vehicle.truck (box)"]),
            (Bus, &["bus", "Tram", "Tram / Subway", "vehicle.train", "vehicle.bus (bendy & rigid)"]),
            (Trailer, &["trailer", "semi_trailer", "Towed Object"]),
            (
                Construction,
                &["other_vehicle", "OtherVehicle", "vehicle.other", "Other Vehicle - Construction Vehicle"],
            ),
            (Emergency, &["emergency_vehicle", "Emergency Vehicle", "vehicle.ambulance", "vehicle.police"]),
            (AnyVehicle, &["VEHICLE", "TYPE_VEHICLE", "vehicle.hovercraft"]),
            (
                Pedestrian,
                &[
                    "pedestrian",
                    "Person_sitting",
                    "Pedestrian_sitting",
                    "TYPE_PEDESTRIAN",
                    "pedestrian.adult",
                ],
            ),
            (Bicycle, &["bicycle", "Cyclist", "TYPE_CYCLIST", "Tricyclist"]),
            (Motorcycle, &["motorcycle", "Motorized Scooter", "motorbike"]),
            (Object, &["animal", "Misc", "DontCare", "TYPE_UNKNOWN", "Temporary Construction Barriers"]),
        ] {
            for word in words {
                assert_eq!(CategoryKind::of(word), Some(kind), "{word}");
            }
        }
        for (kind, words) in [
            (
                Car,
                &["cars", "Cars", "vehicle_car", "vehicle/car", "vehicle:car", "vehicle-car", "vehicle car"]
                    [..],
            ),
            (Car, &["object.car", "movable_object.car", "vehicle_pickup_truck"]),
            (Truck, &["trucks", "vehicle.trucks"]),
            (Bus, &["buses", "articulated_bus", "vehicle_bus_bendy", "vehicle:bus:rigid"]),
            (Pedestrian, &["Pedestrians", "persons", "human/pedestrian/adult"]),
            (Bicycle, &["bicycles", "vehicle_bicycle"]),
            (AnyVehicle, &["vehicles", "vehicle.unknown", "vehicle_hovercraft"]),
            (Construction, &["vehicle_other", "vehicle_construction"]),
            (Object, &["construction_cone", "Construction Barrel", "wheeled_device", "cones", "animals"]),
            (Object, &["vehicle.barrier", "vehicle.trafficcone", "vehicle_bicycle_rack", "animal_bird"]),
            (Object, &["movable_object_trafficcone", "static_object/bicycle_rack", "object.construction"]),
            (
                Object,
                &["movable_object.message_board_trailer", "movable_object.wheeled_device", "object.fire"],
            ),
        ] {
            for word in words {
                assert_eq!(CategoryKind::of(word), Some(kind), "{word}");
            }
        }
        for word in ["s", "es", "object", "humanoid", "objective"] {
            let known = (word == "object").then_some(Object);
            assert_eq!(CategoryKind::of(word), known, "{word}");
        }
        for word in ["", "hovercraft", "carton", "busy", "a.b", "."] {
            assert_eq!(CategoryKind::of(word), None, "{word}");
        }
        assert_eq!((Class::from_category("hovercraft"), layout_rgb("hovercraft")), (Class::Object, None));
    }

    #[test]
    fn layout_colors_follow_the_category() {
        assert_eq!(layout_rgb("vehicle.bus.rigid"), Some([128, 0, 255]));
        assert_eq!(layout_rgb("vehicle.emergency.police"), Some([255, 128, 128]));
        assert_eq!(layout_rgb("vehicle"), Some([0, 0, 255]));
        assert_eq!(layout_rgb("human.pedestrian.construction_worker"), Some([255, 0, 0]));
        assert_eq!(layout_rgb("movable_object.barrier"), None);
        assert_eq!(layout_rgb("static_object.bicycle_rack"), None);
    }
}
