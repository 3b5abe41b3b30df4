//! States as bytes: their first byte is the version of their layout, numbers are little-endian.

use alloc::string::String;

use crate::environment::StateError;

/// The version of the layout of all states.
pub(crate) const LAYOUT: u8 = 1;

/// Reads the bytes of a state, of which there are enough, and remembers what is wrong with them.
pub struct Reader<'a> {
    bytes: &'a [u8],
    flaw: Option<String>,
}

impl<'a> Reader<'a> {
    /// Of a state that has so many bytes.
    pub(crate) fn new(bytes: &'a [u8], wanted: usize) -> Result<Self, StateError> {
        match bytes {
            [found, ..] if *found != LAYOUT => {
                Err(StateError::Version { found: *found, wanted: LAYOUT })
            }
            [_, rest @ ..] if bytes.len() == wanted => Ok(Self::part(rest)),
            _ => Err(StateError::Length { found: bytes.len(), wanted }),
        }
    }

    /// Of a part of a state.
    #[inline]
    pub(crate) fn part(bytes: &'a [u8]) -> Self {
        Self { bytes, flaw: None }
    }

    /// What was read, unless something is wrong.
    pub(crate) fn sound<T>(self, read: T) -> Result<T, StateError> {
        self.flaw.map_or(Ok(read), |flaw| Err(StateError::Impossible(flaw)))
    }

    /// Remembers what is wrong, if it is; the first of several counts.
    #[inline]
    pub(crate) fn refuse(&mut self, is_wrong: bool, flaw: impl FnOnce() -> String) {
        if is_wrong && self.flaw.is_none() {
            self.flaw = Some(flaw());
        }
    }

    #[inline]
    pub(crate) fn slice(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.bytes.split_at(count);
        self.bytes = rest;
        taken
    }

    /// So many parts of equal length.
    #[inline]
    pub(crate) fn parts<const LENGTH: usize>(&mut self, count: usize) -> &'a [[u8; LENGTH]] {
        self.slice(count * LENGTH).as_chunks().0
    }

    #[inline]
    fn take<const COUNT: usize>(&mut self) -> [u8; COUNT] {
        let (taken, rest) = self.bytes.split_first_chunk().expect("the length was checked");
        self.bytes = rest;
        *taken
    }

    #[inline]
    pub(crate) fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.take())
    }

    #[inline]
    pub(crate) fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    #[inline]
    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    #[inline]
    pub(crate) fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }
}

/// What a state says that [`load`](crate::Environment::load) has taken before.
#[inline]
pub(crate) fn known<T>(read: Result<T, StateError>) -> T {
    match read {
        Ok(read) => read,
        Err(error) => panic!("a state that `load` refuses: {error}"),
    }
}
