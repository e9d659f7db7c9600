use std::io::{BufReader, Read, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use point_skeleton::threads::spawn;

use super::connection::{self, Connection, ConnectionHandle};
use super::error::{ProtocolError, begin_of};
use super::framing::{Framing, ReadResult};
use super::{MAX_TIMEOUT_S, PeerError, PeerName, PeerSpec};

/// Connection to a peer process.
pub struct Link {
    name: PeerName,
    timeout: Duration,
    framing: Framing,
    messages: Option<SyncSender<Vec<u8>>>,
    answers: Receiver<std::io::Result<ReadResult>>,
    end: ConnectionHandle,
}

impl Link {
    /// Starts a command, or connects to a socket, which may take until the time-out to appear. `role` is the
    /// name of the process in errors.
    ///
    /// # Errors
    /// Fails if the command cannot be started or the socket cannot be reached in time.
    pub fn open(role: &'static str, spec: &PeerSpec, framing: Framing) -> Result<Self, PeerError> {
        if !(spec.timeout_s > 0.0 && spec.timeout_s <= MAX_TIMEOUT_S) {
            return Err(PeerError::Timeout { found: spec.timeout_s });
        }
        let timeout = Duration::from_secs_f64(spec.timeout_s);
        let name = PeerName { role, address: spec.address.to_string() };
        let failed = |verb| {
            let peer = name.clone();
            move |source| PeerError::Io { verb, source, peer }
        };
        let Connection { end, writer, reader } =
            connection::open(&spec.address, timeout).map_err(|(verb, source)| failed(verb)(source))?;
        let (messages, to_write) = sync_channel(1);
        let (send_answer, answers) = sync_channel(1);
        // From here on, dropping the link ends the process.
        let link = Self { name: name.clone(), timeout, framing, messages: Some(messages), answers, end };
        spawn("the thread that writes messages", move || write_messages(framing, writer, &to_write))
            .map_err(|error| failed("write to")(error.into()))?;
        spawn("the thread that reads messages", move || read_messages(framing, reader, &send_answer))
            .map_err(|error| failed("read from")(error.into()))?;
        Ok(link)
    }

    /// Sends a message and waits for the answer. After a failure, further calls fail: a late answer would be
    /// taken for the answer to the next message.
    ///
    /// # Errors
    /// Fails if the process ends, answers too late or violates the framing.
    pub fn ask(&mut self, message: Vec<u8>) -> Result<Vec<u8>, PeerError> {
        let answer = self.ask_once(message);
        if answer.is_err() {
            self.messages = None;
        }
        answer
    }

    /// Converts an invalid answer into an error, and stops asking.
    pub fn refuse(&mut self, wrong: ProtocolError) -> PeerError {
        self.messages = None;
        wrong.of(self.name.clone())
    }

    /// Returns the error for a message that cannot be serialized.
    pub fn cannot_write(&self, source: std::io::Error) -> PeerError {
        PeerError::Io { verb: "write to", source, peer: self.name.clone() }
    }

    fn ask_once(&mut self, message: Vec<u8>) -> Result<Vec<u8>, PeerError> {
        // An unsolicited answer would be taken for the answer to this message.
        if let Ok(heard) = self.answers.try_recv() {
            let unasked = self.message(heard)?;
            let expected = format!("no unsolicited {}", self.framing.unit());
            return Err(self.wrong(expected, begin_of(&unasked)));
        }
        match self.messages.as_ref().map(|messages| messages.try_send(message)) {
            Some(Ok(())) => {}
            // The peer has answered without reading the previous message.
            Some(Err(TrySendError::Full(_))) => {
                let expected =
                    format!("a {} that reads each {} before it answers", self.name.role, self.framing.unit());
                return Err(self.wrong(expected, "one that does not read"));
            }
            // The writer thread ends when writing fails, because the process has ended.
            Some(Err(TrySendError::Disconnected(_))) | None => return Err(self.gone(String::new())),
        }
        match self.answers.recv_timeout(self.timeout) {
            Ok(heard) => self.message(heard),
            Err(RecvTimeoutError::Timeout) => {
                Err(PeerError::Silent { timeout_s: self.timeout.as_secs_f64(), peer: self.name.clone() })
            }
            Err(RecvTimeoutError::Disconnected) => Err(self.gone(String::new())),
        }
    }

    /// Returns the message that was read, or an error.
    fn message(&mut self, heard: std::io::Result<ReadResult>) -> Result<Vec<u8>, PeerError> {
        match heard {
            Ok(ReadResult::Message(message)) => Ok(message),
            Ok(ReadResult::TooLong(found)) => {
                let (unit, max_bytes) = (self.framing.unit(), self.framing.max_bytes());
                Err(self.wrong(format!("a {unit} of at most {max_bytes} bytes"), found))
            }
            Ok(ReadResult::Cut { bytes, of }) => Err(self.gone(format!(" after {bytes} of {of} bytes"))),
            Err(source) => Err(PeerError::Io { verb: "read from", source, peer: self.name.clone() }),
        }
    }

    fn wrong(&self, expected: impl Into<String>, found: impl Into<String>) -> PeerError {
        ProtocolError::new(expected, found).of(self.name.clone())
    }

    /// Ends the peer and returns the error. `part` is the received part of a message; it is empty or begins
    /// with a space.
    fn gone(&mut self, part: String) -> PeerError {
        let status = self.end.end().map(|status| format!(" ({status})"));
        PeerError::Gone { after: part + &status.unwrap_or_default(), peer: self.name.clone() }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.messages = None; // closes the input of the process: a hint to end
        self.end.end();
    }
}

fn write_messages(framing: Framing, mut writer: Box<dyn Write + Send>, messages: &Receiver<Vec<u8>>) {
    while let Ok(message) = messages.recv() {
        // The thread that waits for the answer notices that the process has ended.
        if framing.write(&mut writer, message).is_err() {
            return;
        }
    }
}

fn read_messages(
    framing: Framing,
    reader: Box<dyn Read + Send>,
    answers: &SyncSender<std::io::Result<ReadResult>>,
) {
    let mut reader = BufReader::new(reader);
    while let Some(heard) = framing.read(&mut reader).transpose() {
        // The position of the next message is unknown.
        let is_last = !matches!(heard, Ok(ReadResult::Message(_)));
        if answers.send(heard).is_err() || is_last {
            return;
        }
    }
}
