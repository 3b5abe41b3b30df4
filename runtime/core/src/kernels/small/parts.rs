//! What sums of a part's columns are made of: words of weights, and lists of the inputs that are not zero.

use crate::kernels::int8::Pair;

/// Columns whose sums are kept together.
pub(super) const PART: usize = 8;

/// Most pairs of inputs that are listed as not zero: rows of features have few.
const LISTED: usize = 32;

/// Weights of two columns for a pair of inputs: of each column the first input's, then the second's; for the DSP extension the
/// two in the middle are exchanged.
pub(super) type Columns = u32;

/// Weights of a part's columns for a pair of inputs.
pub(super) type Part = [Columns; PART / 2];

/// A pair of inputs that is not zero, and the first of its rows.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Listed {
    pub(super) row: u32,
    pub(super) pair: Pair,
}

/// The pairs of inputs that are not zero, in rising order; behind them stands at least one that is.
#[derive(Debug)]
pub(super) struct List {
    pairs: [Listed; LISTED + 1],
    count: usize,
}

impl List {
    /// No pairs.
    pub(super) const EMPTY: Self =
        Self { pairs: [Listed { row: 0, pair: [0; 2] }; LISTED + 1], count: 0 };

    /// Lists the first pairs of inputs that are not zero, each with the first of its rows; those behind the last one that there is
    /// room for are returned.
    #[inline(always)]
    pub(super) fn fill<'p>(&mut self, pairs: &'p [Pair], strips: usize) -> &'p [Pair] {
        let (mut row, mut rest) = (0_u32, pairs);
        while let [pair, others @ ..] = rest {
            if *pair != [0; 2] {
                let (Some(place), true) = (self.pairs.get_mut(self.count), self.count < LISTED)
                else {
                    break;
                };
                *place = Listed { row, pair: *pair };
                self.count += 1;
            }
            // Far from overflow: inputs and outputs are numbers of 16 bits.
            (row, rest) = (row.wrapping_add(strips as u32), others);
        }
        rest
    }

    /// The listed pairs.
    pub(super) fn pairs(&self) -> &[Listed] {
        self.pairs.get(..self.count).unwrap_or(&[])
    }
}
