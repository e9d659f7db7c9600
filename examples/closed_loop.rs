//! Simulates 20 steps in closed loop, with the ego driving straight on among reactive vehicles, and renders
//! every step: `cargo run --release -p pskel-sim --example closed_loop --
//! nuscenes:/data/nuscenes@v1.0-mini#scene-0061 out`.

use std::path::Path;

use point_skeleton::{Log, RenderOptions, Renderer, Skeleton};
use pskel_sim::{ActorPolicy, EgoPolicy, Rates, Scenario, SimOptions, Simulation, scene_state};

/// Runs the example.
pub fn run(log: &str, steps: usize, out: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let log = Log::open(log)?;
    let skeleton = Skeleton::build(&log, out.join("skeleton"), &Default::default())?;
    let mut renderer = Renderer::new(&skeleton, RenderOptions::default())?;

    let record = log.recording();
    let scenario = Scenario { log: record, map: log.map(), rates: Rates::default() };
    let (ego, actors) = (EgoPolicy::Straight, ActorPolicy::Idm);
    let mut simulation =
        Simulation::new(&scenario, SimOptions { steps, ego, actors, ..SimOptions::default() })?;
    loop {
        let state = scene_state(record, simulation.committed().get(), log.map());
        renderer.render(&state)?.write(out.join("steps").join(&state.name))?;
        if simulation.step()?.is_none() {
            return Ok(());
        }
    }
}

#[allow(dead_code)] // the tests call `run`
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, log, out] = args.as_slice() else { panic!("expected LOG OUT") };
    run(log, 20, out.as_ref())
}
