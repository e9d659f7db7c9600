//! First message to the planner, and its answer.

use std::path::Path;

use point_skeleton::dataset::{MapFiles, NavigationRoute};
use serde::{Deserialize, Serialize};

use super::unreadable::unreadable;
use crate::clock::Clock;
use crate::peer::ProtocolError;
use crate::recorded::Recorded;
use crate::{EGO_SIZE_M, REAR_AXLE_TO_CENTER_M, SimOptions, WHEELBASE_M};

const PROTOCOL: &str = "pskel-planner";
const VERSION: u32 = 1;

#[derive(Serialize)]
pub(super) struct Hello<'a> {
    protocol: &'static str,
    version: u32,
    log: &'a str,
    seed: u64,
    sim_hz: f64,
    plan_hz: f64,
    step: usize,
    ego: EgoSize,
    map: Option<Map<'a>>,
    /// Roadblocks of the route at the first plan.
    route: &'a [String],
    goal: Option<Goal>,
}

#[derive(Serialize)]
struct EgoSize {
    length: f64,
    width: f64,
    height: f64,
    rear_axle_to_center: f64,
    wheelbase: f64,
}

#[derive(Serialize)]
struct Map<'a> {
    name: &'a str,
    root: &'a Path,
}

#[derive(Serialize)]
struct Goal {
    x: f64,
    y: f64,
    heading: f64,
}

#[derive(Deserialize)]
struct Answer {
    protocol: String,
    version: u32,
}

impl<'a> Hello<'a> {
    pub(super) fn new(options: &SimOptions, clock: &Clock, recorded: &'a Recorded<'_>, step: usize) -> Self {
        let size = EGO_SIZE_M;
        let log = recorded.log;
        let route = log.route_at(clock.at(clock.takeover));
        Self {
            protocol: PROTOCOL,
            version: VERSION,
            log: &log.name,
            seed: options.seed,
            sim_hz: clock.rates.sim_hz,
            plan_hz: clock.rates.plan_hz,
            step,
            ego: EgoSize {
                length: size.x,
                width: size.y,
                height: size.z,
                rear_axle_to_center: REAR_AXLE_TO_CENTER_M,
                wheelbase: WHEELBASE_M,
            },
            map: log.map_files.as_ref().map(|MapFiles { name, root }| Map { name, root }),
            route: route.map_or(&[], |route| &route.roadblocks),
            goal: route.and_then(Goal::of),
        }
    }
}

impl Goal {
    fn of(route: &NavigationRoute) -> Option<Self> {
        let goal = route.goal.as_ref()?;
        Some(Self { x: goal.translation.x, y: goal.translation.y, heading: goal.yaw_rad() })
    }
}

/// Validates the reply to the hello message.
pub(super) fn read_hello(answer: &[u8]) -> Result<(), ProtocolError> {
    let expected = format!("{{\"protocol\": \"{PROTOCOL}\", \"version\": {VERSION}}}");
    let hello: Answer = serde_json::from_slice(answer)
        .map_err(|e| ProtocolError::new(expected.clone(), unreadable(answer, &e)))?;
    if (hello.protocol.as_str(), hello.version) == (PROTOCOL, VERSION) {
        return Ok(());
    }
    Err(ProtocolError::new(expected, format!("{:?} of version {}", hello.protocol, hello.version)))
}
