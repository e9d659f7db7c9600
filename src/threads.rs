//! Start of threads, with an error in place of a panic where the system allows too few of them.
//!
//! Containers (`pids.max`), `ulimit -u` and batch systems limit the number of threads. The standard library
//! and rayon panic then, and some Vulkan drivers wait forever for a thread that they could not start. All
//! threads of the library and the command are therefore started here. [`probe`] starts and ends the threads
//! that a driver will need before the driver does.

use std::error::Error;
use std::io;
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread::{Builder, JoinHandle, Scope, ScopedJoinHandle};

/// Variables that set the thread count of rayon's pool: the second one if the first is not set.
pub const POOL_VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "RAYON_RS_NUM_CPUS"];
/// Description of the pool in errors.
const POOL: &str = "the threads for parallel work";
/// Threads that a command needs beside the pool: one that writes files.
const BESIDE_POOL: usize = 1;

/// The system started fewer threads than needed.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot start {what}: {source}; raise the limit on processes and threads (ulimit -u, pids.max of the \
        container), or \
     set RAYON_NUM_THREADS=1, and LP_NUM_THREADS=1 for Mesa's lavapipe"
)]
pub struct ThreadError {
    /// Description of the threads, like `the thread that writes maps`.
    what: String,
    /// Error of the system.
    source: io::Error,
}

impl ThreadError {
    fn new(what: impl Into<String>) -> impl FnOnce(io::Error) -> Self {
        let what = what.into();
        |source| Self { what, source }
    }
}

/// For interfaces that only have I/O errors.
impl From<ThreadError> for io::Error {
    fn from(error: ThreadError) -> Self {
        Self::new(error.source.kind(), error)
    }
}

/// Adds the advice of [`ThreadError`] to an error of starting a process, if the limit on processes is its
/// cause.
pub fn process_error(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::WouldBlock => ThreadError::new("a process")(error).into(),
        _ => error,
    }
}

/// Starts a thread. `what` describes it in errors, like `the thread that writes maps`.
///
/// # Errors
/// Fails if the system does not start it.
pub fn spawn<T: Send + 'static>(
    what: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, ThreadError> {
    Builder::new().spawn(run).map_err(ThreadError::new(what))
}

/// Starts a thread of a scope. `what` describes it in errors, like `the thread that writes maps`.
///
/// # Errors
/// Fails if the system does not start it.
pub fn spawn_scoped<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    what: &str,
    run: impl FnOnce() -> T + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, T>, ThreadError> {
    Builder::new().spawn_scoped(scope, run).map_err(ThreadError::new(what))
}

/// Starts a number of threads that exist at the same time, then ends them. `what` describes them in errors,
/// like `the threads of a driver`.
///
/// # Errors
/// Fails if the system starts fewer.
pub fn probe(threads: usize, what: &str) -> Result<(), ThreadError> {
    std::thread::scope(|scope| {
        // Each thread waits until this vector is dropped.
        let mut ends = Vec::with_capacity(threads);
        for started in 0..threads {
            let (end, ended) = mpsc::channel::<()>();
            let spawned = Builder::new().spawn_scoped(scope, move || ended.recv().is_ok());
            spawned.map_err(ThreadError::new(format!("{what}, only {started} of {threads}")))?;
            ends.push(end);
        }
        Ok(())
    })
}

/// Starts rayon's global pool with its default number of threads, which otherwise starts at the first use.
/// Does nothing if it runs already. For programs; a library should leave the choice to its program.
///
/// # Errors
/// Fails if the system allows fewer threads than the pool and one thread beside it.
pub fn start_pool() -> Result<(), ThreadError> {
    static IS_STARTED: Mutex<bool> = Mutex::new(false);
    let mut is_started = IS_STARTED.lock().unwrap_or_else(PoisonError::into_inner);
    if *is_started {
        return Ok(());
    }
    let threads = pool_threads(|name| std::env::var(name).ok());
    // Rayon tries to start its global pool only once, also if this fails.
    probe(threads + BESIDE_POOL, POOL)?;
    if let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        // Without a source, the program has started the pool itself.
        pool_error(&error).map_or(Ok(()), Err)?;
    }
    *is_started = true;
    Ok(())
}

