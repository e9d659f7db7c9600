//! Score of NeuroNCAP (Ljungbergh et al., 2024, section 3.3).

use glam::DVec2;
use serde::Serialize;

use crate::Collision;
use crate::report::StepRow;

/// Scores without a collision, and for a contact without speed.
const STARS: f64 = 5.0;
const CONTACT_STARS: f64 = 4.0;

/// Score of NeuroNCAP with its speeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NeuroNcap {
    /// 5 without a collision, else `4 · max(0, 1 - impact / reference)`.
    pub score: f64,
    /// Relative speed at the first contact with any actor, meters per second; `None` without one.
    pub impact_speed_mps: Option<f64>,
    /// Relative speed of the same contact if the ego had kept its velocity from the takeover, meters per
    /// second.
    pub reference_speed_mps: Option<f64>,
}

impl Default for NeuroNcap {
    fn default() -> Self {
        Self { score: STARS, impact_speed_mps: None, reference_speed_mps: None }
    }
}

/// Returns the score of a contact at a relative speed, with the reference speed (both meters per second).
pub fn ncap_score(impact_mps: f64, reference_mps: f64) -> f64 {
    let share = if impact_mps > 0.0 { impact_mps / reference_mps } else { 0.0 };
    CONTACT_STARS * (1.0 - share).max(0.0)
}

/// Scores the first contact; `first` is the step of the takeover.
pub(super) fn of(rows: &[StepRow], first: Option<&StepRow>, collisions: &[Collision]) -> NeuroNcap {
    let collision = collisions.iter().min_by_key(|collision| collision.step);
    let found = collision.and_then(|collision| {
        let row = rows.iter().find(|row| row.step == collision.step)?;
        let actor = row.actors.iter().find(|actor| actor.track == collision.track)?;
        Some((row, DVec2::from(actor.velocity_mps), first?))
    });
    let Some((row, actor, first)) = found else { return NeuroNcap::default() };
    let speed = |ego: &StepRow| (velocity(ego) - actor).length();
    let (impact, reference) = (speed(row), speed(first));
    NeuroNcap {
        score: ncap_score(impact, reference),
        impact_speed_mps: Some(impact),
        reference_speed_mps: Some(reference),
    }
}

fn velocity(row: &StepRow) -> DVec2 {
    DVec2::from_angle(row.ego.heading_rad) * row.ego.speed_mps
}

#[cfg(test)]
mod tests {
    use super::super::tests::row;
    use super::*;
    use crate::CollisionKind;
    use point_skeleton::dataset::Class;

    #[test]
    fn stars_follow_the_formula() {
        let found = [(0.0, 10.0), (2.5, 10.0), (10.0, 10.0), (12.0, 10.0), (0.0, 0.0), (1.0, 0.0)];
        assert_eq!(
            found.map(|(impact, reference)| ncap_score(impact, reference)),
            [4.0, 3.0, 0.0, 0.0, 4.0, 0.0]
        );
        assert_eq!(NeuroNcap::default().score, 5.0);
    }

    #[test]
    fn braking_halves_the_impact() {
        // 10 m/s at the takeover, 6 m/s at the contact with an actor of 2 m/s: 4 of 8 m/s.
        let rows = [row(0, 0.0, 10.0, &[(0.0, 2.0)]), row(1, 1.0, 8.0, &[]), row(2, 2.0, 6.0, &[(3.0, 2.0)])];
        let collision = Collision {
            step: 2,
            t_us: 200_000,
            track: "t0".into(),
            class: Class::MotorVehicle,
            kind: CollisionKind::Front,
            at_fault: Some(true),
            ego_speed_mps: 6.0,
            actor_speed_mps: 2.0,
        };
        let found = of(&rows, rows.first(), &[collision]);
        let expected = NeuroNcap { score: 2.0, impact_speed_mps: Some(4.0), reference_speed_mps: Some(8.0) };
        assert_eq!(found, expected);
        assert_eq!(of(&rows, rows.first(), &[]), NeuroNcap::default());
    }
}
