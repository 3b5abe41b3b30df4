//! Arrays of C: looked at before anything is read, and never at once as what is read and what is written.

use core::slice;

use crate::errors::SortieError;

/// Numbers in memory of the caller, as a pointer and a length say it.
#[derive(Clone, Copy)]
pub(crate) struct Array<T> {
    start: *mut T,
    len: usize,
}

/// A range of addresses.
#[derive(Clone, Copy)]
pub(crate) struct Span {
    start: usize,
    end: usize,
}

impl<T: Copy> Array<T> {
    pub(crate) fn new(start: *const T, len: usize) -> Self {
        Self { start: start.cast_mut(), len }
    }

    /// The array if it is of the wanted length and can be somewhere.
    pub(crate) fn of(start: *const T, len: usize, want: usize) -> Result<Self, SortieError> {
        if len != want {
            return Err(SortieError::WrongLength);
        }
        let array = Self::new(start, len);
        if len == 0 {
            return Ok(array);
        }
        if start.is_null() {
            return Err(SortieError::Null);
        }
        if !start.is_aligned() {
            return Err(SortieError::Misaligned);
        }
        let bytes = len.checked_mul(size_of::<T>()).filter(|bytes| isize::try_from(*bytes).is_ok());
        let end = bytes.and_then(|bytes| start.addr().checked_add(bytes));
        end.map(|_| array).ok_or(SortieError::WrongLength)
    }

    pub(crate) fn start(self) -> *mut T {
        self.start
    }

    pub(crate) fn len(self) -> usize {
        self.len
    }

    pub(crate) fn span(self) -> Span {
        let start = self.start.addr();
        Span { start, end: start.saturating_add(self.len.saturating_mul(size_of::<T>())) }
    }

    /// # Safety
    /// The array comes from [`Self::of`]; its numbers are there, of a type that has a value for all bits, and nobody
    /// writes them as long as they are read.
    pub(crate) unsafe fn read<'a>(self) -> &'a [T] {
        if self.len == 0 {
            return &[];
        }
        // SAFETY: not null, aligned and no longer than memory is, as `of` saw; the rest is the caller's promise.
        unsafe { slice::from_raw_parts(self.start, self.len) }
    }

    /// # Safety
    /// As of [`Self::read`], and nobody reads the numbers either.
    pub(crate) unsafe fn write<'a>(self) -> &'a mut [T] {
        if self.len == 0 {
            return &mut [];
        }
        // SAFETY: as in `read`.
        unsafe { slice::from_raw_parts_mut(self.start, self.len) }
    }
}

impl Span {
    pub(crate) const EMPTY: Self = Self { start: 0, end: 0 };

    fn overlaps(self, other: Self) -> bool {
        self.start.max(other.start) < self.end.min(other.end)
    }
}

/// Whether what is written lies apart from all else.
pub(crate) fn apart(
    written: impl Iterator<Item = Span> + Clone,
    read: impl Iterator<Item = Span> + Clone,
) -> Result<(), SortieError> {
    let mut rest = written;
    while let Some(span) = rest.next() {
        if rest.clone().chain(read.clone()).any(|other| span.overlaps(other)) {
            return Err(SortieError::Overlap);
        }
    }
    Ok(())
}
