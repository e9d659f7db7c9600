use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use point_skeleton::conditions::ConditionOptions;
use point_skeleton::dataset::{DatasetError, LogLocator};
use point_skeleton::error::{FileError, with_causes};
use point_skeleton::files::{Inputs, is_one_file};
use point_skeleton::pipeline::write_beside;
use point_skeleton::raster::RasterizerDesc;
use point_skeleton::skeleton::{self, BuildError, Skeleton};
use point_skeleton::threads::{probe, spawn_scoped};
use point_skeleton::{Log, Maps, RenderOptions, Renderer};

use crate::claim::claim;
use crate::index::{Completeness, write_index};
use crate::layout::{self, Source};
use crate::report::{ExportReport, Failure};
use crate::samples::{Sample, Sampler};
use crate::shard::{Shard, ShardInput, ShardRecord};
use crate::{ExportError, ExportOptions, ListedLog, WorkList, WorkUnit};

/// Pause between attempts to open a skeleton that another process builds.
const PAUSE: Duration = Duration::from_millis(200);

/// Opens a log.
pub type OpenLog<'a> = &'a (dyn Fn(&LogLocator) -> Result<Log, DatasetError> + Sync);

/// Progress callback of an export, called from several threads.
pub trait ExportProgress: Sync {
    /// A key frame was written.
    fn frame(&self, shard: &str);
    /// A shard exists; its key frames need no work.
    fn skip(&self, frames: usize);
    /// Returns whether to stop; unfinished shards are removed.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// Ignores progress.
impl ExportProgress for () {
    fn frame(&self, _: &str) {}
    fn skip(&self, _: usize) {}
}

/// An export to be run.
#[derive(Clone, Copy)]
pub struct Export<'a> {
    /// All units of the export, for its index. Without them no index is written.
    pub list: Option<&'a WorkList>,
    /// Units to write.
    pub part: &'a WorkList,
    /// Folder to write.
    pub out: &'a Path,
    /// Folder of skeletons, one per log and named after it. Those that do not exist are built.
    pub skeletons: &'a Path,
    /// Options, which determine the bytes.
    pub options: &'a ExportOptions,
    /// Opens a log.
    pub open: OpenLog<'a>,
    /// Rasterizer and device.
    pub rasterizer: &'a RasterizerDesc,
    /// Number of logs that are exported at a time.
    pub jobs: usize,
    /// Whether checksums of existing shards are compared.
    pub verify: bool,
    /// Progress callback.
    pub progress: &'a dyn ExportProgress,
}

/// Writes the shards in a part of a work list. Shards that exist are skipped. Logs and shards that fail are
/// reported, and the others are written all the same. If all shards of the list exist then, writes
/// `index.json`.
///
/// # Errors
/// Fails if the folder cannot be written, if it has an export with other options or foreign files, or if it
/// is the folder of the skeletons, or is in a skeleton or a part of a log. Fails if the layout cannot have
/// logs of these names, or if their samples are too few for it.
pub fn export(run: Export<'_>) -> Result<ExportReport, ExportError> {
    if is_one_file(run.out, run.skeletons) {
        let expected = "a folder of skeletons apart from that of the export";
        return Err(FileError::content(expected, "the same", run.out).into());
    }
    run.list.map_or(Ok(()), |list| layout::check_logs(run.options, list))?;
    let read = Inputs::new(run.part.logs.iter().flat_map(|log| log.locator.inputs()));
    claim(run.out, run.options, &read)?;
    std::fs::create_dir_all(run.skeletons).map_err(FileError::io("create", run.skeletons))?;
    let jobs = run.jobs.min(run.part.logs.len());
    // Each job has a thread that writes.
    probe((2 * jobs).saturating_sub(1), "the threads of the jobs")?;
    let next = AtomicUsize::new(0);
    let reports = Mutex::new(BTreeMap::new());
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let log = run.part.logs.get(number).filter(|_| !run.progress.is_stopped());
            let Some(log) = log else { break };
            let report = export_log(&run, log);
            reports.lock().unwrap_or_else(PoisonError::into_inner).insert(number, report);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..jobs {
            if let Err(error) = spawn_scoped(scope, "a job", work) {
                // The jobs that have started take no further log.
                next.store(run.part.logs.len(), Ordering::Relaxed);
                return Err(error);
            }
        }
        work();
        Ok(())
    })?;
    if run.progress.is_stopped() {
        return Err(ExportError::Stopped);
    }
    let mut total = ExportReport::default();
    let reports = reports.into_inner().unwrap_or_else(PoisonError::into_inner);
    reports.into_values().for_each(|report| total.add(report));
    if let Some(list) = run.list.filter(|_| total.failures.is_empty()) {
        total.complete = write_index(list, run.out, run.options.layout, Completeness::Files)?;
    }
    Ok(total)
}

