//! Last line of a rollout: its results, then its times.

use point_skeleton::raster::RasterizerInfo;
use pskel_sim::rollout::RolloutReport;
use pskel_sim::{Comfort, EndReason, Metrics, Range};

/// The rollout as it was planned.
pub(super) struct Planned {
    pub(super) steps: usize,
    /// Policy of the ego.
    pub(super) ego: &'static str,
    /// Policy of the other actors.
    pub(super) actors: &'static str,
    /// Whether steps are the log's own frames.
    pub(super) is_open_loop: bool,
}

/// Formats the line.
pub(super) fn summary(planned: &Planned, report: &RolloutReport, info: &RasterizerInfo) -> String {
    let RasterizerInfo { rasterizer, device, .. } = info;
    let notes = report.notes.iter().map(|(note, count)| format!("{count} x {note}"));
    let parts = report.note_beyond_log().into_iter().chain(notes).chain([report.profile.summary()]);
    // The ego of a replayed log has no results.
    if planned.is_open_loop {
        let parts: Vec<String> = parts.collect();
        return format!(
            "replayed {} frames by {rasterizer} on {device}: {}",
            report.rows.len(),
            parts.join("; ")
        );
    }
    let parts: Vec<String> = [results(&report.metrics)].into_iter().chain(parts).collect();
    let steps = report.rows.len().saturating_sub(1);
    let ended = match report.ended {
        Some(EndReason::LogEnded) => format!(" of {} (the log ended)", planned.steps),
        _ => String::new(),
    };
    let Planned { ego, actors, .. } = planned;
    format!(
        "simulated {steps} steps{ended}, ego {ego}, actors {actors}, by {rasterizer} on {device}: {}",
        parts.join("; ")
    )
}

/// Formats collisions, comfort and deviation from the recorded path.
fn results(metrics: &Metrics) -> String {
    let collisions = match (metrics.collisions.len(), metrics.at_fault_collisions) {
        (0, _) => "0 collisions".to_owned(),
        (1, 0) => "1 collision".to_owned(),
        (1, _) => "1 collision, the ego's fault".to_owned(),
        (count, fault) => format!("{count} collisions, {fault} the ego's fault"),
    };
    format!(
        "{collisions}; {}; deviation from the recorded path at most {:.2} m and {:.1} degrees",
        comfort(&metrics.comfort),
        metrics.lateral_deviation_m.max,
        metrics.heading_deviation_rad.max.to_degrees(),
    )
}

fn comfort(comfort: &Comfort) -> String {
    if comfort.comfortable {
        return "comfortable".to_owned();
    }
    let range = |range: Option<Range>| range.map_or([0.0; 2], |range| [range.min, range.max]);
    let most = |values: Option<Range>| range(values).into_iter().map(f64::abs).fold(0.0, f64::max);
    let [brake, speed_up] = range(comfort.longitudinal_mps2);
    format!(
        "not comfortable ({brake:.1} to {speed_up:.1} m/s\u{b2} along, {:.1} m/s\u{b2} across, jerk {:.1} \
            m/s\u{b3}, \
         yaw rate {:.2} rad/s)",
        most(comfort.lateral_mps2),
        comfort.max_jerk_mps3,
        most(comfort.yaw_rate_radps),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::dataset::Class;
    use pskel_sim::{Collision, CollisionKind, Deviation};

    fn metrics(faults: &[bool]) -> Metrics {
        let collision = |at_fault: &bool| Collision {
            step: 1,
            t_us: 0,
            track: "t".into(),
            class: Class::Object,
            kind: CollisionKind::Front,
            at_fault: Some(*at_fault),
            ego_speed_mps: 1.0,
            actor_speed_mps: 0.0,
        };
        Metrics {
            steps: 2,
            seconds: 0.2,
            collisions: faults.iter().map(collision).collect(),
            at_fault_collisions: faults.iter().filter(|fault| **fault).count(),
            off_road: None,
            progress_m: 1.0,
            log_progress_m: 1.0,
            lateral_deviation_m: Deviation { mean: 0.1, max: 0.456, end: 0.0 },
            heading_deviation_rad: Deviation { mean: 0.0, max: 0.1, end: 0.0 },
            comfort: Comfort { comfortable: true, ..Comfort::default() },
            min_time_to_collision_s: None,
        }
    }

    #[test]
    fn formats_short_results() {
        let smooth = "; comfortable; deviation from the recorded path at most 0.46 m and 5.7 degrees";
        for (faults, begin) in [
            (&[][..], "0 collisions"),
            (&[false], "1 collision"),
            (&[true], "1 collision, the ego's fault"),
            (&[true, false, true], "3 collisions, 2 the ego's fault"),
        ] {
            assert_eq!(results(&metrics(faults)), format!("{begin}{smooth}"));
        }
        let rough = Comfort {
            comfortable: false,
            longitudinal_mps2: Some(Range { min: -5.06, max: 1.0 }),
            lateral_mps2: Some(Range { min: -2.0, max: 0.5 }),
            yaw_rate_radps: Some(Range { min: -0.25, max: 0.5 }),
            max_jerk_mps3: 9.04,
        };
        assert_eq!(
            comfort(&rough),
            "not comfortable (-5.1 to 1.0 m/s\u{b2} along, 2.0 m/s\u{b2} across, jerk 9.0 m/s\u{b3}, yaw \
                rate 0.50 rad/s)"
        );
    }
}
