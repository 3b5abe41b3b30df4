//! One matrix times several vectors: weights are read once for all of them.

use super::arithmetic::Arithmetic;
use super::product::{Around, add_row, finished, split_off_rows, tile_width};

/// A vector of inputs, and the place of its outputs, whose length is a multiple of eight.
#[derive(Debug)]
pub struct Pair<'a> {
    /// The inputs, as many in every pair.
    pub inputs: &'a [f32],
    /// The outputs, as many in every pair.
    pub outputs: &'a mut [f32],
}

/// Most vectors whose sums fit into registers beside the weights.
const GROUP: usize = 6;

/// Columns whose sums are held together.
pub const STRIP: usize = 16;

/// Adds up rows of weights for several vectors.
pub trait AddRows: Copy {
    /// For every vector `start`, plus each row's strip `part` times the vector's input, one row after the other.
    /// There are as many inputs as rows.
    fn add_rows<A: Arithmetic, const WIDTH: usize, const COUNT: usize>(
        self,
        rows: &[[f32; WIDTH]],
        part: usize,
        start: [f32; STRIP],
        inputs: [&[f32]; COUNT],
    ) -> [[f32; STRIP]; COUNT];
}

/// Writes the product of a matrix and every pair's inputs to its outputs, each with the bits that
/// [`super::product::product`] gives.
#[inline(always)]
pub fn products<A: Arithmetic>(
    adder: impl AddRows,
    weights: &[f32],
    pairs: &mut [Pair<'_>],
    around: Around<'_>,
) {
    let Some(Pair { inputs, outputs }) = pairs.first() else { return };
    let (rows, columns) = (inputs.len(), outputs.len());
    // Groups of equal size: eight vectors are two times four.
    let groups = pairs.len().div_ceil(GROUP).max(1);
    let group = pairs.len().div_ceil(groups).max(1);
    let mut tiles = Tiles { weights, around, rows, column: 0 };
    while tiles.column < columns {
        let done = match tile_width(columns - tiles.column) {
            64 => tiles.add_wide::<A, 64>(adder, pairs, group),
            32 => tiles.add_wide::<A, 32>(adder, pairs, group),
            16 => tiles.add_wide::<A, 16>(adder, pairs, group),
            _ => tiles.add_narrow::<A>(pairs),
        };
        if done.is_none() {
            return;
        }
    }
}

/// The tiles of a matrix that are still to be worked on, from `column` on.
struct Tiles<'w> {
    weights: &'w [f32],
    around: Around<'w>,
    rows: usize,
    column: usize,
}

impl Tiles<'_> {
    /// Works on the next tile, which is `WIDTH` columns wide, strip by strip.
    #[inline(always)]
    fn add_wide<A: Arithmetic, const WIDTH: usize>(
        &mut self,
        adder: impl AddRows,
        pairs: &mut [Pair<'_>],
        group: usize,
    ) -> Option<()> {
        let rows = split_off_rows::<WIDTH>(&mut self.weights, self.rows)?;
        for part in 0..WIDTH / STRIP {
            let start = self.start();
            let strip = Strip { rows, part, start, relu: self.around.relu, first: self.column };
            for pairs in pairs.chunks_mut(group) {
                match pairs.len() {
                    1 => strip.add::<A, 1>(adder, pairs),
                    2 => strip.add::<A, 2>(adder, pairs),
                    3 => strip.add::<A, 3>(adder, pairs),
                    4 => strip.add::<A, 4>(adder, pairs),
                    5 => strip.add::<A, 5>(adder, pairs),
                    _ => strip.add::<A, GROUP>(adder, pairs),
                }
            }
            self.column += STRIP;
        }
        Some(())
    }

    /// Works on the next tile, which is eight columns wide: the last of a matrix, and small.
    #[inline(always)]
    fn add_narrow<A: Arithmetic>(&mut self, pairs: &mut [Pair<'_>]) -> Option<()> {
        let rows = split_off_rows::<8>(&mut self.weights, self.rows)?;
        for pair in pairs {
            let mut sums: [f32; 8] = self.start();
            for (input, row) in pair.inputs.iter().zip(rows) {
                add_row::<A, 8>(&mut sums, *input, row);
            }
            *pair.outputs.get_mut(self.column..)?.first_chunk_mut()? =
                finished(sums, self.around.relu);
        }
        self.column += 8;
        Some(())
    }

    /// Where the sums of the next columns start.
    #[inline(always)]
    fn start<const COLUMNS: usize>(&self) -> [f32; COLUMNS] {
        let bias = self.around.bias.and_then(|bias| bias.get(self.column..)?.first_chunk());
        bias.copied().unwrap_or([0.0; COLUMNS])
    }
}

/// Some neighbouring columns of a tile.
#[derive(Clone, Copy)]
struct Strip<'w, const WIDTH: usize> {
    rows: &'w [[f32; WIDTH]],
    /// Which strip of the tile it is.
    part: usize,
    start: [f32; STRIP],
    relu: bool,
    /// Its first column among the outputs.
    first: usize,
}

