use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::protocol::begin_of;
use super::{PlannerAddress, PlannerError};

/// Longer answers are a mistake, bytes.
const MAX_LINE_BYTES: u64 = 16 << 20;
/// How often a socket is looked for that is not there yet.
const RETRY: Duration = Duration::from_millis(50);
/// How long a process may take to end by itself once its input is closed.
const GRACE: Duration = Duration::from_millis(500);

/// A connection to a planner.
pub(super) struct Link {
    name: String,
    timeout: Duration,
    lines: Option<SyncSender<Vec<u8>>>,
    answers: Receiver<std::io::Result<Vec<u8>>>,
    end: End,
}

/// What ends with the link.
enum End {
    Child(Child),
    Unix(UnixStream),
    Tcp(TcpStream),
    /// A process that has been ended.
    Over,
}

/// Both directions of a connection.
type Streams = (Box<dyn Write + Send>, Box<dyn Read + Send>);

impl Link {
    /// Starts a command or reaches a socket, which may take until the time-out to be there.
    pub(super) fn open(address: &PlannerAddress, timeout: Duration) -> Result<Self, PlannerError> {
        let name = address.to_string();
        let failed = |verb| {
            let planner = name.clone();
            move |source| PlannerError::Io { verb, source, planner }
        };
        let (end, (writer, reader)) = match address {
            PlannerAddress::Command(command) => start(command).map_err(failed("start"))?,
            PlannerAddress::Unix(path) => {
                let path = path.clone();
                let stream = reach(timeout, move |_| UnixStream::connect(&path)).map_err(failed("reach"))?;
                let streams = unix_streams(&stream).map_err(failed("reach"))?;
                (End::Unix(stream), streams)
            }
            PlannerAddress::Tcp(address) => {
                let address = address.clone();
                let stream = reach(timeout, move |left| connect(&address, left)).map_err(failed("reach"))?;
                let streams = tcp_streams(&stream).map_err(failed("reach"))?;
                (End::Tcp(stream), streams)
            }
        };
        let (lines, to_write) = sync_channel(1);
        let (send_answer, answers) = sync_channel(1);
        // From here on, dropping the link ends the process.
        let link = Self { name: name.clone(), timeout, lines: Some(lines), answers, end };
        std::thread::Builder::new()
            .spawn(move || write_lines(writer, &to_write))
            .map_err(failed("write to"))?;
        std::thread::Builder::new()
            .spawn(move || read_lines(reader, &send_answer))
            .map_err(failed("read from"))?;
        Ok(link)
    }

    /// The planner's address.
    pub(super) fn name(&self) -> String {
        self.name.clone()
    }

    /// Sends a line and waits for the answer's, without its end. After a failure there are no more answers: a late one
    /// would be taken for that to the next line.
    pub(super) fn ask(&mut self, line: Vec<u8>) -> Result<Vec<u8>, PlannerError> {
        let answer = self.ask_once(line);
        if answer.is_err() {
            self.close();
        }
        answer
    }

    /// Asks nothing any more.
    pub(super) fn close(&mut self) {
        self.lines = None;
    }

    fn ask_once(&mut self, line: Vec<u8>) -> Result<Vec<u8>, PlannerError> {
        // It would be taken for the answer to what is asked now.
        match self.answers.try_recv() {
            Ok(Ok(unasked)) => {
                return Err(PlannerError::Answer {
                    expected: "no line that was not asked for".to_owned(),
                    found: begin_of(&unasked),
                    planner: self.name(),
                });
            }
            Ok(Err(source)) => {
                return Err(PlannerError::Io { verb: "read from", source, planner: self.name() });
            }
            Err(_) => {}
        }
        match self.lines.as_ref().map(|lines| lines.try_send(line)) {
            Some(Ok(())) => {}
            // It has answered without reading what it was asked.
            Some(Err(TrySendError::Full(_))) => {
                return Err(PlannerError::Answer {
                    expected: "a planner that reads each line before it answers".to_owned(),
                    found: "one that does not read".to_owned(),
                    planner: self.name(),
                });
            }
            // The writer is gone if writing failed: the planner is, too.
            Some(Err(TrySendError::Disconnected(_))) | None => return Err(self.gone()),
        }
        match self.answers.recv_timeout(self.timeout) {
            Ok(Ok(answer)) if answer.len() as u64 > MAX_LINE_BYTES => Err(PlannerError::Answer {
                expected: format!("a line of at most {MAX_LINE_BYTES} bytes"),
                found: "a longer one".to_owned(),
                planner: self.name(),
            }),
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(source)) => Err(PlannerError::Io { verb: "read from", source, planner: self.name() }),
            Err(RecvTimeoutError::Timeout) => {
                Err(PlannerError::Silent { timeout_s: self.timeout.as_secs_f64(), planner: self.name() })
            }
            Err(RecvTimeoutError::Disconnected) => Err(self.gone()),
        }
    }

    fn gone(&mut self) -> PlannerError {
        let status = match &mut self.end {
            End::Child(child) => end(child).map(|status| format!(" ({status})")),
            End::Unix(_) | End::Tcp(_) | End::Over => None,
        };
        if matches!(self.end, End::Child(_)) {
            self.end = End::Over;
        }
        PlannerError::Gone { status: status.unwrap_or_default(), planner: self.name() }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.lines = None; // closes the planner's input: a hint to end
        match &mut self.end {
            End::Child(child) => drop(end(child)),
            End::Over => {}
            End::Unix(stream) => drop(stream.shutdown(Shutdown::Both)),
            End::Tcp(stream) => drop(stream.shutdown(Shutdown::Both)),
        }
    }
}

