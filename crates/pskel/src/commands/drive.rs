//! `pskel drive`.

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use clap::Args;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::dataset::LogLocator;
use point_skeleton::files::Inputs as ReadFiles;
use point_skeleton::skeleton::{self, BuildInput, BuildNeeds, BuildOptions, BuildRun, SkeletonWriter};
use point_skeleton::{Log, Skeleton};
use pskel_drive::{DriveError, DriveOptions, Inputs, LiveGenerator, OpenGenerator, Progress};
use pskel_sim::Rates;

use super::simulate::{GeneratorArgs, GivenImages, Opened};
use crate::args::actors::ScenarioArgs;
use crate::args::log::{self, LogRoots};
use crate::args::numbers::finite;
use crate::args::outputs::output_folder;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::source::open_skeleton;
use crate::progress::StageProgress;
use crate::{WrongUsage, print_progress, print_result, warn};

/// Port that is tried first, if none is given.
const PORT: u16 = 8770;
/// Folder of built skeletons in `--out`.
const SKELETONS: &str = "skeletons";

/// Look around in a recording and drive in it, live in the browser
///
/// Prints the address of a page that shows the cameras from any pose, and keeps serving it until Ctrl-C. The
/// address has a secret token; pages of other sites and other users cannot connect. Saved drives are rollouts
/// in --out, which `pskel simulate` writes again from their trajectories.
#[derive(Debug, Args)]
pub(crate) struct DriveArgs {
    /// Recording: [FORMAT:]PATH[@VERSION][#SCENE], like /data/nuscenes#scene-0061
    #[arg(value_parser = log::log)]
    log: LogLocator,
    /// Skeleton of the recording; built if it does not exist [default: OUT/skeletons/LOG]
    #[arg(long, value_name = "SKEL")]
    skeleton: Option<PathBuf>,
    /// Folder for saved drives
    #[arg(long, value_name = "DIR", value_parser = output_folder(), default_value = "out/drive")]
    out: PathBuf,
    /// Port; 0 for any free one [default: 8770, or any free one]
    #[arg(long, value_name = "PORT")]
    port: Option<u16>,
    /// Address to listen on. Others than this computer's own let everybody in the network connect who knows
    /// the token, without encryption
    #[arg(long, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    address: IpAddr,
    /// Do not open the page in the browser
    #[arg(long)]
    no_browser: bool,
    /// Folder of `pskel templates`, used for kinds without a template in the skeleton
    #[arg(long, value_name = "DIR")]
    templates: Option<PathBuf>,
    #[command(flatten)]
    roots: LogRoots,
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Images that the generator makes per second [default: the planning rate of the recording]
    #[arg(long, value_name = "HZ", value_parser = rate_hz, help_heading = "Generator")]
    generate_hz: Option<f64>,
    #[command(flatten)]
    generator: GeneratorArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: serves the page until the process ends.
pub(crate) fn run(args: &DriveArgs) -> anyhow::Result<()> {
    args.generator.check()?;
    if args.generate_hz.is_some() && !args.generator.generates() {
        return Err(WrongUsage("expected --generator with --generate-hz, found none".to_owned()).into());
    }
    let options = DriveOptions {
        address: SocketAddr::new(args.address, args.free_port()),
        out: args.out.clone(),
        rasterizer: args.rasterizer.desc()?,
        templates: args.templates.clone(),
    };
    if !args.address.is_loopback() {
        warn(&format!(
            "listening on {}: everybody in the network who knows the address can connect, without encryption",
            args.address
        ));
    }
    let ready = |url: &str| {
        print_result(url);
        if !args.no_browser {
            open_browser(url);
        }
    };
    // A signal ends the process, which is the usual end.
    let open = |progress: &Progress<'_>| args.open(progress).map_err(|error| DriveError::Open(error.into()));
    Ok(pskel_drive::serve(&options, open, ready, &AtomicBool::new(false))?)
}

impl DriveArgs {
    /// Returns the port, or the usual one if it is free, or 0 for any.
    fn free_port(&self) -> u16 {
        let is_free = |port: &u16| std::net::TcpListener::bind((self.address, *port)).is_ok();
        self.port.or(Some(PORT).filter(is_free)).unwrap_or(0)
    }

    fn open(&self, progress: &Progress<'_>) -> anyhow::Result<Inputs> {
        progress("opening the recording", 0, 0);
        let opened = self.roots.open(&self.log)?;
        let scenario = self.scenario.read_for(&opened)?;
        let log = opened.edited(&scenario)?;
        let rates = Rates::of(self.log.format, log.recording());
        let generator = self.generator(&log, self.generate_hz.unwrap_or(rates.plan_hz))?;
        let default = || self.out.join(SKELETONS).join(folder_name(&log.recording().name));
        let path = self.skeleton.clone().unwrap_or_else(default);
        let is_built = path.join("skeleton.json").exists();
        let skeleton =
            if is_built { open_skeleton(&path, log.unedited())? } else { self.build(&log, &path, progress)? };
        print_progress(&format!("skeleton {}", path.display()));
        Ok(Inputs {
            log_name: self.log.to_string(),
            log_arguments: self.log_arguments(),
            scenario,
            rates,
            generator,
            log,
            skeleton,
            skeleton_path: path,
        })
    }