/// Exports the units of a log.
fn export_log(run: &Export<'_>, log: &ListedLog) -> ExportReport {
    let mut report = ExportReport::default();
    if let Err(error) = export_units(run, log, &mut report) {
        report.failures.push(failure(&log.locator.to_string(), &error));
    }
    report
}

fn failure(name: &str, error: &ExportError) -> Failure {
    Failure { name: name.to_owned(), error: with_causes(error) }
}

/// Returns the units that do not exist; adds the others to the report.
fn missing<'a>(
    run: &Export<'_>,
    log: &'a ListedLog,
    input: &ShardInput,
    report: &mut ExportReport,
) -> Vec<&'a WorkUnit> {
    let mut missing = Vec::new();
    for unit in &log.units {
        match ShardRecord::read(run.out, unit, Some(input), run.verify) {
            Ok(Some(_)) => {
                report.present += 1;
                run.progress.skip(unit.frames.len());
                Shard::remove_leftovers(run.out, unit);
            }
            Ok(None) => missing.push(unit),
            Err(error) => report.failures.push(failure(&unit.name, &error.into())),
        }
    }
    missing
}

fn export_units(run: &Export<'_>, log: &ListedLog, report: &mut ExportReport) -> Result<(), ExportError> {
    let opened = (run.open)(&log.locator)?;
    let recording = opened.recording();
    let path = run.skeletons.join(&log.name);
    let has_maps = run.options.layout.has_maps();
    let map = if run.options.uses_map() { opened.require_map()? } else { None };
    let input = ShardInput {
        log: recording.fingerprint(),
        skeleton: if has_maps { Skeleton::fingerprint_at(&path)? } else { None },
        map: map.as_ref().map(|map| map.vector_map().fingerprint()),
        templates: if has_maps { run.options.substitutes.fingerprint()? } else { None },
    };
    let units = missing(run, log, &input, report);
    if units.is_empty() {
        return Ok(());
    }
    layout::check(run.options, recording)?;
    let conditions = layout::conditions(run.options, recording)?;
    let options = run.options;
    report.note(&recording.notes);
    let maps = options.rendered(map.is_some());
    let mut source = Source {
        listed: log,
        log: &opened,
        options,
        input,
        #[cfg(feature = "parquet")]
        map: map.clone(),
    };
    let sampler = Sampler::new(recording, map, options.times);
    if !has_maps {
        for unit in units {
            let written = begin(run, unit).and_then(|shard| annotate(run, &source, shard, unit));
            record(run, report, unit, written)?;
        }
        return Ok(());
    }
    let skeleton = open_or_build(&path, &opened, report)?;
    source.input.skeleton = Skeleton::fingerprint_at(&path)?;
    let (substitutes, _) = options.substitutes.make(&skeleton, &recording.name)?;
    let mut renderer = Renderer::new(
        &skeleton,
        RenderOptions {
            conditions: ConditionOptions { maps, ..conditions },
            selection: options.selection,
            one_cloud: options.layout.has_color_masks(),
            rasterizer: run.rasterizer.clone(),
            substitutes: &substitutes,
            log: Some(&recording.name),
            ..RenderOptions::default()
        },
    )?;
    for unit in units {
        record(run, report, unit, export_unit(run, &source, &sampler, &mut renderer, unit))?;
    }
    Ok(())
}

/// Begins a shard of an export with the run's options.
fn begin(run: &Export<'_>, unit: &WorkUnit) -> Result<Shard, ExportError> {
    Ok(Shard::begin(run.out, unit)?.with_options(run.options)?)
}

