use std::io::{BufRead, Read, Result, Write};

use super::error::begin_of;

/// Delimiting of messages in the byte stream, with the maximum length of an answer.
#[derive(Clone, Copy, Debug)]
pub enum Framing {
    /// Each message ends with a newline.
    Lines {
        /// Maximum length without the newline.
        max_bytes: u64,
    },
    /// Each message follows its length, a little-endian `u64`.
    Lengths {
        /// Maximum length without the length field.
        max_bytes: u64,
    },
}

/// Result of reading one message.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum ReadResult {
    /// A message without its delimiter.
    Message(Vec<u8>),
    /// A message over the length limit; describes the received bytes.
    TooLong(String),
    /// The stream ended within a message.
    Cut {
        /// Number of bytes received.
        bytes: u64,
        /// Number of bytes expected.
        of: u64,
    },
}

const LENGTH_BYTES: u64 = 8;

impl Framing {
    /// Returns the noun for a message in error texts.
    pub(super) fn unit(self) -> &'static str {
        match self {
            Self::Lines { .. } => "line",
            Self::Lengths { .. } => "message",
        }
    }

    pub(super) fn max_bytes(self) -> u64 {
        match self {
            Self::Lines { max_bytes } | Self::Lengths { max_bytes } => max_bytes,
        }
    }

    /// Writes a message with its delimiter.
    pub(super) fn write(self, writer: &mut impl Write, mut message: Vec<u8>) -> Result<()> {
        match self {
            Self::Lines { .. } => message.push(b'\n'),
            Self::Lengths { .. } => writer.write_all(&(message.len() as u64).to_le_bytes())?,
        }
        writer.write_all(&message)?;
        writer.flush()
    }

    /// Waits for a message; `None` at the end of the stream.
    pub(super) fn read(self, reader: &mut impl BufRead) -> Result<Option<ReadResult>> {
        match self {
            Self::Lines { max_bytes } => read_line(reader, max_bytes),
            Self::Lengths { max_bytes } => read_counted(reader, max_bytes),
        }
    }
}

fn read_line(reader: &mut impl BufRead, max_bytes: u64) -> Result<Option<ReadResult>> {
    let mut line = Vec::new();
    if reader.take(max_bytes + 1).read_until(b'\n', &mut line)? == 0 {
        return Ok(None);
    }
    if line.last() == Some(&b'\n') {
        line.pop();
    }
    let is_long = line.len() as u64 > max_bytes;
    Ok(Some(if is_long { ReadResult::TooLong("a longer one".to_owned()) } else { ReadResult::Message(line) }))
}

fn read_counted(reader: &mut impl BufRead, max_bytes: u64) -> Result<Option<ReadResult>> {
    let mut length = Vec::new();
    reader.by_ref().take(LENGTH_BYTES).read_to_end(&mut length)?;
    let Ok(counted) = <[u8; LENGTH_BYTES as usize]>::try_from(length.as_slice()) else {
        let bytes = length.len() as u64;
        return Ok((bytes > 0).then_some(ReadResult::Cut { bytes, of: LENGTH_BYTES }));
    };
    let of = u64::from_le_bytes(counted);
    if of > max_bytes {
        // Usually text was sent without the length field.
        return Ok(Some(ReadResult::TooLong(format!("a length of {of}, bytes {}", begin_of(&length)))));
    }
    // Grows with the received bytes, so a wrong length does not allocate.
    let mut message = Vec::new();
    reader.take(of).read_to_end(&mut message)?;
    let bytes = message.len() as u64;
    Ok(Some(if bytes < of {
        ReadResult::Cut { bytes: LENGTH_BYTES + bytes, of: LENGTH_BYTES + of }
    } else {
        ReadResult::Message(message)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(framing: Framing, mut bytes: &[u8]) -> Vec<ReadResult> {
        std::iter::from_fn(|| framing.read(&mut bytes).unwrap()).collect()
    }

    #[test]
    fn messages_round_trip() {
        for framing in [Framing::Lines { max_bytes: 4 }, Framing::Lengths { max_bytes: 4 }] {
            let mut bytes = Vec::new();
            for message in ["", "abcd", "e"] {
                framing.write(&mut bytes, message.into()).unwrap();
            }
            let heard = ["", "abcd", "e"].map(|message| ReadResult::Message(message.into()));
            assert_eq!(all(framing, &bytes), heard);
            framing.write(&mut bytes, b"abcde".to_vec()).unwrap();
            assert!(matches!(all(framing, &bytes)[3], ReadResult::TooLong(_)));
        }
    }

    #[test]
    fn detects_truncated_and_oversized_messages() {
        let counted = Framing::Lengths { max_bytes: 4 };
        assert_eq!(all(counted, &[3, 0, 0]), [ReadResult::Cut { bytes: 3, of: 8 }]);
        assert_eq!(all(counted, &[3, 0, 0, 0, 0, 0, 0, 0, 7]), [ReadResult::Cut { bytes: 9, of: 11 }]);
        let ReadResult::TooLong(found) = &all(counted, b"loading the model")[0] else { panic!() };
        assert_eq!(found, "a length of 2334956330749620076, bytes \"loading \"");
        // The last line may end without a newline.
        assert_eq!(all(Framing::Lines { max_bytes: 4 }, b"ab"), [ReadResult::Message(b"ab".to_vec())]);
    }
}
