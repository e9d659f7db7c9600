/// Speed profile from one speed to another, with limited acceleration and optionally limited jerk.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Profile {
    start_mps: f64,
    start_mps2: f64,
    /// Duration in seconds and jerk of each segment; after the last the speed stays constant.
    pieces: Vec<(f64, f64)>,
}

/// State of a profile at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProfileState {
    /// Distance since the start, meters.
    pub(super) travelled_m: f64,
    pub(super) speed_mps: f64,
    pub(super) acceleration_mps2: f64,
}

impl Profile {
    /// Accelerates constantly to a higher speed, without a jerk limit.
    pub(super) fn steady(from_mps: f64, to_mps: f64, acceleration_mps2: f64) -> Self {
        let rise_s = ((to_mps - from_mps) / acceleration_mps2).max(0.0);
        // The acceleration drops to 0 at the end of the only segment.
        Self { start_mps: from_mps, start_mps2: acceleration_mps2, pieces: vec![(rise_s, 0.0)] }
    }

    /// Creates the fastest profile from a speed and acceleration to a constant speed, within limits of
    /// acceleration and jerk. Its segments are jerk, constant acceleration and opposite jerk. The speed never
    /// falls below 0; an initial acceleration beyond its limit is clamped.
    pub(super) fn smooth(from: (f64, f64), to_mps: f64, limit_mps2: f64, jerk_mps3: f64) -> Self {
        let start_mps = from.0.max(0.0);
        let start_mps2 = from.1.clamp(-limit_mps2.min((2.0 * jerk_mps3 * start_mps).sqrt()), limit_mps2);
        // The speed reached when the acceleration ramps directly to 0 determines the direction of the first
        // jerk.
        let eased_mps = start_mps + start_mps2 * start_mps2.abs() / (2.0 * jerk_mps3);
        let sign = if to_mps < eased_mps { -1.0 } else { 1.0 };
        let (gain, first) = (sign * (to_mps - start_mps), sign * start_mps2);
        let peak = (jerk_mps3 * gain + first * first / 2.0).max(0.0).sqrt().min(limit_mps2);
        let ramps = (2.0 * peak * peak - first * first) / (2.0 * jerk_mps3);
        let hold_s = if peak > 0.0 { ((gain - ramps) / peak).max(0.0) } else { 0.0 };
        let rise_s = ((peak - first) / jerk_mps3).max(0.0);
        let jerk = sign * jerk_mps3;
        Self { start_mps, start_mps2, pieces: vec![(rise_s, jerk), (hold_s, 0.0), (peak / jerk_mps3, -jerk)] }
    }

    /// Returns the duration of the speed change, seconds.
    #[cfg(test)]
    pub(super) fn length_s(&self) -> f64 {
        self.pieces.iter().map(|(length_s, _)| length_s).sum()
    }

    /// Returns the state at a non-negative time since the start, seconds.
    pub(super) fn at(&self, time_s: f64) -> ProfileState {
        let (mut travelled_m, mut v, mut a, mut left_s) = (0.0, self.start_mps, self.start_mps2, time_s);
        for &(length_s, jerk) in &self.pieces {
            let t = left_s.min(length_s);
            travelled_m += t * (v + t * (a / 2.0 + t * jerk / 6.0));
            v += t * (a + t * jerk / 2.0);
            a += t * jerk;
            left_s -= t;
            if left_s <= 0.0 {
                return ProfileState { travelled_m, speed_mps: v, acceleration_mps2: a };
            }
        }
        ProfileState { travelled_m: travelled_m + left_s * v, speed_mps: v, acceleration_mps2: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn steady_acceleration_then_constant_speed() {
        let profile = Profile::steady(3.0, 6.0, 0.6);
        let drive = profile.at(2.0);
        assert!((drive.travelled_m - 7.2).abs() < 1e-12 && (drive.speed_mps - 4.2).abs() < 1e-12);
        let drive = profile.at(7.0);
        assert!((drive.travelled_m - (22.5 + 12.0)).abs() < 1e-9 && (drive.speed_mps - 6.0).abs() < 1e-12);
        assert_eq!(Profile::steady(8.0, 8.0, 0.6).at(2.0).travelled_m, 16.0);
    }

    proptest! {
        #[test]
        fn smooth_profiles_keep_their_limits(v in 0.0..30.0, a in -4.0..4.0) {
            let (limit, jerk) = (1.5, 2.0);
            let profile = Profile::smooth((v, a), 10.0, limit, jerk);
            prop_assert!((profile.at(profile.length_s()).speed_mps - 10.0).abs() < 1e-9);
            prop_assert!((profile.at(profile.length_s() + 3.0).speed_mps - 10.0).abs() < 1e-9);
            prop_assert!(profile.at(profile.length_s()).acceleration_mps2.abs() < 1e-9);
            let dt = 1e-3;
            let count = (profile.length_s() / dt) as usize + 10;
            let mut before = profile.at(0.0);
            prop_assert!(before.speed_mps == v && before.acceleration_mps2.abs() <= limit);
            for i in 1..count {
                let drive = profile.at(i as f64 * dt);
                prop_assert!(drive.speed_mps >= -1e-9 && drive.acceleration_mps2.abs() <= limit + 1e-9);
                // The derivatives are consistent, whatever the segments: the trapezoidal rule is exact to dt
                // squared.
                let distance_m = (before.speed_mps + drive.speed_mps) / 2.0 * dt;
                prop_assert!((drive.travelled_m - before.travelled_m - distance_m).abs() < 1e-8);
                let rise = (before.acceleration_mps2 + drive.acceleration_mps2) / 2.0 * dt;
                prop_assert!((drive.speed_mps - before.speed_mps - rise).abs() < 1e-5);
                prop_assert!((drive.acceleration_mps2 - before.acceleration_mps2).abs() <= jerk * dt + 1e-9);
                before = drive;
            }
        }
    }
}
