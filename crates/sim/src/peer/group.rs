//! Process group of a peer command, which ends with this process, however this process ends.
//!
//! # How it works
//! A command that is started directly keeps running when this process is killed. So the group is led by a
//! guard: a shell that waits for the end of its input, a pipe whose other end only this process holds. The
//! system closes that end when this process ends. The guard then kills its group, including itself.

use std::io::{Error, Result};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use point_skeleton::threads::process_error;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

/// Grace period for a process to exit by itself after its input is closed.
const GRACE: Duration = Duration::from_millis(500);
/// Script of the guard. It ignores signals with which the command ends or stops its own group.
const GUARD: &str = "trap '' HUP INT QUIT TERM TSTP TTIN TTOU; read -r _; kill -KILL 0";

/// A command with all processes that it started.
pub(super) struct Group {
    guard: Child,
    id: Pid,
    /// `None` if the command did not start.
    command: Option<Child>,
    /// `true` once the group is killed: its id may be reused by another group.
    is_over: bool,
}

/// All running groups.
#[derive(Default)]
struct Running {
    groups: Vec<Pid>,
    /// `true` once all groups were ended; no further group may start.
    is_over: bool,
}

static RUNNING: Mutex<Running> = Mutex::new(Running { groups: Vec::new(), is_over: false });

fn running() -> MutexGuard<'static, Running> {
    // The list is consistent at every moment.
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Kills all peer commands with all processes that they started, and prevents further ones from starting. For
/// the end of the process; peers reached over sockets are not affected.
pub fn end_all() {
    let mut running = running();
    running.is_over = true;
    for group in &running.groups {
        let _ = kill_process_group(*group, Signal::KILL); // fails if all have ended
    }
}

impl Group {
    /// Starts a command for `sh`; its standard error is inherited and visible to the user.
    pub(super) fn start(command: &str) -> Result<(Self, ChildStdin, ChildStdout)> {
        // Locked until the function returns, so that `end_all` ends every group that has started.
        let mut running = running();
        if running.is_over {
            return Err(Error::other("the program is ending"));
        }
        let mut guard = Command::new("sh");
        guard.arg("-c").arg(GUARD).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let guard = guard.process_group(0).spawn().map_err(process_error)?;
        let id = Pid::from_child(&guard);
        let mut group = Self { guard, id, command: None, is_over: false };
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(command).stdin(Stdio::piped()).stdout(Stdio::piped());
        let started = shell.process_group(id.as_raw_nonzero().get()).spawn();
        let pipes = started.map_err(process_error).and_then(|mut child| {
            let pipes = child.stdin.take().zip(child.stdout.take());
            group.command = Some(child);
            pipes.ok_or_else(|| Error::other("no pipe"))
        });
        match pipes {
            Ok((writer, reader)) => {
                running.groups.push(id);
                Ok((group, writer, reader))
            }
            Err(error) => {
                drop(running); // dropping `group` locks it again
                Err(error)
            }
        }
    }

    /// Ends the command and all processes in its group. Returns its exit status if it exited by itself in
    /// time.
    pub(super) fn end(&mut self) -> Option<ExitStatus> {
        let mut command = self.command.take()?;
        let ended = ends_within(GRACE, Pid::from_child(&command));
        self.kill();
        command.wait().ok().filter(|_| ended)
    }

    /// Kills all processes of the group, and removes it from the list before its id may be reused.
    fn kill(&mut self) {
        self.is_over = true;
        let mut running = running();
        let _ = kill_process_group(self.id, Signal::KILL); // fails if all have ended
        running.groups.retain(|group| *group != self.id);
        let _ = self.guard.wait();
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        if !self.is_over {
            self.kill();
        }
        if let Some(command) = &mut self.command {
            let _ = command.wait();
        }
    }
}

/// Returns whether a child exits in time. The child is not reaped, so its process id stays reserved.
fn ends_within(time: Duration, child: Pid) -> bool {
    let start = Instant::now();
    let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    loop {
        if matches!(waitid(WaitId::Pid(child), look), Ok(Some(_))) {
            return true;
        }
        if start.elapsed() >= time {
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}
