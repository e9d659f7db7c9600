//! Generates the clips of an evaluation protocol and scores them. Each clip is a rollout of `pskel simulate`
//! in its own folder.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use point_skeleton::Log;
use point_skeleton::dataset::{LogLocator, LogOpener};
use point_skeleton::error::{FileError, with_causes};
use point_skeleton::files::input::is_there;
use point_skeleton::files::{OutputFolder, write_json, write_whole};
use point_skeleton::skeleton;
use pskel_eval::protocol::{Clip, Method, Part, PartRollouts, Protocol, ProtocolReport, ScoreOptions};
use pskel_generate::{ClipFrames, ClipImages, CopiedLog, Counted, DatasetCopy, ImageFolder, ImportCounts};
use pskel_sim::report::ROLLOUT;
use pskel_sim::rollout::{self, InputPaths, RolloutInputs};
use pskel_sim::{ActorPolicy, EgoPolicy, Rates, Scenario};
use serde_json::json;

use super::super::simulate::{self, ClipArgs, SimulateArgs};
use super::clip_args::ClipProtocolArgs;
use super::copy::check_one_dataset;
use crate::args::outputs::FolderArgs;
use crate::args::rollout::RolloutArgs;
use crate::args::source::SourceArgs;
use crate::progress::Progress;
use crate::{WrongUsage, logs, print_progress, print_result};

/// Files in the folder itself.
const FILES: [&str; 3] = ["protocol.json", "results.json", "table.md"];

/// A run of the command.
struct Run<'a> {
    protocol: Protocol,
    args: &'a ClipProtocolArgs,
    /// Keeps the tables of a data set between its logs.
    opener: Arc<LogOpener>,
    /// Copy of the data set, if a part has one.
    copy: Option<DatasetCopy<'a>>,
    files: &'a OutputFolder,
    /// Number of reference frames of the generator.
    references: usize,
    /// Images of another program, and what was found of them.
    images: Option<(ImageFolder, ImportCounts)>,
    /// Parts and their rollouts so far.
    parts: Vec<PartRollouts>,
    /// Logs whose images are copied into a data set, with their rollouts.
    copied: Vec<(Rc<Log>, PathBuf)>,
    /// Names of the logs with rollouts.
    logs: Vec<String>,
}

/// Generates and scores the clips of a protocol, writes the table.
pub(super) fn run(protocol: Protocol, args: &ClipProtocolArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    args.generator.check()?;
    args.maps.check()?;
    let parts = args.parts(protocol)?;
    let opener = Arc::default();
    let logs = args.logs(protocol, &opener)?;
    let images = args.images.open()?.map(|folder| (folder, ImportCounts::default()));
    let copied = parts.iter().find(|part| part.copies_dataset);
    if let (Some(part), Some(_)) = (copied, args.scenario.file()) {
        let message = format!(
            "expected no --scenario with a copy of the data set (part {}), whose boxes stay as they are",
            part.name
        );
        return Err(WrongUsage(message).into());
    }
    copied.map_or(Ok(()), |part| check_one_dataset(part, &logs).and(args.lidar.check_copy()))?;
    let files = OutputFolder::open(&args.given.folder.out, "protocol", &args.inputs(&logs))?;
    files.check(FILES)?;
    let dataset = files.folder("dataset")?;
    let copy = copied.map(|_| DatasetCopy::open(&logs[0], &dataset, None)).transpose()?;
    parts.iter().try_for_each(|part| files.folder(part.name).map(drop))?;
    let references =
        args.settle(protocol, &logs, &opener, &files, images.as_ref().map(|(folder, _)| folder))?;
    let parts = parts.into_iter().map(|part| PartRollouts { part, folders: Vec::new(), frames: 0 }).collect();
    let (copied, names) = Default::default();
    let mut run =
        Run { protocol, args, opener, copy, files: &files, references, images, parts, copied, logs: names };
    let mut failures = 0_usize;
    for locator in &logs {
        if let Err(error) = run.generate(locator) {
            print_progress(&format!("failed: {locator}: {}", with_causes(error.as_ref())));
            failures += 1;
        }
    }
    anyhow::ensure!(failures < logs.len(), "every recording failed: {failures}");
    run.finish(&dataset)?;
    files.close()?;
    let (count, seconds) = (logs.len(), start.elapsed().as_secs_f64());
    let plural = if count == 1 { "" } else { "s" };
    print_result(&format!(
        "{count} recording{plural} in {seconds:.2} s: {}",
        args.given.folder.out.display()
    ));
    anyhow::ensure!(failures == 0, "failed recordings: {failures}");
    Ok(())
}

