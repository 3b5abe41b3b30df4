//! Numbers as bytes, as states have them.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::physics::Mover;
use super::plane::Point;

/// The byte of what is not there.
const NONE: u8 = u8::MAX;

/// Reads the bytes of a state, of which there are enough, and remembers what is wrong with them.
pub struct Reader<'a> {
    bytes: &'a [u8],
    flaw: Option<String>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, flaw: None }
    }

    /// What is wrong.
    pub(super) fn flaw(self) -> Option<String> {
        self.flaw
    }

    #[inline]
    fn take<const COUNT: usize>(&mut self) -> [u8; COUNT] {
        let (taken, rest) = self.bytes.split_first_chunk().expect("the length was checked");
        self.bytes = rest;
        *taken
    }

    /// Remembers what is wrong, if it is; the first of several counts.
    #[inline]
    pub(super) fn refuse(&mut self, is_wrong: bool, flaw: impl FnOnce() -> String) {
        if is_wrong && self.flaw.is_none() {
            self.flaw = Some(flaw());
        }
    }

    pub(super) fn count(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    #[inline]
    pub(super) fn number(&mut self) -> f64 {
        let number = f64::from_le_bytes(self.take());
        self.refuse(!number.is_finite(), || "one of its numbers is none".into());
        number
    }

    #[inline]
    pub(super) fn point(&mut self) -> Point {
        [self.number(), self.number()]
    }

    #[inline]
    pub(super) fn mover(&mut self) -> Mover {
        Mover { position: self.point(), velocity: self.point() }
    }

    /// One of so many things.
    #[inline]
    pub(super) fn index(&mut self, what: &str, count: usize) -> u8 {
        let [index] = self.take();
        self.refuse(usize::from(index) >= count, || format!("{what} {index}"));
        index
    }

    /// One of so many things, or none of them.
    #[inline]
    pub(super) fn choice(&mut self, what: &str, count: usize) -> Option<u8> {
        let [index] = self.take();
        self.refuse(index != NONE && usize::from(index) >= count, || format!("{what} {index}"));
        (index != NONE).then_some(index)
    }
}

pub(super) fn write_number(number: f64, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&number.to_le_bytes());
}

pub(super) fn write_point(point: Point, bytes: &mut Vec<u8>) {
    point.into_iter().for_each(|part| write_number(part, bytes));
}

pub(super) fn write_movers(movers: &[Mover], bytes: &mut Vec<u8>) {
    for mover in movers {
        write_point(mover.position, bytes);
        write_point(mover.velocity, bytes);
    }
}

pub(super) fn write_choice(choice: Option<u8>, bytes: &mut Vec<u8>) {
    bytes.push(choice.unwrap_or(NONE));
}