    /// Returns the arguments with which other commands open the recording and its scenario.
    fn log_arguments(&self) -> Vec<String> {
        let scenario = self.scenario.file().map(|file| ["--scenario".to_owned(), file.display().to_string()]);
        self.roots.locate(&self.log).arguments().into_iter().chain(scenario.into_iter().flatten()).collect()
    }

    /// Opens the generator. The first session takes what is opened here, later ones open it again.
    fn generator(&self, log: &Log, hz: f64) -> anyhow::Result<Option<LiveGenerator>> {
        let args = self.generator.clone();
        let (Some(name), Some(first)) = (args.name(), open_generator(&args, log, hz)?) else {
            return Ok(None);
        };
        let (window, forecasts, record) = (first.window(), first.forecasts(), first.record()?);
        let fact = first.fact();
        let (arguments, first) = (args.arguments(), Mutex::new(Some(first)));
        let open: Box<OpenGenerator> = Box::new(move |inputs, actors_follow_log| {
            let opened = first.lock().unwrap_or_else(PoisonError::into_inner).take();
            let opened = match opened {
                Some(opened) => opened,
                None => open_generator(&args, &inputs.log, hz)?.ok_or("there is no generator")?,
            };
            let follow_log = [false, actors_follow_log];
            Ok(opened.session(
                &inputs.log,
                inputs.log.map().is_some(),
                &PromptParts::default(),
                follow_log,
            )?)
        });
        Ok(Some(LiveGenerator { name, hz, window, forecasts, arguments, record, fact, open }))
    }

    fn build(&self, log: &Log, path: &Path, progress: &Progress<'_>) -> anyhow::Result<Skeleton> {
        let read = ReadFiles::new(self.roots.locate(&self.log).inputs());
        SkeletonWriter::check_target(path, &read)?;
        print_progress(&format!("building the skeleton {}", path.display()));
        let both = Both { page: progress, terminal: StageProgress::default(), done: Default::default() };
        let run = BuildRun { progress: &both, ..BuildRun::default() };
        let input = BuildInput::all(log.unedited_reader());
        Ok(skeleton::build(path, &[input], &BuildOptions::default(), &|_| Ok(Vec::new()), &run)?)
    }
}

fn open_generator(args: &GeneratorArgs, log: &Log, hz: f64) -> anyhow::Result<Option<Opened>> {
    Opened::open(args, &GivenImages::default(), log, hz)
}

/// Parses a rate.
fn rate_hz(text: &str) -> Result<f64, String> {
    let hz = finite(text).filter(|hz| (0.1..=100.0).contains(hz));
    hz.ok_or_else(|| "expected 0.1 to 100 images per second".to_owned())
}

/// Progress of a build on the page and on the terminal.
struct Both<'p> {
    page: &'p Progress<'p>,
    terminal: StageProgress,
    done: Mutex<(String, usize, usize)>,
}

impl Both<'_> {
    fn tell(&self, change: impl FnOnce(&mut (String, usize, usize))) {
        let mut state = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut state);
        (self.page)(&format!("building the skeleton: {}", state.0), state.1, state.2);
    }
}

impl skeleton::Progress for Both<'_> {
    fn needs(&self, estimate: &dyn Fn() -> BuildNeeds) {
        self.terminal.needs(estimate);
    }

    fn start(&self, stage: &str, steps: usize) {
        self.terminal.start(stage, steps);
        self.tell(|state| *state = (stage.to_owned(), 0, steps));
    }

    fn step(&self) {
        self.terminal.step();
        self.tell(|state| state.1 += 1);
    }

    fn skipped(&self, message: &str) {
        self.terminal.skipped(message);
    }
}

/// Returns a folder name of a log's name.
fn folder_name(log: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let name: String = log.chars().take(100).map(plain).collect();
    if name.is_empty() || name.starts_with('.') { format!("log{name}") } else { name }
}

/// Opens an address in the browser. The address is passed in a file that only this user can read, since other
/// users of the computer see arguments. Without a browser nothing happens: the address is printed.
fn open_browser(url: &str) {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let has_screen = cfg!(target_os = "macos")
        || ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    if !has_screen {
        return;
    }
    let folder = std::env::var_os("XDG_RUNTIME_DIR").map_or_else(std::env::temp_dir, PathBuf::from);
    let path = folder.join(format!("pskel-drive-{}.html", std::process::id()));
    let page = format!("<!doctype html><meta http-equiv=\"refresh\" content=\"0; url={url}\">");
    let opened = std::fs::OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path);
    let written = opened.and_then(|mut file| file.write_all(page.as_bytes()));
    if written.is_ok() {
        let _ = Command::new(program).arg(&path).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_named_after_logs() {
        assert_eq!(folder_name("scene-0061"), "scene-0061");
        assert_eq!(folder_name("../a b"), "log.._a_b");
        assert_eq!(folder_name(""), "log");
    }
}
