//! The newest of a record, kept in memory until somebody wants it.

use std::collections::VecDeque;
use std::io::{self, Write};

use crate::write::Writer;

/// The messages of the last while, as they were added between two looks at the time.
#[derive(Debug)]
pub struct Recent {
    span_ns: u64,
    /// When they were added, by any clock that does not go back.
    looks: VecDeque<(u64, Vec<u8>)>,
    bytes: usize,
}

impl Recent {
    /// Keeps the messages of so many nanoseconds.
    pub fn new(span_ns: u64) -> Self {
        Self { span_ns, looks: VecDeque::new(), bytes: 0 }
    }

    /// Takes the messages that wait, and lets go of those that have become too old.
    pub fn keep(&mut self, writer: &mut Writer, now_ns: u64) {
        let messages = writer.take_messages();
        if !messages.is_empty() {
            self.bytes += messages.len();
            self.looks.push_back((now_ns, messages));
        }
        let first_ns = now_ns.saturating_sub(self.span_ns);
        while let Some((_, old)) = self.looks.pop_front_if(|(at_ns, _)| *at_ns < first_ns) {
            self.bytes -= old.len();
        }
    }

    /// Bytes of the messages that are kept.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Writes them as a file of their own, and keeps none of them: no two files have the same message. Returns its bytes.
    ///
    /// # Errors
    /// As [`Writer::flush`].
    pub fn save(
        &mut self,
        writer: &mut Writer,
        to: &mut impl Write,
        said: (&str, &[(&str, String)]),
    ) -> io::Result<usize> {
        // The writer has what every file begins with.
        let mut bytes = writer.flush(to)?;
        for (_, messages) in self.looks.drain(..) {
            to.write_all(&messages)?;
            bytes += messages.len();
        }
        self.bytes = 0;
        Ok(bytes + writer.end(to, said)?)
    }
}
