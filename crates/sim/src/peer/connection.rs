use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::process::ExitStatus;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use point_skeleton::threads::spawn;

use super::PeerAddress;
use super::group::Group;

/// Interval between attempts to connect to a socket that does not exist yet.
const RETRY: Duration = Duration::from_millis(50);

/// Reader and writer of a connection, and the resource that closes with it.
pub(super) struct Connection {
    pub(super) end: ConnectionHandle,
    pub(super) writer: Box<dyn Write + Send>,
    pub(super) reader: Box<dyn Read + Send>,
}

/// Resource that closes with a connection.
pub(super) enum ConnectionHandle {
    Group(Group),
    Unix(UnixStream),
    Tcp(TcpStream),
    /// Already ended.
    Over,
}

impl ConnectionHandle {
    /// Ends the connection. Returns the exit status of a command that exited by itself.
    pub(super) fn end(&mut self) -> Option<ExitStatus> {
        match std::mem::replace(self, Self::Over) {
            Self::Group(mut group) => group.end(),
            Self::Unix(stream) => {
                let _ = stream.shutdown(Shutdown::Both); // fails if the other side closed first
                None
            }
            Self::Tcp(stream) => {
                let _ = stream.shutdown(Shutdown::Both);
                None
            }
            Self::Over => None,
        }
    }
}

/// Starts a command, or connects to a socket, which may take until the time-out to appear. An error comes
/// with the verb of the failed operation.
pub(super) fn open(
    address: &PeerAddress,
    timeout: Duration,
) -> Result<Connection, (&'static str, std::io::Error)> {
    match address.clone() {
        PeerAddress::Command(command) => start(&command).map_err(|error| ("start", error)),
        PeerAddress::Unix(path) => reach(timeout, move |_| UnixStream::connect(&path))
            .and_then(unix)
            .map_err(|error| ("reach", error)),
        PeerAddress::Tcp(address) => reach(timeout, move |left| connect(&address, left))
            .and_then(tcp)
            .map_err(|error| ("reach", error)),
    }
}

fn start(command: &str) -> std::io::Result<Connection> {
    let (group, writer, reader) = Group::start(command)?;
    Ok(Connection { end: ConnectionHandle::Group(group), writer: Box::new(writer), reader: Box::new(reader) })
}

fn unix(stream: UnixStream) -> std::io::Result<Connection> {
    let (writer, reader) = (stream.try_clone()?, stream.try_clone()?);
    Ok(Connection { end: ConnectionHandle::Unix(stream), writer: Box::new(writer), reader: Box::new(reader) })
}

fn tcp(stream: TcpStream) -> std::io::Result<Connection> {
    stream.set_nodelay(true)?;
    let (writer, reader) = (stream.try_clone()?, stream.try_clone()?);
    Ok(Connection { end: ConnectionHandle::Tcp(stream), writer: Box::new(writer), reader: Box::new(reader) })
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

/// Retries `attempt`, which gets the remaining time, until it succeeds or the time-out expires. All attempts
/// run on another thread, because name resolution and servers with a full queue can block for longer.
fn reach<T: Send + 'static>(
    timeout: Duration,
    attempt: impl Fn(Duration) -> std::io::Result<T> + Send + 'static,
) -> std::io::Result<T> {
    let (send, reached) = sync_channel(1);
    let start = Instant::now();
    let tries = move || loop {
        let done = attempt(timeout.saturating_sub(start.elapsed()).max(RETRY));
        if done.is_ok() || start.elapsed() + RETRY >= timeout {
            let _ = send.send(done); // the receiver may have timed out
            return;
        }
        std::thread::sleep(RETRY);
    };
    spawn("the thread that connects", tries)?;
    reached.recv_timeout(timeout + RETRY).unwrap_or_else(|_| {
        let text = format!("no connection within {} s", timeout.as_secs_f64());
        Err(std::io::Error::new(std::io::ErrorKind::TimedOut, text))
    })
}
