//! Places of the arena, and how operators reach what stands there.

use core::ops::Range;

use heapless::Vec;
use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use crate::policy::DecideError;

/// A range of the arena, in floats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Place {
    /// First float.
    pub offset: u32,
    /// Number of floats.
    pub len: u32,
}

impl Place {
    pub(crate) fn range(&self) -> Range<usize> {
        let start = self.offset as usize;
        start..start.saturating_add(self.len as usize)
    }

    /// Some floats of the place, which stay inside it.
    pub(super) fn part(&self, range: Range<usize>) -> Self {
        let start = range.start.min(self.len as usize) as u32;
        let end = range.end.min(self.len as usize) as u32;
        Self { offset: self.offset.saturating_add(start), len: end.saturating_sub(start) }
    }

    pub(super) fn disjoint(&self, other: &Self) -> bool {
        let end = |place: &Self| u64::from(place.offset) + u64::from(place.len);
        end(self) <= u64::from(other.offset) || end(other) <= u64::from(self.offset)
    }
}

/// The floats of a place.
pub(crate) fn place<'a>(floats: &'a [f32], wanted: &Place) -> Result<&'a [f32], DecideError> {
    floats.get(wanted.range()).ok_or(DecideError::BadLength)
}

/// Places that do not overlap, all writable.
#[inline(always)]
pub(crate) fn places<'a, const COUNT: usize>(
    floats: &'a mut [f32],
    wanted: [&Place; COUNT],
) -> Result<[&'a mut [f32]; COUNT], DecideError> {
    floats.get_disjoint_mut(wanted.map(Place::range)).map_err(|_| DecideError::BadLength)
}

/// Places that an operator reads or writes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Places(Vec<Place, 4>);

impl Places {
    pub(crate) fn of<const COUNT: usize>(places: [Place; COUNT]) -> Self {
        const { assert!(COUNT <= 4) }
        Self(places.into_iter().collect())
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Place> {
        self.0.iter()
    }
}

/// The floats in front of a result and behind it.
pub(crate) struct Sources<'a> {
    before: &'a [f32],
    after: &'a [f32],
    after_start: usize,
}

impl<'a> Sources<'a> {
    /// The floats of a place apart from the result.
    #[inline(always)]
    pub(crate) fn get(&self, wanted: &Place) -> Result<&'a [f32], DecideError> {
        let Range { start, end } = wanted.range();
        let found = match start.checked_sub(self.after_start) {
            Some(start) => self.after.get(start..end.saturating_sub(self.after_start)),
            None => self.before.get(start..end),
        };
        found.ok_or(DecideError::BadLength)
    }
}

/// A result, and everything apart from it, which may be read from several places that overlap.
#[inline(always)]
pub(crate) fn apart<'a>(
    floats: &'a mut [f32],
    to: &Place,
) -> Result<(Sources<'a>, &'a mut [f32]), DecideError> {
    let Range { start, end } = to.range();
    let (rest, after) = floats.split_at_mut_checked(end).ok_or(DecideError::BadLength)?;
    let (before, to) = rest.split_at_mut_checked(start).ok_or(DecideError::BadLength)?;
    Ok((Sources { before, after, after_start: end }, to))
}

/// A result that starts as a copy of a value, which may stand there already.
#[inline(always)]
pub(crate) fn copied<'a>(
    floats: &'a mut [f32],
    from: &Place,
    to: &Place,
) -> Result<&'a mut [f32], DecideError> {
    if from != to {
        let [from, to] = places(floats, [from, to])?;
        for (to, from) in to.iter_mut().zip(from) {
            *to = *from;
        }
    }
    floats.get_mut(to.range()).ok_or(DecideError::BadLength)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_is_apart_from_what_it_is_made_of() {
        let mut floats = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        let place = |offset, len| Place { offset, len };
        let (sources, to) = apart(&mut floats, &place(2, 2)).unwrap();
        assert_eq!(to, [2.0, 3.0]);
        assert_eq!(sources.get(&place(0, 2)), Ok(&[0.0, 1.0][..]));
        assert_eq!(sources.get(&place(1, 1)), Ok(&[1.0][..]));
        assert_eq!(sources.get(&place(4, 2)), Ok(&[4.0, 5.0][..]));
        for overlapping in [place(1, 2), place(2, 1), place(3, 2), place(5, 2)] {
            assert!(sources.get(&overlapping).is_err(), "{overlapping:?}");
        }
        assert!(apart(&mut floats, &place(5, 2)).is_err());
    }
}
