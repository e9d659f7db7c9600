use point_skeleton::named;

/// Track id of the actor on collision course.
pub const TRACK: &str = "scenario-target";
/// Kind of scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// A vehicle stands in the way.
    Stationary,
    /// An oncoming vehicle drifts into the way and stops there.
    Frontal,
    /// A vehicle pulls out from the side and crosses the way.
    Side,
    /// A slower vehicle changes from the next lane into the way.
    CutIn,
    /// A pedestrian crosses the way.
    Crossing,
}

named!(Family, "family of scenarios" {
    Stationary => "stationary", "A vehicle stands in the way";
    Frontal => "frontal", "An oncoming vehicle drifts into the way and stops there";
    Side => "side", "A vehicle pulls out from the side and crosses the way";
    CutIn => "cut-in", "A slower vehicle changes from the next lane into the way";
    Crossing => "crossing", "A pedestrian crosses the way";
});
