//! Kinds of bodies.

/// Kind of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum BodyKind {
    Sedan,
    Hatchback,
    Suv,
    Pickup,
    Van,
    Truck,
    Bus,
    Walker,
    Cyclist,
    Cone,
}
