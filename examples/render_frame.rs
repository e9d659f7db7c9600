//! Renders the first frame of a recorded log from two meters further left:
//! `cargo run --release --example render_frame -- nuscenes:/data/nuscenes@v1.0-mini#scene-0061 out`.

use std::path::Path;

use point_skeleton::{EgoOffset, Error, Log, RenderOptions, Renderer, Skeleton};

/// Runs the example.
pub fn run(log: &str, out: &Path) -> Result<(), Error> {
    let log = Log::open(log)?;
    let skeleton = Skeleton::build(&log, out.join("skeleton"), &Default::default())?;
    let mut renderer = Renderer::new(&skeleton, RenderOptions::default())?;
    for frame in log.frames().take(1) {
        let left = EgoOffset { left_m: 2.0, ..EgoOffset::default() };
        renderer.render(&frame.moved(left))?.write(out.join("maps").join(&frame.name))?;
    }
    Ok(())
}

#[allow(dead_code)] // the tests call `run`
fn main() -> Result<(), Error> {
    let args: Vec<String> = std::env::args().collect();
    let [_, log, out] = args.as_slice() else { panic!("expected LOG OUT") };
    run(log, out.as_ref())
}
