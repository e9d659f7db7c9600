use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use point_skeleton::Log;
use point_skeleton::conditions::view::template_preview;
use point_skeleton::dataset::{self, LogLocator, expand};
use point_skeleton::files::Inputs;
use point_skeleton::skeleton::{
    self, BuildError, BuildInput, BuildOptions, BuildRun, Instances, LogSource, Skeleton, TemplateLibrary,
    TemplateOptions, TemplateReport,
};

use crate::args::log::LogRoots;
use crate::args::outputs::FolderArgs;
use crate::logs;
use crate::print_result;
use crate::progress::{Progress, StageProgress};

/// Create category templates from the actors of logs: substitute clouds for actors with few points of their
/// own
///
/// Actors are clustered by category and size; the points of a kind's actors are superimposed, for vehicles
/// also mirrored, then outliers are removed and the points are thinned. Writes templates.json (templates and
/// their sources), templates.points, and a preview image of each template. `build --templates-from` and
/// `render --templates` use the folder.
#[derive(Debug, Args)]
pub(crate) struct TemplatesArgs {
    /// Recordings ([FORMAT:]PATH[@VERSION][#SCENE]) or folders of skeletons that were built from them, which
    /// is faster
    #[arg(required = true, value_name = "LOG|SKELETON")]
    targets: Vec<Target>,
    #[command(flatten)]
    folder: FolderArgs,
    /// Approximate number of points in a template whose box is fully covered
    #[arg(long, value_name = "N", default_value_t = TemplateOptions::default().target_points)]
    target_points: usize,
    /// Omit templates with fewer points
    #[arg(long, value_name = "N", default_value_t = TemplateOptions::default().min_points)]
    min_points: usize,
    #[command(flatten)]
    roots: LogRoots,
}

/// Source of actors.
#[derive(Clone, Debug)]
enum Target {
    Skeleton(PathBuf),
    Log(LogLocator),
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if Skeleton::is_at(Path::new(text)) {
            return Ok(Self::Skeleton(text.into()));
        }
        let wrong = |e: dataset::DatasetError| format!("expected the folder of a skeleton, or else {e}");
        logs::locate(text).map(Self::Log).map_err(wrong)
    }
}

/// Runs the command: reads actors, creates templates, renders previews, writes the folder.
pub(crate) fn run(args: &TemplatesArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let inputs = args.targets.iter().flat_map(|target| match target {
        Target::Skeleton(path) => vec![path.clone()],
        Target::Log(log) => args.roots.locate(log).inputs().map(Path::to_path_buf).collect(),
    });
    let target = TemplateLibrary::target(&args.folder.out, &Inputs::new(inputs))?;
    let options = TemplateOptions {
        target_points: args.target_points,
        min_points: args.min_points,
        ..TemplateOptions::default()
    };
    let mut instances = Instances::new(options);
    let sources = read(args, &mut instances, target.scratch())?;
    let made = instances.templates();
    let found = described(&made.1);
    anyhow::ensure!(!made.0.is_empty(), "expected actors with enough points for a template, found {found}");
    let library = TemplateLibrary::new(sources, options, made);
    library.write(target, |folder| template_preview::write_all(folder, &library.clouds))?;
    let (count, logs) = (library.clouds.len(), library.manifest.sources.len());
    let seconds = start.elapsed().as_secs_f64();
    print_result(&format!(
        "created {count} templates from {logs} logs: {found} in {seconds:.2} s: {}",
        args.folder.out.display()
    ));
    Ok(())
}

fn read(args: &TemplatesArgs, instances: &mut Instances, scratch: &Path) -> anyhow::Result<Vec<LogSource>> {
    let mut sources = Vec::new();
    let mut progress = Progress::new(args.targets.len());
    for target in &args.targets {
        match target {
            Target::Skeleton(path) => {
                let skeleton = Skeleton::open(path)?;
                sources.extend(instances.add_skeleton(&skeleton)?);
                progress.step(&path.display().to_string());
            }
            Target::Log(locator) => {
                for log in expand(&args.roots.locate(locator))? {
                    let log = logs::open(&log)?;
                    let name = log.recording().shown_name();
                    let built = build(&scratch.join("skeleton"), &log);
                    sources.extend(instances.add_skeleton(&built.with_context(|| format!("log {name}"))?)?);
                    progress.step(&name);
                }
            }
        }
    }
    Ok(sources)
}

/// Builds a skeleton from all frames of a log.
fn build(out: &Path, log: &Log) -> Result<Skeleton, BuildError> {
    let progress = StageProgress::default();
    let run = BuildRun { progress: &progress, ..BuildRun::default() };
    let inputs = [BuildInput::all(log.reader())];
    let built = skeleton::build(out, &inputs, &BuildOptions::default(), &|_| Ok(Vec::new()), &run);
    built.map_err(|error| match error {
        // The partial build is temporary, so it cannot be resumed.
        BuildError::Interrupted { source, .. } => *source,
        error => error,
    })
}

/// Returns a text on templates of a skeleton's own actors for a summary.
pub(crate) fn of_actors(report: &TemplateReport) -> String {
    format!("; templates of its actors: {}", described(report))
}

fn described(report: &TemplateReport) -> String {
    let made = report.templates.iter().filter(|t| t.points > 0);
    let made = made.map(|t| format!("{} ({} points of {} actors)", t.kind.name(), t.points, t.instances));
    let left = report.notes.iter().map(|(reason, count)| format!("skipped {count} {reason}"));
    let all: Vec<String> = made.chain(left).collect();
    if all.is_empty() { "no actors".to_owned() } else { all.join(", ") }
}
