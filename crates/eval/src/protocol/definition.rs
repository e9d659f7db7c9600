use pskel_sim::{EgoPolicy, Rates};

use super::nuscenes_val::SCENES;
use super::simgen::SIMGEN;
use point_skeleton::named;

/// An evaluation protocol of the paper *Point as Skeleton*. Source: the configurations of its reference
/// implementation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Ten nuPlan logs, replayed in clips and driven off the log.
    NuplanSimgen,
    /// The 150 validation scenes of nuScenes, replayed.
    NuscenesVal,
    /// Lane changes in any logs.
    LaneChange,
}

named!(Protocol, "protocol" {
    NuplanSimgen => "nuplan-simgen",
        "Ten nuPlan logs: clips of 20 frames at 5 Hz, 30 lane changes per log, and three other policies";
    NuscenesVal => "nuscenes-val",
        "150 scenes of nuScenes: 24 frames at 6 Hz, 16 at 2 Hz with a copy of the data set, 100 at 6 Hz";
    LaneChange => "lane-change", "Any logs: 10 s that follow the log, and with a lane change";
});

/// Part of a protocol: clips with the same policy, rates and length.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Name, also of its folder.
    pub name: &'static str,
    /// Policy of the ego after the references.
    pub ego: EgoPolicy,
    /// Rates of simulation and generation.
    pub rates: PartRates,
    /// Length of a clip.
    pub length: Length,
    /// Where the clips start in a log.
    pub starts: Starts,
    /// Whether the part runs only if it is selected.
    pub is_optional: bool,
    /// Whether the images are also written into a copy of the data set, for perception models; by default
    /// in the protocol's definition.
    pub copies_dataset: bool,
}

/// Rates of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PartRates {
    /// The log's own frames, as close as possible to this rate in hertz.
    Frames(f64),
    /// Fixed rates.
    Fixed(Rates),
    /// The default rates of the log's format.
    OfLog,
}

/// Length of a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Length {
    /// Number of frames, with the references.
    Frames(usize),
    /// Number of generated frames, after the references.
    Generated(usize),
    /// Duration of the generated frames, seconds.
    GeneratedS(f64),
}

/// Starts of the clips in a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Starts {
    /// One clip, at the start of the log.
    First,
    /// At the start, and then every so many seconds.
    EveryS(f64),
    /// So many clips, evenly spaced from the start to the end of the log; fewer if two of them would start
    /// within a frame.
    Spread(usize),
}

/// Rates of nuPlan.
const FIVE_HZ: PartRates = PartRates::Fixed(Rates { sim_hz: 10.0, plan_hz: 5.0 });
/// Rates of nuScenes with annotations at 12 Hz.
const SIX_HZ: PartRates = PartRates::Fixed(Rates { sim_hz: 12.0, plan_hz: 6.0 });
/// Name of the part that follows the log.
const REPLAY: &str = "replay";

impl Protocol {
    /// Returns the names of its logs; none if it is defined for any logs.
    pub fn logs(self) -> Vec<String> {
        match self {
            Self::NuplanSimgen => SIMGEN.map(str::to_owned).to_vec(),
            Self::NuscenesVal => SCENES.iter().map(|number| format!("scene-{number:04}")).collect(),
            Self::LaneChange => Vec::new(),
        }
    }

    /// Returns its parts, in order.
    pub fn parts(self) -> Vec<Part> {
        match self {
            Self::NuplanSimgen => {
                let clips = replay(REPLAY, FIVE_HZ, Length::Frames(20));
                let clips = Part { starts: Starts::EveryS(10.0), ..clips };
                // 60 steps at 10 Hz.
                let off_log = |ego| off_log_part(ego, FIVE_HZ, Length::Frames(31));
                let change = Part { starts: Starts::Spread(30), ..off_log(EgoPolicy::LaneChange) };
                let others = [EgoPolicy::Straight, EgoPolicy::RightThenBack, EgoPolicy::Cosine];
                let others = others.map(|ego| Part { is_optional: true, ..off_log(ego) });
                [clips, change].into_iter().chain(others).collect()
            }
            Self::NuscenesVal => vec![
                replay("6hz", SIX_HZ, Length::Generated(24)),
                Part { copies_dataset: true, ..replay("2hz", PartRates::Frames(2.0), Length::Generated(16)) },
                replay("long", SIX_HZ, Length::Frames(100)),
            ],
            Self::LaneChange => vec![
                replay(REPLAY, PartRates::OfLog, Length::GeneratedS(10.0)),
                off_log_part(EgoPolicy::LaneChange, PartRates::OfLog, Length::GeneratedS(10.0)),
            ],
        }
    }
}

/// Returns a part that follows the log, with one clip per log.
fn replay(name: &'static str, rates: PartRates, length: Length) -> Part {
    let starts = Starts::First;
    Part { name, ego: EgoPolicy::Replay, rates, length, starts, is_optional: false, copies_dataset: false }
}

/// Returns a part that leaves the log, with one clip per log.
fn off_log_part(ego: EgoPolicy, rates: PartRates, length: Length) -> Part {
    let name = ego.name();
    Part { ego, ..replay(name, rates, length) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protocols_have_their_logs_and_parts() {
        let names = |protocol: Protocol| protocol.parts().iter().map(|part| part.name).collect::<Vec<_>>();
        assert_eq!(
            names(Protocol::NuplanSimgen),
            ["replay", "lane_change", "straight", "right_then_back", "cosine"]
        );
        let optional = |part: &Part| part.is_optional;
        assert_eq!(Protocol::NuplanSimgen.parts().iter().filter(|part| optional(part)).count(), 3);
        assert_eq!(names(Protocol::NuscenesVal), ["6hz", "2hz", "long"]);
        assert_eq!(names(Protocol::LaneChange), ["replay", "lane_change"]);
        let logs = Protocol::NuscenesVal.logs();
        assert_eq!(logs.len(), 150);
        assert_eq!((logs[0].as_str(), logs[149].as_str()), ("scene-0003", "scene-1073"));
        assert!(logs.is_sorted() && logs.windows(2).all(|pair| pair[0] != pair[1]));
        assert_eq!(Protocol::NuplanSimgen.logs().len(), 10);
        assert!(Protocol::LaneChange.logs().is_empty());
    }
}
