//! Labels of boxes. Files hold numbers; the names are in classes of py123d, one per data set. Source: the
//! enums in `py123d.parser.registry`, version 0.7.0.

use std::borrow::Cow;

use crate::dataset::category::argoverse;

/// Categories of a label class by number.
pub(super) enum Labels {
    /// Dotted categories as in nuScenes.
    Table(&'static [&'static str]),
    /// Argoverse 2, whose categories keep their own names.
    Argoverse,
    /// Not known.
    Unknown,
}

/// Category of labels that are not known.
const UNKNOWN: &str = "movable_object";

/// Category in [`DEFAULT`] of the ego vehicle, which is no actor.
const EGO: &str = "ego";

impl Labels {
    /// Returns the labels of a class, given by its Python path.
    pub(super) fn of_class(path: &str) -> Self {
        let name = path.rsplit('.').next().unwrap_or_default();
        let name = name.strip_suffix("BoxDetectionLabel").unwrap_or(name);
        Self::Table(match name {
            "AV2Sensor" => return Self::Argoverse,
            "NuScenes" => &NUSCENES,
            "NuPlan" => &NUPLAN,
            "Pandaset" => &PANDASET,
            "WODPerception" => &WAYMO_PERCEPTION,
            "WODMotion" => &WAYMO_MOTION,
            "PhysicalAIAV" => &PHYSICAL_AI,
            "KITTI360" => &KITTI_360,
            "Nureasoning" => &NUREASONING,
            "TruckDrive" => &TRUCK_DRIVE,
            "Griffin" => &GRIFFIN,
            "Default" => &DEFAULT,
            _ => return Self::Unknown,
        })
    }

    /// Returns the category of a label; `None` if the class has no such number.
    pub(super) fn category(&self, label: u16) -> Option<Cow<'static, str>> {
        match self {
            Self::Table(names) => names.get(usize::from(label)).map(|name| Cow::Borrowed(*name)),
            Self::Argoverse => {
                let name = argoverse::CATEGORIES.get(usize::from(label))?;
                argoverse::dotted(name).map(Cow::Owned)
            }
            Self::Unknown => None,
        }
    }

    /// Returns whether a label means the ego vehicle.
    pub(super) fn is_ego(&self, label: u16) -> bool {
        self.category(label).is_some_and(|category| category == EGO)
    }
}

/// Returns the category of a label that is not known.
pub(super) fn unknown() -> Cow<'static, str> {
    Cow::Borrowed(UNKNOWN)
}

const NUSCENES: [&str; 23] = [
    "vehicle.car",
    "vehicle.truck",
    "vehicle.bus.bendy",
    "vehicle.bus.rigid",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
    "vehicle.trailer",
    "vehicle.bicycle",
    "vehicle.motorcycle",
    "human.pedestrian.adult",
    "human.pedestrian.child",
    "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility",
    "human.pedestrian.police_officer",
    "human.pedestrian.stroller",
    "human.pedestrian.wheelchair",
    "movable_object.trafficcone",
    "movable_object.barrier",
    "movable_object.pushable_pullable",
    "movable_object.debris",
    "static_object.bicycle_rack",
    "animal",
];

/// Names of nuPlan, as its own reader has them.
const NUPLAN: [&str; 7] =
    ["vehicle", "bicycle", "pedestrian", "traffic_cone", "barrier", "czone_sign", "generic_object"];

const PANDASET: [&str; 27] = [
    "animal.bird",
    "animal",
    "vehicle.bicycle",
    "vehicle.bus.rigid",
    "vehicle.car",
    "movable_object.trafficcone",
    "movable_object.construction_sign",
    "vehicle.emergency",
    "vehicle.truck.medium",
    "vehicle.motorcycle",
    "vehicle.motorcycle.scooter",
    "vehicle.construction",
    "vehicle.bicycle.pedicab",
    "vehicle.car.uncommon",
    "human.pedestrian.adult",
    "human.pedestrian.adult.with_object",
    "human.pedestrian.personal_mobility",
    "vehicle.truck.pickup",
    "movable_object.pylon",
    "movable_object.barrier",
    "movable_object.container",
    "vehicle.truck.semi",
    "static_object.sign",
    "movable_object.barrier",
    "vehicle.trailer.towed",
    "vehicle.bus.bendy.train",
    "vehicle.bus.bendy.tram",
];