impl<const WIDTH: usize> Strip<'_, WIDTH> {
    #[inline(always)]
    fn add<A: Arithmetic, const COUNT: usize>(self, adder: impl AddRows, pairs: &mut [Pair<'_>]) {
        let Some(pairs) = pairs.first_chunk_mut::<COUNT>() else { return };
        let inputs = pairs.each_ref().map(|pair| pair.inputs.get(..self.rows.len()));
        let inputs = inputs.map(|inputs| inputs.unwrap_or(&[]));
        let sums = adder.add_rows::<A, WIDTH, COUNT>(self.rows, self.part, self.start, inputs);
        for (sums, pair) in sums.into_iter().zip(pairs) {
            let columns = pair.outputs.get_mut(self.first..);
            if let Some(columns) = columns.and_then(|columns| columns.first_chunk_mut()) {
                *columns = finished(sums, self.relu);
            }
        }
    }
}

/// [`AddRows`] as every processor of the target runs it.
#[inline(always)]
pub(super) fn add_rows<A: Arithmetic, const WIDTH: usize, const COUNT: usize>(
    rows: &[[f32; WIDTH]],
    part: usize,
    start: [f32; STRIP],
    inputs: [&[f32]; COUNT],
) -> [[f32; STRIP]; COUNT] {
    let mut sums = [start; COUNT];
    'rows: for (index, row) in rows.iter().enumerate() {
        let Some(row) = row.as_chunks::<STRIP>().0.get(part) else { break };
        for (sums, inputs) in sums.iter_mut().zip(inputs) {
            let Some(input) = inputs.get(index) else { break 'rows };
            add_row::<A, STRIP>(sums, *input, row);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Portable;
    use crate::kernels::arithmetic::Exact;
    use crate::kernels::product::product;
    use std::vec::Vec;

    #[test]
    fn several_vectors_give_the_bits_of_each_alone() {
        let number = |seed: usize| ((seed * 2_654_435_761) >> 7 & 0xffff) as f32 / 32_768.0 - 1.0;
        for (rows, columns) in [(5, 8), (9, 128), (33, 120), (7, 64), (128, 48)] {
            let weights: Vec<f32> = (0..rows * columns).map(number).collect();
            let bias: Vec<f32> = (0..columns).map(|index| number(index + 77)).collect();
            for count in 0..=15 {
                let inputs: Vec<f32> = (0..count * rows).map(|index| number(index + 5)).collect();
                for around in [Around::NOTHING, Around { bias: Some(&bias), relu: true }] {
                    let mut alone = std::vec![f32::NAN; count * columns];
                    let pairs = inputs.chunks(rows).zip(alone.chunks_mut(columns));
                    pairs.for_each(|(inputs, outputs)| {
                        product::<Exact>(&weights, inputs, around, outputs);
                    });
                    let mut together = std::vec![f32::NAN; count * columns];
                    let mut pairs: Vec<Pair<'_>> = inputs
                        .chunks(rows)
                        .zip(together.chunks_mut(columns))
                        .map(|(inputs, outputs)| Pair { inputs, outputs })
                        .collect();
                    products::<Exact>(Portable::<Exact>::new(), &weights, &mut pairs, around);
                    assert_eq!(alone, together, "{count} vectors, {rows} x {columns}");
                }
            }
        }
    }
}
