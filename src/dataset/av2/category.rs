//! Maps Argoverse 2 categories to dotted names as in nuScenes, which determine class, color and template.

use crate::dataset::CategoryKind;

/// Returns the dotted name of a category: group, kind, and the dataset's own name in lower case, like
/// `vehicle.car.regular_vehicle`, in any case. Words of other data sets stay as they are. `None` for unknown words.
///
/// Riders are pedestrians, since they have boxes separate from their cycles. Trams are buses, the nearest in shape.
/// Message boards and traffic lights on trailers are signs rather than vehicles. Boxes of wheeled devices exclude
/// their rider, so they are objects. Source of the list: `AnnotationCategories` of
/// <https://github.com/argoverse/av2-api>.
pub(super) fn dotted(category: &str) -> Option<String> {
    let upper = category.trim().to_uppercase().replace([' ', '-'], "_");
    let group = match upper.as_str() {
        "REGULAR_VEHICLE" => "vehicle.car",
        "LARGE_VEHICLE" | "BOX_TRUCK" | "TRUCK" | "TRUCK_CAB" => "vehicle.truck",
        "BUS" | "SCHOOL_BUS" | "ARTICULATED_BUS" | "RAILED_VEHICLE" => "vehicle.bus",
        "VEHICULAR_TRAILER" => "vehicle.trailer",
        "BICYCLE" => "vehicle.bicycle",
        "MOTORCYCLE" => "vehicle.motorcycle",
        "PEDESTRIAN" | "OFFICIAL_SIGNALER" | "STROLLER" | "WHEELCHAIR" | "BICYCLIST" | "MOTORCYCLIST"
        | "WHEELED_RIDER" => "human.pedestrian",
        "ANIMAL" | "DOG" => "animal",
        "CONSTRUCTION_BARREL"
        | "CONSTRUCTION_CONE"
        | "MESSAGE_BOARD_TRAILER"
        | "TRAFFIC_LIGHT_TRAILER"
        | "MOBILE_PEDESTRIAN_CROSSING_SIGN"
        | "WHEELED_DEVICE" => "movable_object",
        "BOLLARD" | "SIGN" | "STOP_SIGN" => "static_object",
        _ => return CategoryKind::of(category).map(|_| category.to_owned()),
    };
    Some(format!("{group}.{}", upper.to_lowercase()))
}

/// Returns the dotted name of a category with an unknown name.
pub(super) fn unknown(category: &str) -> String {
    format!("object.{}", category.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Class, layout_rgb};
    use crate::skeleton::TemplateKind;

    #[test]
    fn classes_colors_and_templates_follow() {
        let of = |category: &str| {
            let name = dotted(category).unwrap();
            (
                Class::from_category(&name),
                layout_rgb(&name),
                TemplateKind::of_actor(&name, glam::DVec3::new(4.5, 1.9, 1.6)),
            )
        };
        let truck = (Class::MotorVehicle, Some([255, 255, 0]), Some(TemplateKind::Truck));
        let person = (Class::Pedestrian, Some([255, 0, 0]), Some(TemplateKind::Pedestrian));
        let object = (Class::Object, None, None);
        assert_eq!(
            of("REGULAR_VEHICLE"),
            (Class::MotorVehicle, Some([0, 0, 255]), Some(TemplateKind::Sedan))
        );
        assert_eq!((of("BOX_TRUCK"), of("TRUCK"), of("LARGE_VEHICLE")), (truck, truck, truck));
        assert_eq!(of("SCHOOL_BUS"), (Class::MotorVehicle, Some([128, 0, 255]), Some(TemplateKind::Bus)));
        assert_eq!(of("VEHICULAR_TRAILER").2, Some(TemplateKind::Trailer));
        assert_eq!(of("BICYCLE"), (Class::Cycle, Some([128, 255, 0]), Some(TemplateKind::Bike)));
        assert_eq!(of("MOTORCYCLE").0, Class::Cycle);
        assert_eq!((of("PEDESTRIAN"), of("BICYCLIST"), of("STROLLER")), (person, person, person));
        assert_eq!((of("BOLLARD"), of("CONSTRUCTION_CONE"), of("DOG")), (object, object, object));
        assert_eq!(of("MOBILE_PEDESTRIAN_CROSSING_SIGN"), object);
        assert_eq!(dotted("construction_cone"), dotted("CONSTRUCTION_CONE"));
        assert_eq!((of("bicyclist"), of("Regular Vehicle")), (person, of("REGULAR_VEHICLE")));
        assert_eq!(dotted("Car").as_deref(), Some("Car"));
        assert_eq!((dotted("SPACESHIP"), unknown("SPACESHIP").as_str()), (None, "object.spaceship"));
        assert_eq!(Class::from_category(&unknown("SPACESHIP")), Class::Object);
    }
}