const WAYMO_PERCEPTION: [&str; 5] =
    ["movable_object", "vehicle.car", "human.pedestrian.adult", "static_object.sign", "vehicle.bicycle"];

const WAYMO_MOTION: [&str; 5] =
    ["movable_object", "vehicle.car", "human.pedestrian.adult", "vehicle.bicycle", "movable_object"];

const PHYSICAL_AI: [&str; 12] = [
    "vehicle.car",
    "human.pedestrian.adult",
    "vehicle.bus.rigid",
    "vehicle.truck",
    "vehicle.car.other",
    "movable_object.debris",
    "vehicle.bicycle",
    "human.pedestrian.stroller",
    "vehicle.trailer",
    "animal",
    "vehicle.bus.bendy.train",
    "vehicle.bus.bendy.trolley",
];

const KITTI_360: [&str; 19] = [
    "vehicle.bicycle",
    "movable_object.box",
    "vehicle.bus.rigid",
    "vehicle.car",
    "vehicle.trailer.caravan",
    "static_object.lamp",
    "vehicle.motorcycle",
    "human.pedestrian.adult",
    "static_object.pole",
    "human.pedestrian.adult.rider",
    "static_object.small_pole",
    "static_object.stop",
    "static_object.traffic_light",
    "static_object.traffic_sign",
    "vehicle.trailer",
    "vehicle.bus.bendy.train",
    "static_object.trash_bin",
    "vehicle.truck",
    "static_object.vending_machine",
];

const NUREASONING: [&str; 13] = [
    "vehicle.car",
    "vehicle.bicycle",
    "human.pedestrian.adult",
    "movable_object.trafficcone",
    "movable_object.traffic_sign",
    "movable_object",
    "movable_object.door",
    "vehicle.truck",
    "vehicle.bus.rigid",
    "vehicle.motorcycle",
    "vehicle.bicycle",
    "human.pedestrian.adult",
    "movable_object.trafficcone",
];

const TRUCK_DRIVE: [&str; 9] = [
    "vehicle.bicycle",
    "vehicle.car",
    "human.pedestrian.adult",
    "movable_object.barrier",
    "vehicle.truck.cab",
    "vehicle.trailer",
    "vehicle.car",
    "static_object.sign",
    "vehicle.emergency",
];

const GRIFFIN: [&str; 6] = [
    "human.pedestrian.adult",
    "vehicle.car",
    "vehicle.truck",
    "vehicle.bus.rigid",
    "vehicle.motorcycle",
    "vehicle.bicycle",
];

const DEFAULT: [&str; 12] = [
    EGO,
    "vehicle.car",
    "vehicle.bus.bendy.train",
    "vehicle.bicycle",
    "human.pedestrian.adult",
    "animal",
    "static_object.traffic_sign",
    "movable_object.trafficcone",
    "static_object.traffic_light",
    "movable_object.barrier",
    "movable_object",
    "movable_object",
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{CategoryKind, Class};

    const CLASSES: [&str; 12] = [
        "AV2Sensor",
        "NuScenes",
        "NuPlan",
        "Pandaset",
        "WODPerception",
        "WODMotion",
        "PhysicalAIAV",
        "KITTI360",
        "Nureasoning",
        "TruckDrive",
        "Griffin",
        "Default",
    ];

    #[test]
    fn every_category_is_known() {
        for class in CLASSES {
            let labels = Labels::of_class(&format!("py123d.parser.registry.{class}BoxDetectionLabel"));
            let categories: Vec<_> = (0..u16::MAX).map_while(|label| labels.category(label)).collect();
            assert!(categories.len() > 4, "{class}");
            for category in &categories {
                assert!(CategoryKind::of(category).is_some(), "{class}: {category}");
                let is_person = category.starts_with("human.");
                assert_eq!(
                    Class::from_category(category) == Class::Pedestrian,
                    is_person || category == "pedestrian"
                );
            }
        }
        assert!(Labels::of_class("mine.OtherLabel").category(0).is_none());
        assert!(Labels::of_class("DefaultBoxDetectionLabel").is_ego(0));
        assert!(!Labels::of_class("DefaultBoxDetectionLabel").is_ego(1));
    }
}
