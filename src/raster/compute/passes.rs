//! Passes that grow windows of keys (`spread`).

use crate::raster::{SplatSchedule, SplatStep};

/// One pass of window growth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pass {
    /// Radius of the previous windows, pixels.
    pub(super) radius: u32,
    /// Distance between adjacent windows of the nine, pixels.
    pub(super) step: u32,
    /// Bits of the depth up to which the previous windows are squares; 0 if their radius is not in the
    /// schedule.
    pub(super) bound: u32,
    /// The same for the grown windows.
    pub(super) next_bound: u32,
}

/// Returns the passes for a schedule whose maximum radius exceeds 1.
pub(super) fn passes(schedule: &SplatSchedule) -> Vec<Pass> {
    let mut radii: Vec<u32> = schedule.steps().iter().map(|step| step.radius).collect();
    radii.sort_unstable();
    radii.dedup();
    let bound = |radius: u32| {
        let covers = |step: &&SplatStep| step.radius >= radius;
        let farthest = schedule.steps().iter().rfind(covers).filter(|_| radii.contains(&radius));
        farthest.map_or(0, |step| step.z_max_m.to_bits())
    };
    let (mut passes, mut radius) = (Vec::new(), 0);
    for target in &radii {
        while radius < *target {
            // With this limit, three windows in a row leave no gap between them.
            let step = (target - radius).min(2 * radius + 1);
            passes.push(Pass { radius, step, bound: bound(radius), next_bound: bound(radius + step) });
            radius += step;
        }
    }
    passes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passes_of(schedule: &str) -> Vec<(u32, u32, bool)> {
        let passes = passes(&schedule.parse().unwrap());
        passes.iter().map(|pass| (pass.radius, pass.step, pass.bound > 0)).collect()
    }

    #[test]
    fn windows_grow_by_at_most_three_and_stop_at_each_radius() {
        assert_eq!(passes_of("9:31"), [(0, 1, false), (1, 3, false), (4, 9, false), (13, 18, false)]);
        assert_eq!(passes_of("9:3"), [(0, 1, false), (1, 2, false)]);
        let steps = passes_of("5:12,6:12,9:4,20:0");
        assert_eq!(steps, [(0, 1, true), (1, 3, false), (4, 8, true)]);
        let schedule: SplatSchedule = "5:12,6:12,9:4,20:0".parse().unwrap();
        let bounds: Vec<u32> = passes(&schedule).iter().map(|pass| pass.next_bound).collect();
        assert_eq!(bounds, [0, 9.0_f32.to_bits(), 6.0_f32.to_bits()]);
    }

    #[test]
    fn nine_windows_cover_the_larger_one() {
        for radius in 3..=SplatSchedule::MAX_RADIUS {
            let steps =
                (2..16).map(|i| SplatStep { z_max_m: i as f32, radius: radius.saturating_sub(2 * i) });
            let first = SplatStep { z_max_m: 1.0, radius };
            let schedule = SplatSchedule::new(std::iter::once(first).chain(steps).collect()).unwrap();
            let passes = passes(&schedule);
            for pass in &passes {
                assert!(pass.step <= 2 * pass.radius + 1, "{pass:?} has gaps");
            }
            let ends: Vec<u32> = passes.iter().map(|pass| pass.radius + pass.step).collect();
            assert!(schedule.steps().iter().all(|s| s.radius == 0 || ends.contains(&s.radius)));
            assert_eq!(ends.last(), Some(&radius));
        }
    }
}
