//! Forecasts of a closed loop that drives on after the end of the log.

use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{LogLocator, LogReader};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{RasterizerDesc, RasterizerKind};
use point_skeleton::skeleton::BuildOptions;
use point_skeleton::{RenderOptions, Renderer};
use pskel_generate::{Conditioner, Recipe};
use pskel_sim::{EgoPolicy, Forecast, Instant, Rates, Scenario, SimOptions, Simulation, scene_state};
use pskel_testing::shared::skeleton_of;
use pskel_testing::tiny_log::TinyLog;

/// The ego drives at 2 m/s; presets have at least 3 m/s and accelerate.
#[test]
fn forecasts_continue_after_the_end_of_the_log() {
    let folder = TinyLog::new();
    let dataset =
        NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, folder.path("log")))
            .unwrap();
    let log = dataset.recording();
    let skeleton = skeleton_of(&folder.path("sk"), &dataset, &[0, 1, 2], &BuildOptions::default());
    let rasterizer = RasterizerDesc::from(RasterizerKind::Cpu);
    let render = RenderOptions { rasterizer, log: Some(&log.name), ..RenderOptions::default() };
    let mut renderer = Renderer::new(&skeleton, render).unwrap();
    let size = ImageSize { height: 16, width: 24 };
    let recipe = Recipe { drawn: size, size, ..Recipe::default() };
    let conditioner = Conditioner::new(&recipe, false, "");
    let end_us = log.frames[log.frames.len() - 1].t_us;
    let scenario = Scenario { log, map: None, rates: Rates { sim_hz: 10.0, plan_hz: 5.0 } };
    for ego in [EgoPolicy::Straight, EgoPolicy::Replay] {
        let options = SimOptions { steps: 20, ego: ego.clone(), ..SimOptions::default() };
        let mut simulation = Simulation::new(&scenario, options).unwrap();
        let mut seen = Vec::new();
        loop {
            let now_us = simulation.committed().get().t_us;
            let state = |instant: &Instant| scene_state(log, instant, None);
            let now = simulation.committed().map(state);
            let expected: Vec<_> =
                simulation.forecast(3).into_iter().map(|next| next.map(|next| state(&next))).collect();
            let forecasts = conditioner.forecasts(now.as_ref(), &expected, &mut renderer).unwrap();
            seen.push((now_us > end_us, forecasts.len()));
            // The window is not frozen: the ego moves in each forecast.
            assert!(forecasts.iter().all(|forecast: &Forecast<_>| forecast.get().action[0] > 0.1));
            if simulation.step().unwrap().is_none() {
                break;
            }
        }
        match ego {
            EgoPolicy::Replay => {
                // The log has 10 steps, and a plan is two: 5, 4 and 3 steps before the end, two forecasts are
                // in the log.
                let counts: Vec<usize> = seen.iter().map(|(_, count)| *count).collect();
                assert_eq!(counts, [3, 3, 3, 3, 3, 2, 2, 1, 1, 0, 0]);
            }
            _ => assert_eq!(seen.iter().filter(|step| **step == (true, 3)).count(), 10),
        }
    }
}
