//! The processes of a command: a process group that ends when this process does, however that ends.
//!
//! # How it works
//! A command that is started alone goes on when this process is killed. So the group is led by a guard, a shell that waits
//! for the end of its input, a pipe whose other end this process alone holds. The system closes that end with this process,
//! and the guard kills its group, itself last of all.

use std::io::{Error, Result};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

/// How long a process may take to end by itself once its input is closed.
const GRACE: Duration = Duration::from_millis(500);
/// What the guard does. It stays while the command ends its own group by a signal, or stops it.
const GUARD: &str = "trap '' HUP INT QUIT TERM TSTP TTIN TTOU; read -r _; kill -KILL 0";

/// A command with all that it started.
pub(super) struct Group {
    guard: Child,
    id: Pid,
    /// `None` where it did not start.
    command: Option<Child>,
    /// Whether it was killed: its number may be another's.
    is_over: bool,
}

/// All groups that run.
#[derive(Default)]
struct Running {
    groups: Vec<Pid>,
    /// Whether all were ended, so that none is to start.
    is_over: bool,
}

static RUNNING: Mutex<Running> = Mutex::new(Running { groups: Vec::new(), is_over: false });

fn running() -> MutexGuard<'static, Running> {
    // The list is whole at every moment.
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Kills all commands that were started as peers, with all that they started, and lets none start any more. For the end of
/// the process; sockets that were reached are none of its processes.
pub fn end_all() {
    let mut running = running();
    running.is_over = true;
    for group in &running.groups {
        let _ = kill_process_group(*group, Signal::KILL); // fails where all have ended
    }
}

impl Group {
    /// Starts a command for `sh`; what it writes to its standard error is seen by the user.
    pub(super) fn start(command: &str) -> Result<(Self, ChildStdin, ChildStdout)> {
        // Until the end of this function: a group that has started is one that `end_all` ends.
        let mut running = running();
        if running.is_over {
            return Err(Error::other("the program is ending"));
        }
        let mut guard = Command::new("sh");
        guard.arg("-c").arg(GUARD).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let guard = guard.process_group(0).spawn()?;
        let id = Pid::from_child(&guard);
        let mut group = Self { guard, id, command: None, is_over: false };
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(command).stdin(Stdio::piped()).stdout(Stdio::piped());
        let started = shell.process_group(id.as_raw_nonzero().get()).spawn();
        let pipes = started.and_then(|mut child| {
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
                drop(running); // the group's end asks for it
                Err(error)
            }
        }
    }

    /// Ends the command and whatever it started in its group; its exit status if it ended by itself in time.
    pub(super) fn end(&mut self) -> Option<ExitStatus> {
        let mut command = self.command.take()?;
        let ended = ends_within(GRACE, Pid::from_child(&command));
        self.kill();
        command.wait().ok().filter(|_| ended)
    }

    /// Kills all processes of the group, and takes it off the list before its number may become another's.
    fn kill(&mut self) {
        self.is_over = true;
        let mut running = running();
        let _ = kill_process_group(self.id, Signal::KILL); // fails where all have ended
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

/// Whether a child ends in time. It is not reaped, so that it keeps its number.
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
