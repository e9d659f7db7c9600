//! Maps Argoverse 2 categories to dotted names as in nuScenes, which determine class, color and template.

use crate::dataset::CategoryKind::{
    self, AnyVehicle, Bicycle, Bus, Car, Construction, Emergency, Motorcycle, Object, Pedestrian, Trailer,
    Truck,
};

/// Categories of the data set: `AnnotationCategories` of <https://github.com/argoverse/av2-api>.
pub(in crate::dataset) const CATEGORIES: [&str; 30] = [
    "ANIMAL",
    "ARTICULATED_BUS",
    "BICYCLE",
    "BICYCLIST",
    "BOLLARD",
    "BOX_TRUCK",
    "BUS",
    "CONSTRUCTION_BARREL",
    "CONSTRUCTION_CONE",
    "DOG",
    "LARGE_VEHICLE",
    "MESSAGE_BOARD_TRAILER",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN",
    "MOTORCYCLE",
    "MOTORCYCLIST",
    "OFFICIAL_SIGNALER",
    "PEDESTRIAN",
    "RAILED_VEHICLE",
    "REGULAR_VEHICLE",
    "SCHOOL_BUS",
    "SIGN",
    "STOP_SIGN",
    "STROLLER",
    "TRAFFIC_LIGHT_TRAILER",
    "TRUCK",
    "TRUCK_CAB",
    "VEHICULAR_TRAILER",
    "WHEELCHAIR",
    "WHEELED_DEVICE",
    "WHEELED_RIDER",
];

/// Returns the dotted name of a category: group, kind, and the dataset's own name in lower case, like
/// `vehicle.car.regular_vehicle`, in any case. Words of other data sets stay as they are. `None` for unknown
/// words.
///
/// Kinds follow `CategoryKind`, except that riders are pedestrians: they have boxes separate from their
/// cycles.
pub(in crate::dataset) fn dotted(category: &str) -> Option<String> {
    let upper = category.trim().to_uppercase().replace([' ', '-'], "_");
    if !CATEGORIES.contains(&upper.as_str()) {
        return CategoryKind::of(category).map(|_| category.to_owned());
    }
    let group = match (upper.as_str(), CategoryKind::of(&upper)?) {
        ("BICYCLIST" | "MOTORCYCLIST", _) | (_, Pedestrian) => "human.pedestrian",
        (_, Car | AnyVehicle) => "vehicle.car",
        (_, Truck) => "vehicle.truck",
        (_, Bus) => "vehicle.bus",
        (_, Trailer) => "vehicle.trailer",
        (_, Construction) => "vehicle.construction",
        (_, Emergency) => "vehicle.emergency",
        (_, Bicycle) => "vehicle.bicycle",
        (_, Motorcycle) => "vehicle.motorcycle",
        ("ANIMAL" | "DOG", Object) => "animal",
        ("BOLLARD" | "SIGN" | "STOP_SIGN", Object) => "static_object",
        (_, Object) => "movable_object",
    };
    Some(format!("{group}.{}", upper.to_lowercase()))
}

/// Returns the dotted name of a category with an unknown name.
pub(in crate::dataset) fn unknown(category: &str) -> String {
    format!("object.{}", category.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Class, layout_rgb};
    use crate::skeleton::TemplateKind;

    /// The words mean the same in all layouts, but for riders.
    #[test]
    fn every_category_has_its_group() {
        for (group, categories) in [
            ("vehicle.car", &["REGULAR_VEHICLE"][..]),
            ("vehicle.truck", &["LARGE_VEHICLE", "BOX_TRUCK", "TRUCK", "TRUCK_CAB"]),
            ("vehicle.bus", &["BUS", "SCHOOL_BUS", "ARTICULATED_BUS", "RAILED_VEHICLE"]),
            ("vehicle.trailer", &["VEHICULAR_TRAILER"]),
            ("vehicle.bicycle", &["BICYCLE"]),
            ("vehicle.motorcycle", &["MOTORCYCLE"]),
            ("human.pedestrian", &["PEDESTRIAN", "OFFICIAL_SIGNALER", "STROLLER", "WHEELCHAIR"]),
            ("human.pedestrian", &["BICYCLIST", "MOTORCYCLIST", "WHEELED_RIDER"]),
            ("animal", &["ANIMAL", "DOG"]),
            ("movable_object", &["CONSTRUCTION_BARREL", "CONSTRUCTION_CONE", "MESSAGE_BOARD_TRAILER"]),
            (
                "movable_object",
                &["TRAFFIC_LIGHT_TRAILER", "MOBILE_PEDESTRIAN_CROSSING_SIGN", "WHEELED_DEVICE"],
            ),
            ("static_object", &["BOLLARD", "SIGN", "STOP_SIGN"]),
        ] {
            for category in categories {
                let name = format!("{group}.{}", category.to_lowercase());
                assert_eq!(dotted(category).as_ref(), Some(&name));
                let is_rider = ["BICYCLIST", "MOTORCYCLIST"].contains(category);
                assert_eq!(CategoryKind::of(category) == CategoryKind::of(&name), !is_rider, "{category}");
            }
        }
        assert!(CATEGORIES.iter().all(|category| dotted(category).is_some()));
    }

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
