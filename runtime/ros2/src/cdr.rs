//! Messages as bytes: plain CDR (XCDR1), little endian, behind four bytes that say so.
//!
//! What comes from the network is checked here and nowhere else: bytes that are cut, of another type, or made to hurt are
//! refused, and no count in them makes more memory be taken than a megabyte beyond what they hold.

use byteorder::LittleEndian;
use cdr_encoding::{from_bytes, to_writer};

use crate::messages::Message;

/// Plain CDR of little-endian hosts, no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];
/// Plain CDR of big-endian hosts, in the same place.
const BIG_ENDIAN: [u8; 2] = [0, 0];
/// Writers may fill up to a multiple of four bytes.
const MOST_PADDING: usize = 3;

/// Why bytes are no message, or a message cannot be written.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CdrError {
    /// Fewer than four bytes.
    #[error("it has {0} bytes, fewer than what says how it is encoded")]
    NoHeader(usize),
    /// Plain CDR of a big-endian host.
    #[error("it is big endian; publish from a little-endian host")]
    BigEndian,
    /// Another encoding than plain CDR.
    #[error("its encoding is {0:#06x}, not plain CDR (0x0001)")]
    Encoding(u16),
    /// The bytes end within the message.
    #[error("it ends before a {0} does: it was cut, or is of another type")]
    Short(&'static str),
    /// The bytes go on behind the message.
    #[error("{left} bytes are left behind a {name}: it is of another type")]
    Long {
        /// The type that was read.
        name: &'static str,
        /// Bytes behind it.
        left: usize,
    },
    /// A part of it is no text, no truth value, or too long.
    #[error("it is no {name}: {problem}")]
    Content {
        /// The type that was read or written.
        name: &'static str,
        /// What is wrong.
        problem: String,
    },
}

/// Writes a message in the place of what `bytes` held, whose memory is used again.
///
/// # Errors
/// [`CdrError::Content`]: a list or a text of the message has more than 2^32 - 1 parts.
pub fn encode<M: Message>(message: &M, bytes: &mut Vec<u8>) -> Result<(), CdrError> {
    bytes.clear();
    bytes.extend(HEADER);
    // Numbers are aligned to the byte behind the header, from which the writer counts.
    to_writer::<M, LittleEndian, _>(&mut *bytes, message).map_err(wrong::<M>)
}

/// Reads a message that is all of `bytes`.
///
/// # Errors
/// See [`CdrError`].
///
/// ```
/// use sortie_ros2::{CdrError, decode, encode, messages::Text};
///
/// let mut bytes = Vec::new();
/// encode(&Text { data: "hello".to_owned() }, &mut bytes)?;
/// assert_eq!(bytes, *b"\0\x01\0\0\x06\0\0\0hello\0");
/// assert_eq!(decode::<Text>(&bytes)?.data, "hello");
/// assert_eq!(decode::<Text>(&bytes[..9]), Err(CdrError::Short("std_msgs/msg/String")));
/// # Ok::<(), CdrError>(())
/// ```
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, CdrError> {
    let (&[high, low, ..], body) =
        bytes.split_first_chunk::<4>().ok_or(CdrError::NoHeader(bytes.len()))?;
    match [high, low] {
        [0, 1] => {}
        BIG_ENDIAN => return Err(CdrError::BigEndian),
        other => return Err(CdrError::Encoding(u16::from_be_bytes(other))),
    }
    let (message, read) = from_bytes::<M, LittleEndian>(body).map_err(wrong::<M>)?;
    match body.len().saturating_sub(read) {
        0..=MOST_PADDING => Ok(message),
        left => Err(CdrError::Long { name: M::NAME, left }),
    }
}

fn wrong<M: Message>(error: cdr_encoding::Error) -> CdrError {
    match error {
        cdr_encoding::Error::Eof => CdrError::Short(M::NAME),
        other => CdrError::Content { name: M::NAME, problem: other.to_string() },
    }
}
