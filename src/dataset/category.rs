use serde::{Deserialize, Serialize};

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
    /// Person on foot, or pushing or riding something without pedals. In Argoverse 2 also the riders of cycles.
    Pedestrian = 2,
    /// Bicycle or motorcycle.
    Cycle = 3,
    /// Any other annotated object: cones, barriers, animals ...
    Object = 4,
}

impl Class {
    /// All classes, by number.
    pub const ALL: [Self; 5] = [Self::None, Self::MotorVehicle, Self::Pedestrian, Self::Cycle, Self::Object];

    /// Returns the class of a category name of nuScenes or nuPlan.
    pub fn from_category(category: &str) -> Self {
        let has = |part: &str| category.split('.').any(|p| p == part);
        if has("bicycle") || has("motorcycle") {
            return Self::Cycle;
        }
        if has("pedestrian") {
            return Self::Pedestrian;
        }
        if has("vehicle") { Self::MotorVehicle } else { Self::Object }
    }
}

/// Returns the color of a category's boxes in the layout image; `None` if they are not drawn. Source: condition
/// contract, `docs/CONDITIONS.md`.
pub fn layout_rgb(category: &str) -> Option<[u8; 3]> {
    const COLORS: [(&str, [u8; 3]); 9] = [
        ("pedestrian", [255, 0, 0]),
        ("bicycle", [128, 255, 0]),
        ("motorcycle", [0, 255, 128]),
        ("bus", [128, 0, 255]),
        ("car", [0, 0, 255]),
        ("construction", [128, 128, 255]),
        ("emergency", [255, 128, 128]),
        ("trailer", [255, 255, 255]),
        ("truck", [255, 255, 0]),
    ];
    let parts: Vec<&str> = category.split('.').collect();
    if parts == ["vehicle"] {
        return layout_rgb("vehicle.car");
    }
    if parts.first() == Some(&"static_object") || parts.first() == Some(&"movable_object") {
        return None;
    }
    COLORS.iter().find(|(name, _)| parts.contains(name)).map(|(_, rgb)| *rgb)
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
