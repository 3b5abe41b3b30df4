//! A topic in memory that cores, or a loop and its interrupts, share: one writes, others read.
//!
//! Words are loaded and stored, nothing more: that is all that the smallest processors can do
//! without a pause. Nobody waits for anybody, and nobody reads half of a message.

use super::atomic::{AtomicU32, Ordering, fence};

/// Times that a reader begins anew because the writer overtook it, before it leaves it for later.
const ATTEMPTS: usize = 4;

/// The newest messages of one writer. Each slot holds one, under its number; the slot that is
/// written next is not read, so a writer that is interrupted stops no reader. Where numbers begin
/// anew, two slots share the last number's and the first's: for one message in 2^32 a reader may
/// find nothing until it is written.
#[derive(Clone, Copy)]
pub(super) struct Topic<'a> {
    /// Number of the newest message; 0 = none.
    pub(super) newest: &'a AtomicU32,
    /// Number of the message in each slot; 0 while it is written. A power of two of them, from 2.
    pub(super) numbers: &'a [AtomicU32],
    /// The slots, one after the other.
    pub(super) words: &'a [AtomicU32],
}

/// What a reader has seen of a topic.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cursor {
    pub(super) number: u32,
    /// Messages that gave way before they were read.
    pub(super) missed: u32,
}

/// The only one that writes to a topic.
pub(super) struct Writer<'a> {
    topic: Topic<'a>,
    /// Number of the last message.
    number: u32,
}

impl<'a> Writer<'a> {
    /// Goes on where an earlier writer ended.
    pub(super) fn new(topic: Topic<'a>) -> Self {
        Self { topic, number: topic.newest.load(Ordering::Acquire) }
    }

    /// Writes a message of as many words as a slot has.
    pub(super) fn put(&mut self, message: &[u32]) {
        self.number = after(self.number);
        let Some((mark, words)) = self.topic.slot(self.number) else { return };
        mark.store(0, Ordering::Relaxed);
        // Whoever reads one of the words below sees the mark above as well.
        fence(Ordering::Release);
        for (word, value) in words.iter().zip(message) {
            word.store(*value, Ordering::Relaxed);
        }
        mark.store(self.number, Ordering::Release);
        self.topic.newest.store(self.number, Ordering::Release);
    }
}

impl<'a> Topic<'a> {
    /// Reads the oldest message that `cursor` has not seen and that will not be written over next:
    /// of two slots, the newest message. Returns whether there is one; if not, `message` is spoilt.
    pub(super) fn next(&self, cursor: &mut Cursor, message: &mut [u32]) -> bool {
        for _ in 0..ATTEMPTS {
            let waiting = self.newest.load(Ordering::Acquire).wrapping_sub(cursor.number);
            if waiting == 0 {
                return false;
            }
            let kept = (self.numbers.len() as u32).saturating_sub(1);
            let missed = waiting.saturating_sub(kept);
            let number = after(cursor.number.wrapping_add(missed));
            if self.read(number, message) {
                cursor.number = number;
                cursor.missed = cursor.missed.saturating_add(missed);
                return true;
            }
        }
        false
    }

    fn read(&self, number: u32, message: &mut [u32]) -> bool {
        let Some((mark, words)) = self.slot(number) else { return false };
        if mark.load(Ordering::Acquire) != number {
            return false;
        }
        for (value, word) in message.iter_mut().zip(words) {
            *value = word.load(Ordering::Relaxed);
        }
        // A word of a later message brought that message's mark along.
        fence(Ordering::Acquire);
        mark.load(Ordering::Relaxed) == number
    }

    fn slot(&self, number: u32) -> Option<(&'a AtomicU32, &'a [AtomicU32])> {
        let size = self.words.len().checked_div(self.numbers.len())?;
        let index = number as usize & self.numbers.len().checked_sub(1)?;
        let first = index.saturating_mul(size);
        Some((self.numbers.get(index)?, self.words.get(first..first.saturating_add(size))?))
    }
}

/// The number after `number`; 0 means none.
fn after(number: u32) -> u32 {
    number.wrapping_add(1).max(1)
}
