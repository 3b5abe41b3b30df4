//! What goes with every message beside it: which it is of its publisher, when it was sent, and by whom.

/// Bytes of an attachment.
pub const ATTACHMENT_BYTES: usize = 33;

/// Which message it is, when it was sent, and by whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// One more with every message of this publisher, from 1.
    pub sequence: i64,
    /// When it was sent, in nanoseconds since 1970.
    pub source_ns: i64,
    /// Its publisher: [`Token::gid`](crate::Token::gid).
    pub gid: [u8; 16],
}

/// Why bytes are no attachment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AttachmentError {
    /// Another number of bytes.
    #[error(
        "an attachment has 33 bytes, this one {0}: its publisher is no rmw_zenoh of ROS 2 Humble or later"
    )]
    Length(usize),
    /// Another length of the publisher's id.
    #[error("the id of a publisher has 16 bytes, this one says {0}")]
    Gid(u8),
}

impl Attachment {
    /// As it crosses.
    pub fn to_bytes(&self) -> [u8; ATTACHMENT_BYTES] {
        let mut bytes = [0; ATTACHMENT_BYTES];
        let parts: [&[u8]; 4] = [
            &self.sequence.to_le_bytes(),
            &self.source_ns.to_le_bytes(),
            &[self.gid.len() as u8],
            &self.gid,
        ];
        for (to, from) in bytes.iter_mut().zip(parts.into_iter().flatten()) {
            *to = *from;
        }
        bytes
    }

    /// Of what came.
    ///
    /// # Errors
    /// See [`AttachmentError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, AttachmentError> {
        let whole: &[u8; ATTACHMENT_BYTES] =
            bytes.try_into().map_err(|_| AttachmentError::Length(bytes.len()))?;
        let short = AttachmentError::Length(bytes.len());
        let (sequence, rest) = whole.split_first_chunk::<8>().ok_or(short)?;
        let (source_ns, rest) = rest.split_first_chunk::<8>().ok_or(short)?;
        let (&length, gid) = rest.split_first().ok_or(short)?;
        if usize::from(length) != gid.len() {
            return Err(AttachmentError::Gid(length));
        }
        Ok(Self {
            sequence: i64::from_le_bytes(*sequence),
            source_ns: i64::from_le_bytes(*source_ns),
            gid: gid.try_into().map_err(|_| short)?,
        })
    }
}
