//! Kinds of actors, and the words that stand for them.

/// Kind of actor that a category stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CategoryKind {
    Car,
    Truck,
    Bus,
    Trailer,
    /// Construction and other special vehicles.
    Construction,
    Emergency,
    /// Any motor vehicle, in data sets with a single category for them.
    AnyVehicle,
    Pedestrian,
    Bicycle,
    Motorcycle,
    Object,
}

use CategoryKind::{
    AnyVehicle, Bicycle, Bus, Car, Construction, Emergency, Motorcycle, Object, Pedestrian, Trailer, Truck,
};

/// Words in the singular, in lower case without separators. Sources: the category lists of nuScenes, nuPlan,
/// Argoverse 2, Lyft Level 5, TIER IV's T4, KITTI, Waymo Open, PandaSet, TruckScenes, ONCE, DAIR-V2X, ZOD and
/// Cityscapes.
pub(super) const WORDS: [(CategoryKind, &[&str]); 11] = [
    (
        Car,
        &[
            "car",
            "van",
            "minivan",
            "suv",
            "sedan",
            "taxi",
            "pickup",
            "pickuptruck",
            "passengercar",
            "regularvehicle",
            "ego",
        ],
    ),
    (
        Truck,
        &[
            "truck",
            "lorry",
            "mediumsizedtruck",
            "semitruck",
            "heavytruck",
            "lighttruck",
            "boxtruck",
            "truckcab",
            "tractorunit",
            "largevehicle",
            "firetruck",
        ],
    ),
    (
        Bus,
        &[
            "bus",
            "minibus",
            "schoolbus",
            "articulatedbus",
            "coach",
            "tram",
            "tramsubway",
            "train",
            "trolley",
            "railedvehicle",
        ],
    ),
    (Trailer, &["trailer", "semitrailer", "truckhead", "towedobject", "caravan", "vehiculartrailer"]),
    (
        Construction,
        &[
            "construction",
            "constructionvehicle",
            "othervehicle",
            "othervehicleconstructionvehicle",
            "othervehicleuncommon",
            "excavator",
            "forklift",
            "tractor",
            "heavyequipment",
            "kart",
        ],
    ),
    (
        Emergency,
        &[
            "emergency",
            "emergencyvehicle",
            "ambulance",
            "police",
            "policecar",
            "policevehicle",
            "fire",
            "fireengine",
        ],
    ),
    (AnyVehicle, &["vehicle", "motorvehicle"]),
    (
        Pedestrian,
        &[
            "pedestrian",
            "pedestrianwithobject",
            "pedestriansitting",
            "person",
            "personsitting",
            "people",
            "human",
            "adult",
            "child",
            "rider",
            "stroller",
            "wheelchair",
            "personalmobility",
            "personalmobilitydevice",
            "policeofficer",
            "constructionworker",
            "officialsignaler",
            "wheeledrider",
        ],
    ),
    (
        Bicycle,
        &[
            "bicycle",
            "bike",
            "cycle",
            "cyclist",
            "bicyclist",
            "tricycle",
            "tricyclist",
            "othervehiclepedicab",
            "twowheeler",
        ],
    ),
    (
        Motorcycle,
        &[
            "motorcycle",
            "motorbike",
            "motorcyclist",
            "motorizedscooter",
            "scooter",
            "moped",
            "vehicletwowheeler",
        ],
    ),
    (
        Object,
        &[
            "object",
            "genericobject",
            "movableobject",
            "staticobject",
            "animal",
            "animalsother",
            "animalsbird",
            "dog",
            "barrier",
            "roadbarrier",
            "temporaryconstructionbarrier",
            "cone",
            "constructioncone",
            "constructionbarrel",
            "trafficcone",
            "pylon",
            "czonesign",
            "constructionsign",
            "pushablepullable",
            "rollingcontainer",
            "debris",
            "bicyclerack",
            "bollard",
            "pole",
            "sign",
            "stopsign",
            "trafficsign",
            "trafficlight",
            "trafficlighttrailer",
            "messageboardtrailer",
            "mobilepedestriancrossingsign",
            "wheeleddevice",
            "vegetation",
            "misc",
            "other",
            "unknown",
            "unclear",
            "dontcare",
        ],
    ),
];

/// Groups of nuScenes; longer names that begin like others come first.
pub(super) const GROUPS: [&str; 6] =
    ["movable_object", "static_object", "vehicle", "human", "animal", "object"];

/// Words of [`Object`] that may also stand for a vehicle.
pub(super) const VAGUE: [&str; 9] = [
    "object",
    "genericobject",
    "movableobject",
    "staticobject",
    "misc",
    "other",
    "unknown",
    "unclear",
    "dontcare",
];

/// Words that are vehicles on their own or below `vehicle`, but not below `object`.
pub(super) const ADJECTIVES: [&str; 4] = ["construction", "emergency", "police", "fire"];
