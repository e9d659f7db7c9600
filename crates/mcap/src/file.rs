//! An MCAP file that is written in one pass. Chunks are not compressed, since nearly all bytes are of PNG and
//! JPEG.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use foxglove::Encode;
use foxglove::messages::Timestamp;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use point_skeleton::error::FileError;

/// Library in the header of the file.
const LIBRARY: &str = concat!("pskel ", env!("CARGO_PKG_VERSION"));

/// File of messages.
pub(super) struct LogFile<W: Write> {
    writer: Writer<NoSeek<W>>,
    /// By topic.
    channels: BTreeMap<String, Channel>,
    /// Message, encoded.
    buffer: Vec<u8>,
    /// Path for messages.
    shown: PathBuf,
}

/// Channel of a topic.
#[derive(Clone, Copy)]
struct Channel {
    id: u16,
    /// Number of messages so far.
    messages: u32,
}

impl<W: Write> LogFile<W> {
    /// Begins a file; `shown` is its path for messages.
    pub(super) fn begin(file: W, shown: &Path) -> Result<Self, FileError> {
        let options = WriteOptions::new().compression(None).library(LIBRARY).disable_seeking(true);
        let writer = options.create(NoSeek::new(file)).map_err(|error| failed(shown, error))?;
        Ok(Self { writer, channels: BTreeMap::new(), buffer: Vec::new(), shown: shown.to_owned() })
    }

    pub(super) fn shown(&self) -> &Path {
        &self.shown
    }

    /// Writes a metadata record.
    pub(super) fn describe(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), FileError> {
        let record = Metadata { name: name.to_owned(), metadata };
        self.writer.write_metadata(&record).map_err(|error| failed(&self.shown, error))
    }

    /// Writes a message.
    pub(super) fn write<M: Encode>(
        &mut self,
        topic: &str,
        time: Timestamp,
        message: &M,
    ) -> Result<(), FileError> {
        let Channel { id, messages } = match self.channels.get(topic) {
            Some(channel) => *channel,
            None => Channel { id: self.add_channel::<M>(topic)?, messages: 0 },
        };
        self.channels.insert(topic.to_owned(), Channel { id, messages: messages + 1 });
        self.buffer.clear();
        let encoded = message.encode(&mut self.buffer).map_err(|error| error.to_string());
        encoded.map_err(|error| FileError::io("write", &self.shown)(std::io::Error::other(error)))?;
        let [log_time, publish_time] = [time.total_nanos(); 2];
        let header = MessageHeader { channel_id: id, sequence: messages, log_time, publish_time };
        let written = self.writer.write_to_known_channel(&header, &self.buffer);
        written.map_err(|error| failed(&self.shown, error))
    }

    fn add_channel<M: Encode>(&mut self, topic: &str) -> Result<u16, FileError> {
        let schema = match M::get_schema() {
            Some(schema) => self.writer.add_schema(&schema.name, &schema.encoding, &schema.data),
            None => Ok(0),
        };
        let encoding = M::get_message_encoding();
        let added = schema.and_then(|id| self.writer.add_channel(id, topic, &encoding, &BTreeMap::new()));
        added.map_err(|error| failed(&self.shown, error))
    }

    /// Writes the index and returns the file.
    pub(super) fn finish(mut self) -> Result<W, FileError> {
        self.writer.finish().map_err(|error| failed(&self.shown, error))?;
        Ok(self.writer.into_inner().into_inner())
    }
}

fn failed(shown: &Path, error: McapError) -> FileError {
    FileError::io("write", shown)(match error {
        McapError::Io(error) => error,
        other => std::io::Error::other(other),
    })
}