/// Adds the result of a shard to the report.
///
/// # Errors
/// Fails if the export is to stop.
fn record(
    run: &Export<'_>,
    report: &mut ExportReport,
    unit: &WorkUnit,
    written: Result<ShardRecord, ExportError>,
) -> Result<(), ExportError> {
    match written {
        Ok(record) => {
            report.written += 1;
            report.samples += record.samples;
            report.note(&record.notes);
        }
        Err(ExportError::File(FileError::Busy { .. })) => report.busy += 1,
        Err(_) if run.progress.is_stopped() => return Err(ExportError::Stopped),
        Err(error) => {
            report.failures.push(Failure { name: unit.name.clone(), error: with_causes(&error) });
        }
    }
    Ok(())
}

/// Writes a shard without maps.
fn annotate(
    run: &Export<'_>,
    source: &Source<'_>,
    mut shard: Shard,
    unit: &WorkUnit,
) -> Result<ShardRecord, ExportError> {
    layout::writer(run.options.layout, &shard, source)?.finish(&mut shard)?;
    run.progress.skip(unit.frames.len());
    Ok(shard.publish(new_record(source, unit, unit.frames.len(), BTreeMap::new()))?)
}

fn new_record(
    source: &Source<'_>,
    unit: &WorkUnit,
    samples: usize,
    notes: BTreeMap<String, usize>,
) -> ShardRecord {
    ShardRecord {
        name: unit.name.clone(),
        log: source.recording().name.clone(),
        input: source.input.clone(),
        frames: [unit.frames.start, unit.frames.end],
        samples,
        notes,
        files: Vec::new(),
    }
}

/// Opens the skeleton of a log, or builds it; waits for another process that builds it.
fn open_or_build(path: &Path, log: &Log, report: &mut ExportReport) -> Result<Skeleton, ExportError> {
    let exists = Skeleton::is_at(path);
    loop {
        match skeleton::open_or_build(path, log.reader()) {
            Err(BuildError::File(FileError::Busy { .. })) => std::thread::sleep(PAUSE),
            Err(error) => return Err(error.into()),
            Ok(skeleton) => {
                report.built += usize::from(!exists);
                return Ok(skeleton);
            }
        }
    }
}

/// Renders and writes one shard. Another thread encodes and writes a sample while the next ones are rendered.
fn export_unit<'a>(
    run: &Export<'_>,
    source: &Source<'_>,
    sampler: &Sampler<'a>,
    renderer: &mut Renderer<'_>,
    unit: &WorkUnit,
) -> Result<ShardRecord, ExportError> {
    let mut shard = begin(run, unit)?;
    // Another process may have written the shard meanwhile.
    if let Some(record) = ShardRecord::read(run.out, unit, Some(&source.input), run.verify)? {
        return Ok(record);
    }
    let write = |receiver: Receiver<(Sample<'a>, Maps)>| -> Result<(Shard, usize), ExportError> {
        let mut writer = layout::writer(run.options.layout, &shard, source)?;
        let mut samples = 0;
        for (sample, maps) in receiver {
            writer.add(&mut shard, &sample, &maps)?;
            samples += 1;
            if sample.is_key {
                run.progress.frame(shard.name());
            }
        }
        writer.finish(&mut shard)?;
        Ok((shard, samples))
    };
    let mut notes = BTreeMap::new();
    let render = |sender: SyncSender<(Sample<'a>, Maps)>| {
        let samples = unit.frames.clone().flat_map(|index| sampler.of_frame(index, &mut notes));
        let states = samples.map(|sample| {
            let state = sample.state.clone();
            Ok::<_, ExportError>((sample, state))
        });
        renderer.render_each(states, |sample, maps| {
            sender.send((sample, maps)).is_ok() && !run.progress.is_stopped()
        })
    };
    let (rendered, written) = write_beside("the thread that writes a shard", write, render)?;
    if run.progress.is_stopped() {
        return Err(ExportError::Stopped);
    }
    let (shard, samples) = rendered.and(written)?;
    Ok(shard.publish(new_record(source, unit, samples, notes))?)
}