/// Starts a command in a process group of its own; what it writes to its standard error is seen by the user.
fn start(command: &str) -> std::io::Result<(End, Streams)> {
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(command).stdin(Stdio::piped()).stdout(Stdio::piped()).process_group(0);
    let mut child = shell.spawn()?;
    let missing = || std::io::Error::other("no pipe");
    let writer = child.stdin.take().ok_or_else(missing)?;
    let reader = child.stdout.take().ok_or_else(missing)?;
    Ok((End::Child(child), (Box::new(writer), Box::new(reader))))
}

fn unix_streams(stream: &UnixStream) -> std::io::Result<Streams> {
    Ok((Box::new(stream.try_clone()?), Box::new(stream.try_clone()?)))
}

fn tcp_streams(stream: &TcpStream) -> std::io::Result<Streams> {
    stream.set_nodelay(true)?;
    Ok((Box::new(stream.try_clone()?), Box::new(stream.try_clone()?)))
}

fn connect(address: &str, timeout: Duration) -> std::io::Result<TcpStream> {
    let mut last = std::io::Error::new(std::io::ErrorKind::NotFound, "no such host");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, timeout) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// Tries until it works or the time is over; an attempt is told what is left of it. All of it is done on another thread:
/// names that are looked up and servers with a full queue hold an attempt up for longer.
fn reach<T: Send + 'static>(
    timeout: Duration,
    attempt: impl Fn(Duration) -> std::io::Result<T> + Send + 'static,
) -> std::io::Result<T> {
    let (send, reached) = sync_channel(1);
    let start = Instant::now();
    let tries = move || loop {
        let done = attempt(timeout.saturating_sub(start.elapsed()).max(RETRY));
        if done.is_ok() || start.elapsed() + RETRY >= timeout {
            let _ = send.send(done); // nobody may wait any more
            return;
        }
        std::thread::sleep(RETRY);
    };
    std::thread::Builder::new().spawn(tries)?;
    reached.recv_timeout(timeout + RETRY).unwrap_or_else(|_| {
        let text = format!("no connection within {} s", timeout.as_secs_f64());
        Err(std::io::Error::new(std::io::ErrorKind::TimedOut, text))
    })
}

/// Ends a process and whatever it started in its group; its exit status if it ended by itself in time.
fn end(child: &mut Child) -> Option<ExitStatus> {
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw)?;
    let start = Instant::now();
    // Not reaped yet, it keeps its number, so the group that is killed is its own.
    let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    let mut ended = false;
    while !ended && start.elapsed() < GRACE {
        ended = matches!(waitid(WaitId::Pid(pid), look), Ok(Some(_)));
        if !ended {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    let _ = kill_process_group(pid, Signal::KILL); // fails where nobody is left
    child.wait().ok().filter(|_| ended)
}

fn write_lines(mut writer: Box<dyn Write + Send>, lines: &Receiver<Vec<u8>>) {
    while let Ok(line) = lines.recv() {
        // Whoever waits for the answer learns that the planner is gone.
        if writer.write_all(&line).and_then(|()| writer.flush()).is_err() {
            return;
        }
    }
}

fn read_lines(reader: Box<dyn Read + Send>, answers: &SyncSender<std::io::Result<Vec<u8>>>) {
    let mut reader = BufReader::new(reader);
    loop {
        let mut line = Vec::new();
        let read = (&mut reader).take(MAX_LINE_BYTES + 1).read_until(b'\n', &mut line);
        let answer = match read {
            Ok(0) => return,
            Ok(_) => {
                if line.last() == Some(&b'\n') {
                    line.pop();
                }
                Ok(line)
            }
            Err(error) => Err(error),
        };
        let failed = answer.is_err();
        if answers.send(answer).is_err() || failed {
            return;
        }
    }
}
