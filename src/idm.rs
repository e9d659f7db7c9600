//! Intelligent Driver Model: acceleration on a free road and behind a leader.
//!
//! M. Treiber, A. Hennecke and D. Helbing, "Congested traffic states in empirical observations and
//! microscopic simulations", Physical Review E 62, 1805 (2000). All values are in meters and seconds.

/// Exponent of the speed on a free road.
const EXPONENT: i32 = 4;

/// Parameters of a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Idm {
    /// Desired speed on a free road, m/s.
    pub desired_mps: f64,
    /// Maximum acceleration, m/s².
    pub acceleration_mps2: f64,
    /// Comfortable deceleration, m/s².
    pub braking_mps2: f64,
    /// Desired time headway to the leader, seconds.
    pub headway_s: f64,
    /// Desired gap to the leader at rest, meters.
    pub min_gap_m: f64,
    /// Gaps below this count as this, meters.
    pub gap_floor_m: f64,
    /// Whether the desired gap is at least `min_gap_m` behind a faster leader as well. The model of 2000 lets
    /// it become smaller.
    pub keeps_min_gap: bool,
}

/// Nearest road user ahead on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leader {
    /// Gap along the path from the follower's front to the leader, meters; 0 on contact.
    pub gap_m: f64,
    /// Speed along the path, m/s; negative for oncoming traffic.
    pub speed_mps: f64,
}

impl Idm {
    /// Returns the acceleration at a speed (m/s), m/s². The deceleration is not limited: close to a leader it
    /// exceeds `braking_mps2`.
    pub fn acceleration_mps2(&self, speed_mps: f64, leader: Option<Leader>) -> f64 {
        let free = 1.0 - (speed_mps / self.desired_mps).powi(EXPONENT);
        let held = leader.map_or(0.0, |leader| {
            (self.desired_gap_m(speed_mps, leader) / leader.gap_m.max(self.gap_floor_m)).powi(2)
        });
        self.acceleration_mps2 * (free - held)
    }

    fn desired_gap_m(&self, speed_mps: f64, leader: Leader) -> f64 {
        let closing_mps = speed_mps - leader.speed_mps;
        let approach_m =
            speed_mps * closing_mps / (2.0 * (self.acceleration_mps2 * self.braking_mps2).sqrt());
        let headway_m = speed_mps * self.headway_s;
        if self.keeps_min_gap {
            self.min_gap_m + (headway_m + approach_m).max(0.0)
        } else {
            self.min_gap_m + headway_m + approach_m
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDM: Idm = Idm {
        desired_mps: 10.0,
        acceleration_mps2: 1.0,
        braking_mps2: 4.0,
        headway_s: 1.5,
        min_gap_m: 2.0,
        gap_floor_m: 0.5,
        keeps_min_gap: false,
    };

    #[test]
    fn the_desired_speed_and_gap_are_equilibria() {
        assert_eq!(IDM.acceleration_mps2(0.0, None), 1.0);
        assert_eq!(IDM.acceleration_mps2(10.0, None), 0.0);
        // At rest at the minimum gap, and at 5 m/s behind a leader of the same speed at the gap of
        // equilibrium.
        assert_eq!(IDM.acceleration_mps2(0.0, Some(Leader { gap_m: 2.0, speed_mps: 0.0 })), 0.0);
        let gap_m = (2.0 + 5.0 * 1.5) / (1.0_f64 - 0.0625).sqrt();
        assert!(IDM.acceleration_mps2(5.0, Some(Leader { gap_m, speed_mps: 5.0 })).abs() < 1e-12);
        // Closing at 4 m/s: 4 · 4 / (2 · sqrt(1 · 4)) = 4 m more.
        let closing = IDM.acceleration_mps2(4.0, Some(Leader { gap_m: 12.0, speed_mps: 0.0 }));
        assert!((closing - (1.0 - 0.4_f64.powi(4) - 1.0)).abs() < 1e-12);
    }

    #[test]
    fn a_receding_leader_may_keep_its_minimum_gap() {
        let leader = Some(Leader { gap_m: 2.0, speed_mps: 20.0 });
        let keeps = Idm { keeps_min_gap: true, ..IDM };
        assert!((keeps.acceleration_mps2(5.0, leader) - (0.9375 - 1.0)).abs() < 1e-12);
        // 2 + 7.5 - 5 · 15 / 4 = -9.25 m.
        assert!((IDM.acceleration_mps2(5.0, leader) - (0.9375 - 4.625_f64.powi(2))).abs() < 1e-12);
        let touching = Some(Leader { gap_m: 0.0, speed_mps: 0.0 });
        assert_eq!(IDM.acceleration_mps2(0.0, touching), 1.0 - 16.0);
    }
}
