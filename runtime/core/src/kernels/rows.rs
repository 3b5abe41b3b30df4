//! Rows of a matrix, in any order.

use crate::limits::ENTITIES;

/// Rows that stand somewhere in a matrix.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// The matrix.
    pub floats: &'a [f32],
    /// Columns of a row.
    pub width: usize,
    /// Floats from the start of a row to the start of the next.
    pub stride: usize,
    /// Which of the rows are meant, one after the other.
    pub slots: &'a [u16],
}

/// All slots in order.
static IN_ORDER: [u16; ENTITIES] = {
    let mut slots = [0; ENTITIES];
    let (mut rest, mut slot) = (slots.as_mut_slice(), 0);
    while let Some((first, others)) = rest.split_first_mut() {
        *first = slot;
        slot += 1;
        rest = others;
    }
    slots
};

/// The first slots, at most as many as there can be entities.
#[inline]
pub fn first_slots(count: usize) -> &'static [u16] {
    IN_ORDER.get(..count).unwrap_or(&IN_ORDER)
}

impl<'a> Rows<'a> {
    /// The first rows of a matrix, at most as many as there can be entities.
    #[inline]
    pub fn first(floats: &'a [f32], width: usize, count: usize) -> Self {
        Self { floats, width, stride: width, slots: first_slots(count) }
    }

    /// The row in a slot, empty where there is none.
    #[inline(always)]
    pub fn row(&self, slot: u16) -> &'a [f32] {
        let start = usize::from(slot) * self.stride;
        self.floats.get(start..start + self.width).unwrap_or(&[])
    }
}
