//! Explores the interleavings of a topic's writer and its readers, over the product's own code, with all that
//! loads and stores may show to another core: nobody reads half of a message, or an older one after a newer.
#![cfg(test)]

#[path = "../../../../runtime/core/src/link/spsc/topic.rs"]
mod topic;

mod atomic {
    pub(crate) use loom::sync::atomic::{AtomicU32, Ordering, fence};
}

use std::array;
use std::sync::Arc;

use atomic::{AtomicU32, Ordering, fence};
use loom::thread;
use topic::{Cursor, Topic, Writer};

/// Words of a message, all of which are its number.
const WORDS: usize = 2;

struct Memory {
    newest: AtomicU32,
    numbers: Vec<AtomicU32>,
    words: Vec<AtomicU32>,
}

impl Memory {
    /// `sent` messages have been sent long ago.
    fn new(slots: usize, sent: u32) -> Self {
        let zeros = |count: usize| (0..count).map(|_| AtomicU32::new(0)).collect();
        Self { newest: AtomicU32::new(sent), numbers: zeros(slots), words: zeros(slots * WORDS) }
    }

    fn topic(&self) -> Topic<'_> {
        Topic { newest: &self.newest, numbers: &self.numbers, words: &self.words }
    }
}

/// Puts a message of the given number.
type Put = fn(&mut Writer<'_>, &Topic<'_>, u32);

/// One thread puts `messages`, others and this one read meanwhile. Returns when all interleavings are explored, or
/// those in which at most `switches` come where a thread could go on.
fn explore(slots: usize, messages: u32, readers: usize, switches: Option<usize>, put: Put) {
    explore_from(0, slots, messages, readers, switches, put);
}

/// The same after `sent` messages, whose numbers go on from there.
fn explore_from(
    sent: u32,
    slots: usize,
    messages: u32,
    readers: usize,
    switches: Option<usize>,
    put: Put,
) {
    let mut explorer = loom::model::Builder::new();
    explorer.preemption_bound = explorer.preemption_bound.or(switches);
    explorer.check(move || {
        let memory = Arc::new(Memory::new(slots, sent));
        let numbers: Vec<u32> =
            (0..=messages).scan(sent, |n, _| Some(std::mem::replace(n, after(*n)))).collect();
        let readers: Vec<_> = (0..readers)
            .map(|_| {
                let memory = Arc::clone(&memory);
                thread::spawn(move || {
                    let mut cursor = Cursor { number: sent, missed: 0 };
                    let seen = read(&memory, &mut cursor, sent);
                    (cursor, seen)
                })
            })
            .collect();
        let mut writer = Writer::new(memory.topic());
        numbers[1..].iter().for_each(|number| put(&mut writer, &memory.topic(), *number));
        for reader in readers {
            let (mut cursor, seen) = reader.join().unwrap();
            // The writer rests: what it left is there, and whole.
            assert_eq!(read(&memory, &mut cursor, seen), numbers[messages as usize]);
        }
    });
}

/// The number after `number`: 0 is none.
fn after(number: u32) -> u32 {
    number.checked_add(1).unwrap_or(1)
}

/// Reads what waits, after `seen`. Returns the newest message read.
fn read(memory: &Memory, cursor: &mut Cursor, seen: u32) -> u32 {
    let mut newest = seen;
    // No more than there are.
    for _ in 0..memory.numbers.len() {
        let mut words = [0; WORDS];
        if !memory.topic().next(cursor, &mut words) {
            return newest;
        }
        assert_eq!(words, [cursor.number; WORDS], "not this message alone");
        let is_newer = cursor.number.wrapping_sub(newest) < 1 << 31 && cursor.number != newest;
        assert!(is_newer, "{} after {newest}", cursor.number);
        newest = cursor.number;
    }
    newest
}

fn right(writer: &mut Writer<'_>, _: &Topic<'_>, number: u32) {
    writer.put(&[number; WORDS]);
}

