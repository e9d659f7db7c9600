use glam::DVec3;

use crate::dataset::{CategoryKind, Class};
use crate::{named, named_in_files};

/// Kind of a category template.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

named!(TemplateKind, "template" {
    Sedan => "sedan", "";
    Suv => "suv", "";
    Pickup => "pickup", "";
    Pedestrian => "pedestrian", "";
    Bike => "bike", "";
    Truck => "truck", "";
    Bus => "bus", "";
    Trailer => "trailer", "";
    Construction => "construction", "";
});
named_in_files!(TemplateKind);

impl TemplateKind {
    /// Returns the kind of template for an actor, by category and box size (length, width, height, meters).
    /// `None` for categories without templates (cones, barriers ...).
    pub fn of_actor(category: &str, size_m: DVec3) -> Option<Self> {
        Family::of(category).map(|family| family.kind(size_m))
    }

    /// Returns whether the template replaces assets of this kind with few points. Other kinds (trucks, buses
    /// ..) vary so much that any asset is better than a template.
    pub(crate) fn replaces_small_assets(self) -> bool {
        matches!(self, Self::Sedan | Self::Suv | Self::Pickup | Self::Pedestrian | Self::Bike)
    }

    /// Returns the coarse class of the points.
    pub fn class(self) -> Class {
        match self {
            Self::Pedestrian => Class::Pedestrian,
            Self::Bike => Class::Cycle,
            _ => Class::MotorVehicle,
        }
    }
}

/// Kinds that are possible for a category.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Family {
    /// Exactly one kind.
    Of(TemplateKind),
    /// Car, van or pickup, distinguished by size.
    Car,
    /// Any motor vehicle, for data sets with a single vehicle category.
    AnyVehicle,
}

/// Minimum length or height of a truck without a finer category, meters ...
const TRUCK_LENGTH_M: f64 = 7.0;
const TRUCK_HEIGHT_M: f64 = 2.9;
/// ... and minimum length of a bus: most trucks of that length are annotated in two parts.
const BUS_LENGTH_M: f64 = 10.0;

impl Family {
    /// Returns the family of a category; `None` for categories without templates.
    pub(super) fn of(category: &str) -> Option<Self> {
        match CategoryKind::of(category)? {
            CategoryKind::Pedestrian => Some(Self::Of(TemplateKind::Pedestrian)),
            CategoryKind::Bicycle | CategoryKind::Motorcycle => Some(Self::Of(TemplateKind::Bike)),
            CategoryKind::Bus => Some(Self::Of(TemplateKind::Bus)),
            CategoryKind::Trailer => Some(Self::Of(TemplateKind::Trailer)),
            CategoryKind::Construction => Some(Self::Of(TemplateKind::Construction)),
            CategoryKind::Truck => Some(Self::Of(TemplateKind::Truck)),
            CategoryKind::AnyVehicle => Some(Self::AnyVehicle),
            CategoryKind::Car | CategoryKind::Emergency => Some(Self::Car),
            CategoryKind::Object => None,
        }
    }

    /// Returns the kind of a member by its size (length, width, height, meters).
    pub(super) fn kind(self, size_m: DVec3) -> TemplateKind {
        match self {
            Self::Of(kind) => kind,
            Self::AnyVehicle if size_m.x >= BUS_LENGTH_M => TemplateKind::Bus,
            Self::AnyVehicle if size_m.x >= TRUCK_LENGTH_M || size_m.z >= TRUCK_HEIGHT_M => {
                TemplateKind::Truck
            }
            _ if size_m.z < 1.8 => TemplateKind::Sedan,
            _ if size_m.z < 2.05 => TemplateKind::Suv,
            _ => TemplateKind::Pickup,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cars_are_distinguished_by_height() {
        let kind =
            |category: &str, height_m: f64| TemplateKind::of_actor(category, DVec3::new(4.5, 1.9, height_m));
        assert_eq!(kind("vehicle.car", 1.79), Some(TemplateKind::Sedan));
        assert_eq!(kind("vehicle.car", 1.8), Some(TemplateKind::Suv));
        assert_eq!(kind("vehicle", 2.05), Some(TemplateKind::Pickup));
        assert_eq!(kind("vehicle.truck", 1.5), Some(TemplateKind::Truck));
        assert_eq!(kind("vehicle.bus.rigid", 3.5), Some(TemplateKind::Bus));
        assert_eq!(kind("vehicle.motorcycle", 1.5), Some(TemplateKind::Bike));
        assert_eq!(kind("human.pedestrian.child", 1.2), Some(TemplateKind::Pedestrian));
        assert_eq!(kind("movable_object.barrier", 1.2), None);
    }

    #[test]
    fn length_decides_only_if_the_category_does_not() {
        let kind = |category: &str, size: [f64; 3]| TemplateKind::of_actor(category, size.into());
        assert_eq!(kind("vehicle", [12.0, 3.0, 3.3]), Some(TemplateKind::Bus));
        assert_eq!(kind("vehicle", [7.0, 2.5, 2.8]), Some(TemplateKind::Truck));
        assert_eq!(kind("vehicle", [6.5, 2.5, 2.9]), Some(TemplateKind::Truck));
        assert_eq!(kind("vehicle", [6.9, 2.2, 2.8]), Some(TemplateKind::Pickup));
        assert_eq!(kind("vehicle.car", [12.0, 3.0, 3.3]), Some(TemplateKind::Pickup));
        assert_eq!(kind("vehicle.truck", [12.0, 3.0, 3.3]), Some(TemplateKind::Truck));
    }
}
