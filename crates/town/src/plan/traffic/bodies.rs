use crate::model::{Body, BodyKind};
use crate::plan::random::Random;

/// Variants of each kind in a town.
const VARIANTS: usize = 5;

/// Bodies that traffic in a town is drawn from: a few variants of each kind.
pub(super) struct Bodies(Vec<Body>);

/// Kinds of driving vehicles, with their shares.
pub(super) const DRIVING: [(BodyKind, f64); 7] = [
    (BodyKind::Sedan, 0.30),
    (BodyKind::Hatchback, 0.22),
    (BodyKind::Suv, 0.22),
    (BodyKind::Pickup, 0.08),
    (BodyKind::Van, 0.08),
    (BodyKind::Truck, 0.05),
    (BodyKind::Bus, 0.05),
];

/// Kinds of parked vehicles, with their shares.
pub(super) const PARKED: [(BodyKind, f64); 5] = [
    (BodyKind::Sedan, 0.32),
    (BodyKind::Hatchback, 0.28),
    (BodyKind::Suv, 0.24),
    (BodyKind::Pickup, 0.07),
    (BodyKind::Van, 0.09),
];

impl Bodies {
    pub(super) fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, "bodies", 0);
        let people = [(BodyKind::Walker, 0.0), (BodyKind::Cyclist, 0.0), (BodyKind::Cone, 0.0)];
        let kinds = DRIVING.iter().chain(&people).map(|(kind, _)| *kind);
        let mut bodies = Vec::new();
        for kind in kinds {
            let variants = if kind == BodyKind::Walker { 2 * VARIANTS } else { VARIANTS };
            bodies.extend((0..variants).map(|_| Body { kind, seed: random.bits() }));
        }
        Self(bodies)
    }

    /// Picks a body of a kind.
    pub(super) fn of(&self, kind: BodyKind, random: &mut Random) -> Body {
        let of_kind: Vec<Body> = self.0.iter().filter(|body| body.kind == kind).copied().collect();
        of_kind[random.index(of_kind.len())]
    }

    /// Picks a body of several kinds, weighted by their shares.
    pub(super) fn any(&self, kinds: &[(BodyKind, f64)], random: &mut Random) -> Body {
        let kind = random.weighted(kinds).unwrap_or(BodyKind::Sedan);
        self.of(kind, random)
    }
}
