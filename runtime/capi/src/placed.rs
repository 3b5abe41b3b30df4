//! What lies in memory of the caller, and tells itself from other memory.

use crate::errors::SortieError;

/// Has a mark that is another at every address: what was moved, overwritten or never there has none that fits.
pub(crate) trait Placed: Sized {
    /// Tells one kind from another.
    const NAME: [u8; 4];
    /// Every one starts at a multiple of it.
    const ALIGNMENT: usize;
    /// That there is none.
    const MISSING: SortieError;

    /// The mark that stands there.
    ///
    /// # Safety
    /// The address is aligned, and so many bytes can be read there; a number may have any bits.
    unsafe fn mark(at: *const Self) -> usize;

    /// The mark of one that starts there.
    fn mark_at(at: *const Self) -> usize {
        u32::from_le_bytes(Self::NAME) as usize ^ at.addr()
    }

    /// The one that a pointer leads to.
    ///
    /// # Safety
    /// Null, or so many bytes can be read there, which nobody writes meanwhile.
    unsafe fn at<'a>(at: *const Self) -> Result<&'a Self, SortieError> {
        // SAFETY: as the caller promises.
        unsafe { check(at) }?;
        // SAFETY: the mark says that one was written at this address.
        Ok(unsafe { &*at })
    }

    /// As [`Self::at`], to work with.
    ///
    /// # Safety
    /// As of [`Self::at`], and nobody else uses it meanwhile.
    unsafe fn at_mut<'a>(at: *mut Self) -> Result<&'a mut Self, SortieError> {
        // SAFETY: as the caller promises.
        unsafe { check(at) }?;
        // SAFETY: the mark says that one was written at this address.
        Ok(unsafe { &mut *at })
    }
}

/// # Safety
/// Null, or so many bytes can be read there.
unsafe fn check<T: Placed>(at: *const T) -> Result<(), SortieError> {
    if at.is_null() {
        return Err(SortieError::Null);
    }
    if !at.addr().is_multiple_of(T::ALIGNMENT) {
        return Err(T::MISSING);
    }
    // SAFETY: the address is aligned; the caller promises the bytes.
    let found = unsafe { T::mark(at) };
    if found == T::mark_at(at) { Ok(()) } else { Err(T::MISSING) }
}