/// Creates a pool of rayon with its default number of threads.
///
/// # Errors
/// Fails if the system starts fewer.
pub fn new_pool() -> Result<rayon::ThreadPool, ThreadError> {
    let threads = pool_threads(|name| std::env::var(name).ok());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|error| {
        let unknown = || ThreadError::new(POOL)(io::Error::other(error.to_string()));
        pool_error(&error).unwrap_or_else(unknown)
    })
}

/// Returns the error of the system that an error of a pool has.
fn pool_error(error: &rayon::ThreadPoolBuildError) -> Option<ThreadError> {
    let source = error.source()?.downcast_ref::<io::Error>()?;
    let source = source.raw_os_error().map_or_else(|| source.kind().into(), io::Error::from_raw_os_error);
    Some(ThreadError::new(POOL)(source))
}

/// Returns the number of threads that rayon chooses for these variables.
fn pool_threads(variable: impl Fn(&str) -> Option<String>) -> usize {
    let numbers = POOL_VARIABLES.map(|name| variable(name).and_then(|text| text.parse::<usize>().ok()));
    match numbers {
        [Some(threads), _] | [None, Some(threads)] if threads > 0 => threads,
        _ => processors(),
    }
}

/// Returns the number of processors that this process may use.
fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Returns how many threads a Vulkan driver starts that renders on the processor. Mesa's lavapipe has a pool
/// for rasterization, one for compute shaders, a queue and a writer of its cache (22.3; SwiftShader starts
/// fewer).
pub(crate) fn of_cpu_driver() -> usize {
    // Mesa 24 raised the limit from 16.
    const MAX_POOL: usize = 32;
    let asked = std::env::var("LP_NUM_THREADS").ok().and_then(|text| text.parse::<usize>().ok());
    2 * asked.unwrap_or_else(|| processors().max(online_processors())).min(MAX_POOL) + 2
}

/// Returns the machine's processor count, which drivers use whatever this process is limited to; 0 if
/// unknown.
fn online_processors() -> usize {
    let stat = std::fs::read_to_string("/proc/stat").unwrap_or_default();
    let is_processor = |line: &&str| line.strip_prefix("cpu").is_some_and(|rest| !rest.starts_with(' '));
    stat.lines().filter(is_processor).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pool_size_matches_rayons_choice() {
        let threads = |first: Option<&str>, second: Option<&str>| {
            let texts = [first, second].map(|text| text.map(str::to_owned));
            pool_threads(|name| texts[usize::from(name != POOL_VARIABLES[0])].clone())
        };
        assert_eq!(
            [threads(Some("3"), Some("5")), threads(None, Some("5")), threads(Some("x"), Some("5"))],
            [3, 5, 5]
        );
        for default in [threads(None, None), threads(Some("0"), Some("5")), threads(Some("x"), None)] {
            assert_eq!(default, processors());
        }
    }

    #[test]
    fn probed_threads_exist_together_and_end() {
        probe(0, "a test").unwrap();
        probe(40, "a test").unwrap();
        assert!(online_processors() >= 1);
    }

    #[test]
    fn errors_name_the_limits_and_variables() {
        let refused = || io::Error::from_raw_os_error(11);
        let text = ThreadError::new("the thread that writes maps")(refused()).to_string();
        for part in [
            "cannot start the thread that writes maps: ",
            "pids.max",
            "RAYON_NUM_THREADS=1",
            "LP_NUM_THREADS=1",
        ] {
            assert!(text.contains(part), "{text}");
        }
        assert!(process_error(refused()).to_string().contains("cannot start a process: "));
        assert_eq!(process_error(io::ErrorKind::NotFound.into()).kind(), io::ErrorKind::NotFound);
    }
}