#[test]
fn the_newest_message_of_two_slots_is_read_whole() {
    explore(2, 3, 1, Some(5), right);
}

#[test]
fn two_readers_do_not_disturb_each_other() {
    explore(2, 2, 2, Some(3), right);
}

#[test]
fn messages_of_four_slots_are_read_in_order() {
    explore(4, 4, 1, Some(3), right);
}

/// A loop's writer is stopped between any two steps while its interrupt reads: the newest whole message is there.
#[test]
fn an_interrupted_writer_stops_no_reader() {
    loom::model(|| {
        let memory = Arc::new(Memory::new(2, 0));
        Writer::new(memory.topic()).put(&[1; WORDS]);
        let topic = memory.topic();
        // The second half of a write never comes.
        topic.numbers[0].store(0, Ordering::Relaxed);
        topic.words[0].store(2, Ordering::Relaxed);
        assert_eq!(read(&memory, &mut Cursor::default(), 0), 1);
    });
}

#[test]
fn numbers_begin_anew_after_the_last() {
    let start = u32::MAX - 2;
    loom::model(move || {
        let memory = Memory::new(2, start);
        let mut writer = Writer::new(memory.topic());
        let mut cursor = Cursor { number: start, missed: 0 };
        for number in [u32::MAX - 1, u32::MAX, 1, 2, 3] {
            writer.put(&[number; WORDS]);
            let mut words = [0; WORDS];
            assert!(memory.topic().next(&mut cursor, &mut words));
            assert_eq!((words, cursor.number), ([number; WORDS], number));
        }
    });
}

/// Of two slots, the last number and the first share one: for one message in 2^32 a reader may have to wait.
#[test]
fn where_numbers_begin_anew_messages_are_read_whole_and_the_newest_at_last() {
    explore_from(u32::MAX - 2, 2, 4, 1, Some(3), right);
    explore_from(u32::MAX - 2, 4, 4, 1, Some(3), right);
}

#[test]
fn messages_that_gave_way_are_counted() {
    loom::model(|| {
        let (memory, mut cursor) = (Memory::new(4, 0), Cursor::default());
        let mut writer = Writer::new(memory.topic());
        (1..=7).for_each(|number| writer.put(&[number; WORDS]));
        let got: [u32; 3] = array::from_fn(|_| {
            let mut words = [0; WORDS];
            assert!(memory.topic().next(&mut cursor, &mut words));
            words[0]
        });
        assert_eq!((got, cursor.missed), ([5, 6, 7], 4));
    });
}

/// Wrong variants, which the explorer must refute: an explorer that finds nothing proves nothing.
mod wrong {
    use super::*;

    fn store(topic: &Topic<'_>, number: u32, marks: bool, fences: bool) {
        let slot = number as usize & (topic.numbers.len() - 1);
        if marks {
            topic.numbers[slot].store(0, Ordering::Relaxed);
        }
        if fences {
            fence(Ordering::Release);
        }
        for word in &topic.words[slot * WORDS..][..WORDS] {
            word.store(number, Ordering::Relaxed);
        }
        let order = if fences { Ordering::Release } else { Ordering::Relaxed };
        topic.numbers[slot].store(number, order);
        topic.newest.store(number, order);
    }

    fn without_mark(_: &mut Writer<'_>, topic: &Topic<'_>, number: u32) {
        store(topic, number, false, true);
    }

    fn without_order(_: &mut Writer<'_>, topic: &Topic<'_>, number: u32) {
        store(topic, number, true, false);
    }

    #[test]
    #[should_panic(expected = "not this message alone")]
    fn a_slot_that_is_not_marked_is_read_in_halves() {
        explore(2, 4, 1, Some(3), without_mark);
    }

    #[test]
    #[should_panic(expected = "not this message alone")]
    fn stores_without_order_are_read_in_halves() {
        explore(2, 2, 1, Some(3), without_order);
    }
}
