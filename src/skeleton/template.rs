use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::dataset::Class;

/// The kinds of category templates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum TemplateKind {
    Sedan,
    Suv,
    Pickup,
    Pedestrian,
    Bike,
    Truck,
    Bus,
    Trailer,
    Construction,
}

impl TemplateKind {
    /// Names as on the command line and in files.
    pub const NAMES: [(&'static str, Self); 9] = [
        ("sedan", Self::Sedan),
        ("suv", Self::Suv),
        ("pickup", Self::Pickup),
        ("pedestrian", Self::Pedestrian),
        ("bike", Self::Bike),
        ("truck", Self::Truck),
        ("bus", Self::Bus),
        ("trailer", Self::Trailer),
        ("construction", Self::Construction),
    ];

    /// The kind that stands in for an actor: cars by the height of their box (metres), others by category. `None`
    /// for what has no template (cones, barriers ...).
    pub fn of_actor(category: &str, height_m: f64) -> Option<Self> {
        let has = |part: &str| category.split('.').any(|p| p == part);
        match Class::from_category(category) {
            Class::Pedestrian => Some(Self::Pedestrian),
            Class::Cycle => Some(Self::Bike),
            Class::MotorVehicle if has("bus") => Some(Self::Bus),
            Class::MotorVehicle if has("trailer") => Some(Self::Trailer),
            Class::MotorVehicle if has("construction") => Some(Self::Construction),
            Class::MotorVehicle if has("truck") => Some(Self::Truck),
            Class::MotorVehicle if height_m < 1.8 => Some(Self::Sedan),
            Class::MotorVehicle if height_m < 2.05 => Some(Self::Suv),
            Class::MotorVehicle => Some(Self::Pickup),
            Class::Object | Class::None => None,
        }
    }

    /// Coarse class of its points.
    pub fn class(self) -> Class {
        match self {
            Self::Pedestrian => Class::Pedestrian,
            Self::Bike => Class::Cycle,
            _ => Class::MotorVehicle,
        }
    }
}

impl FromStr for TemplateKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = || Self::NAMES.map(|(name, _)| name).join(", ");
        let found = Self::NAMES.iter().find(|(name, _)| *name == text);
        found
            .map(|(_, kind)| *kind)
            .ok_or_else(|| format!("expected a template of {}, found {text:?}", names()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cars_are_told_apart_by_height() {
        let kind = TemplateKind::of_actor;
        assert_eq!(kind("vehicle.car", 1.79), Some(TemplateKind::Sedan));
        assert_eq!(kind("vehicle.car", 1.8), Some(TemplateKind::Suv));
        assert_eq!(kind("vehicle", 2.05), Some(TemplateKind::Pickup));
        assert_eq!(kind("vehicle.truck", 1.5), Some(TemplateKind::Truck));
        assert_eq!(kind("vehicle.bus.rigid", 3.5), Some(TemplateKind::Bus));
        assert_eq!(kind("vehicle.motorcycle", 1.5), Some(TemplateKind::Bike));
        assert_eq!(kind("human.pedestrian.child", 1.2), Some(TemplateKind::Pedestrian));
        assert_eq!(kind("movable_object.barrier", 1.2), None);
    }
}