impl Run<'_> {
    /// Generates the clips of a log in all parts, after building its skeleton if it does not exist.
    fn generate(&mut self, locator: &LogLocator) -> anyhow::Result<()> {
        let opened = logs::open_by(locator, &self.opener)?;
        let source = Rc::new(opened.edited(&self.args.scenario.read_for(&opened)?)?);
        let log = source.recording();
        anyhow::ensure!(!self.logs.contains(&log.name), "expected each name once, found {} again", log.name);
        self.copy.as_ref().map_or(Ok(()), |copy| copy.check(log))?;
        let rates = Rates::of(locator.format, log);
        self.parts.iter().try_for_each(|rollouts| rollouts.part.check_copy(log, rates))?;
        let skeleton = self.args.given.skeletons.skeletons.join(&log.name);
        if !skeleton.exists() {
            print_progress(&format!("building {}", skeleton.display()));
        }
        let built = skeleton::open_or_build(&skeleton, source.unedited_reader())?;
        let limit = self.args.clips.map_or(usize::MAX, usize::from);
        let scenario = Scenario { log, map: source.require_map()?, rates };
        let paths = InputPaths {
            log: &locator.path,
            skeleton: &skeleton,
            prompt: self.args.prompt.annotations.as_deref(),
        };
        let prompt = &self.args.prompt.read()?;
        let inputs = RolloutInputs { scenario: &scenario, skeleton: &built, prompt, paths };
        let (mut done, mut counts) = (Vec::new(), ImportCounts::default());
        let is_only_part = self.parts.len() == 1;
        for (place, PartRollouts { part, .. }) in self.parts.iter().enumerate() {
            let clips = part.clips(log, rates, self.references);
            let clips = clips.with_context(|| format!("part {}", part.name))?;
            let is_only = clips.len() == 1;
            for clip in clips.into_iter().take(limit) {
                let images = self.images.as_mut().map(|(folder, _)| {
                    let (times_us, hz) = clip.times_us(log, &part.ego);
                    folder.clip(&ClipFrames {
                        part: part.name,
                        name: &clip.name,
                        log,
                        times_us,
                        hz,
                        references: self.references,
                        follows_log: part.ego == EgoPolicy::Replay,
                        is_only,
                        is_only_part,
                    })
                });
                let images = images.transpose()?;
                if let Some(images) = &images {
                    counts.merge(images.counts.clone());
                }
                let out = self.files.folder(Path::new(part.name).join(&clip.name))?;
                match rollout::is_finished(&out)? {
                    true => rollout::check_finished(&out, &inputs).map_err(anyhow::Error::from),
                    false => self.generate_clip(locator, &skeleton, (part, &clip), images, &out),
                }
                .with_context(|| format!("part {}, clip {}", part.name, clip.name))?;
                done.push((place, clip, out));
            }
        }
        // A log counts only as a whole.
        self.logs.push(log.name.clone());
        self.images.iter_mut().for_each(|(_, all)| all.merge(counts.clone()));
        for (place, clip, out) in done {
            let part = &mut self.parts[place];
            if part.part.copies_dataset {
                self.copied.push((Rc::clone(&source), out.clone()));
            }
            part.frames += clip.frames - self.references;
            part.folders.push(out);
        }
        Ok(())
    }

    /// Generates a clip.
    fn generate_clip(
        &self,
        locator: &LogLocator,
        skeleton: &Path,
        (part, clip): (&Part, &Clip),
        images: Option<ClipImages>,
        out: &Path,
    ) -> anyhow::Result<()> {
        let args = self.args;
        let summary = simulate::rollout(SimulateArgs::of_clip(ClipArgs {
            source: SourceArgs {
                log: locator.clone(),
                skeleton: skeleton.to_owned(),
                roots: args.given.roots.clone(),
            },
            folder: FolderArgs { out: out.to_owned() },
            rollout: RolloutArgs {
                steps: Some(clip.steps()),
                start: Some(clip.start_us),
                resume: is_there(&out.join(ROLLOUT))?,
                ..RolloutArgs::default()
            },
            clock: Some(clip.clock),
            ego: part.ego.kind(),
            planner: None,
            actors: if part.ego == EgoPolicy::Replay { ActorPolicy::Replay } else { args.actors },
            least_warmup: true,
            ego_offset: None,
            copies_dataset: false,
            prompt: args.prompt.clone(),
            generator: args.generator.clone(),
            images,
            maps: args.maps.clone(),
            lidar: args.lidar.clone(),
            scenario: args.scenario.clone(),
            substitutes: args.substitutes.clone(),
            rasterizer: args.rasterizer.clone(),
            opener: Arc::clone(&self.opener),
        }))?;
        print_progress(&summary);
        Ok(())
    }

    /// Returns the method with the counts of its images, which are also printed.
    fn method(&self) -> anyhow::Result<Method> {
        let (name, references) = (self.args.method_name(), self.references);
        let method = Method { name, references, remark: self.args.images.remark(), images: None };
        let Some((folder, counts)) = &self.images else { return Ok(method) };
        let mut unknown = Counted::default();
        folder.unknown().for_each(|path| unknown.add(|| path.display().to_string()));
        let named = [
            (&counts.missing, "missing"),
            (&counts.doubled, "doubled, the first by name is used"),
            (&counts.wrong_size, "of another size, not used"),
            (&unknown, "of no clip"),
        ];
        for (Counted { count, first }, kind) in named.into_iter().filter(|(counted, _)| counted.count > 0) {
            let first = first.as_deref().unwrap_or_default();
            print_progress(&format!("images {kind}: {count}, first {first}"));
        }
        let images = json!({"folder": self.args.images.folder(), "options": folder.options(),
                            "counts": counts, "unknown": unknown});
        Ok(Method { images: Some(images), ..method })
    }

    /// Scores all rollouts, writes and prints the table, and writes the copy of the data set.
    fn finish(self, dataset: &Path) -> anyhow::Result<()> {
        let progress = RefCell::new(None);
        let mut on_start = |steps| *progress.borrow_mut() = Some(Progress::new(steps));
        let mut on_step =
            |name: &str| progress.borrow_mut().iter_mut().for_each(|progress| progress.step(name));
        let options = ScoreOptions {
            method: self.method()?,
            root: self.args.given.folder.out.as_path(),
            networks: self.args.metrics.networks(),
            mask_rule: self.args.metrics.mask_rule,
            cache: &self.files.folder("metrics")?,
        };
        let (logs, parts) = (&self.logs, &self.parts);
        let report = ProtocolReport::score(self.protocol, logs, parts, options, &mut on_start, &mut on_step)?;
        drop(progress);
        report.notes().for_each(|note| print_progress(&format!("note: {note}")));
        write_json(&self.files.claim("results.json")?, &report)?;
        let (path, table) = (self.files.claim("table.md")?, report.table());
        write_whole(&path, |out| {
            std::io::Write::write_all(out, table.as_bytes()).map_err(FileError::io("write", &path))
        })?;
        let logs: Vec<CopiedLog<'_>> =
            (self.copied.iter()).map(|(log, rollout)| CopiedLog { log: log.recording(), rollout }).collect();
        if let Some(copy) = self.copy.filter(|_| !logs.is_empty()) {
            self.args.copy.write(copy, &logs, dataset)?;
        }
        print_result(table.trim_end());
        Ok(())
    }
}
