//! Condition maps of a [`SceneSequence`] in an output folder.
//!
//! A step has a folder with maps, contact sheet, `meta.json` and optionally a bird's-eye view; `index.json`
//! is written last. Another thread writes a step while the next ones are rendered.

use std::sync::mpsc::{Receiver, SyncSender};

use serde::Serialize;

use crate::conditions::birdseye::{self, BirdseyeOptions};
use crate::conditions::view::sheet;
use crate::conditions::write::meta::{Index, IndexFrame, PromptParts};
use crate::conditions::{DepthBins, MapFormat};
use crate::files::OutputFolder;
use crate::lidar::{LidarFormat, LidarSpec, LidarSweep, Motion};
use crate::pipeline::write_beside;
use crate::scene::SceneSequence;
use crate::{Error, Maps, Renderer};

const INDEX: &str = "index.json";
const META: &str = "meta.json";

/// LiDAR sweeps that are written beside the maps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LidarOutput {
    /// Devices.
    #[serde(rename = "lidar")]
    pub spec: LidarSpec,
    /// Format of the points.
    #[serde(rename = "lidar_format")]
    pub format: LidarFormat,
}

/// Output folder for a sequence of maps.
pub struct SequenceWriter<'a> {
    /// The folder.
    pub folder: OutputFolder,
    /// File format of the maps.
    pub format: MapFormat,
    /// Depth bins of the contact sheets.
    pub bins: &'a DepthBins,
    /// Parts of the prompt in `meta.json`.
    pub prompt: &'a PromptParts,
    /// Frame rate in `meta.json`, per second.
    pub fps: Option<f64>,
    /// `true` to write bird's-eye views.
    pub birdseye: bool,
    /// LiDAR sweeps; `None` for maps alone.
    pub lidar: Option<&'a LidarOutput>,
    /// Name of the log, for captions.
    pub log: &'a str,
}

/// What is written of a step.
type Step = (Maps, Option<LidarSweep>);

impl SequenceWriter<'_> {
    /// Renders all states and writes them and an index with `options`. Steps of an earlier run in the folder
    /// are replaced one by one; its index is removed first, since a folder with an index is complete. Calls
    /// `on_step` with the name of each rendered step. Returns the entries of the index.
    ///
    /// # Errors
    /// Fails if a step cannot be rendered, or if a file cannot be written or is not of an earlier run.
    pub fn write(
        self,
        renderer: &mut Renderer<'_>,
        states: &SceneSequence<'_>,
        options: &impl Serialize,
        on_step: &mut dyn FnMut(&str),
    ) -> Result<Vec<IndexFrame>, Error> {
        if let Some(state) = states.states().next() {
            renderer.check_memory(&state?)?;
        }
        self.folder.check(states.names())?;
        self.folder.remove([INDEX])?;
        let index = Index { options, frames: self.write_steps(renderer, states, on_step)? };
        index.write(&self.folder.claim(INDEX)?)?;
        self.folder.close()?;
        Ok(index.frames)
    }

    fn write_steps(
        &self,
        renderer: &mut Renderer<'_>,
        states: &SceneSequence<'_>,
        on_step: &mut dyn FnMut(&str),
    ) -> Result<Vec<IndexFrame>, Error> {
        let mut frames = Vec::new();
        let write = |steps: Receiver<Step>| steps.into_iter().try_for_each(|step| self.write_step(&step));
        let render = |sender: SyncSender<Step>| {
            let mut send = |maps: Maps, sweep| {
                frames.push(IndexFrame::new(&maps.state));
                on_step(&maps.state.name);
                sender.send((maps, sweep)).is_ok()
            };
            let Some(lidar) = self.lidar else {
                let states = states.states().map(|state| Ok::<_, Error>(((), state?)));
                return renderer.render_each(states, |(), maps| send(maps, None));
            };
            for state in states.states() {
                let state = state?;
                let other = states.beside(&state, lidar.spec.duration_s());
                let sweep = renderer.lidar(&lidar.spec, &Motion::new(&state, other.as_ref()));
                let both = sweep.and_then(|sweep| Ok((renderer.render(&state)?, sweep)));
                let (maps, sweep) = both.map_err(Error::step(&state.name))?;
                if !send(maps, Some(sweep)) {
                    break;
                }
            }
            Ok(())
        };
        let (rendered, written) = write_beside("the thread that writes maps", write, render)?;
        written.and(rendered).map(|()| frames)
    }

    fn write_step(&self, (maps, sweep): &Step) -> Result<(), Error> {
        let state = &maps.state;
        self.folder.write_folder(&state.name, |folder| {
            let caption = format!("{}  {}", self.log, state.name);
            let (written, sheet) = rayon::join(
                || maps.write_maps(folder, self.format),
                || sheet::write(&folder.join("sheet.png"), &maps.set, self.bins, &caption),
            );
            written.and(sheet.map_err(Error::from))?;
            if self.birdseye {
                birdseye::write(&folder.join("birdseye.png"), state, &BirdseyeOptions::default())?;
            }
            if let (Some(sweep), Some(lidar)) = (sweep, self.lidar) {
                sweep.write(folder, lidar.format)?;
            }
            Ok(maps.meta(self.prompt, self.fps).write(&folder.join(META))?)
        })
    }
}
