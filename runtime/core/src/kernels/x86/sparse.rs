//! The product of a matrix and inputs of which much is zero: eight vectors of sums stay in registers while the
//! inputs are looked through. (The compiler keeps them there for one tile only, and compares every index twice.)

/// What is still to be worked on of a product.
pub(super) struct Rest<'w, 'o> {
    pub(super) weights: &'w [f32],
    // Not the whole `Around`: its flag, just written, would have to be waited for when it is copied in one piece.
    pub(super) bias: Option<&'w [f32]>,
    pub(super) outputs: &'o mut [f32],
    pub(super) rows: usize,
}

/// Weights of some columns, where their sums start, and where they go.
type Columns<'w, 'o, const COLUMNS: usize> =
    (&'w [f32], &'w [f32; COLUMNS], &'o mut [f32; COLUMNS]);

impl<'w, 'o> Rest<'w, 'o> {
    /// The next tiles of 64 columns, if so many are left.
    #[inline(always)]
    pub(super) fn take<const COLUMNS: usize>(&mut self) -> Option<Columns<'w, 'o, COLUMNS>> {
        let columns = self.outputs.split_off_mut(..COLUMNS)?.first_chunk_mut()?;
        let tiles = self.weights.split_off(..self.rows.saturating_mul(COLUMNS))?;
        let start = match &mut self.bias {
            Some(bias) => bias.split_off(..COLUMNS)?.first_chunk()?,
            None => &[0.0; COLUMNS],
        };
        Some((tiles, start, columns))
    }
}

/// Builds the kernel for an instruction set: its vectors, how to make them, the tiles of 64 columns that eight
/// of them hold, and whether registers hold the sums of two vectors.
macro_rules! sparse_product {
    (
        $(#[$doc:meta])* $vector:ty, $spread:ident, $load:ident, $tiles:literal, $two:literal, $features:literal
    ) => {
        use core::arch::x86_64::_bzhi_u64;

        use $crate::kernels::mark::MARKED;
        use $crate::kernels::product::{self, Around, Sparse, TILE, finished};
        use $crate::kernels::several::{self, Pair};

        use super::sparse::{Rest, are_alike};

        /// Vectors whose inputs are marked before any of them is worked on.
        const MARKED_AHEAD: usize = 64;

        /// Vectors that a tile is wide.
        const TILE_VECTORS: usize = TILE * size_of::<f32>() / size_of::<$vector>();

        $(#[$doc])*
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn sparse_product<A: Arithmetic>(
            weights: &[f32],
            inputs: Sparse<'_>,
            around: Around<'_>,
            outputs: &mut [f32],
        ) {
            let mut rest = Rest { weights, bias: around.bias, outputs, rows: inputs.count };
            if $tiles > 1 {
                while let Some((tiles, start, columns)) = rest.take::<{ $tiles * TILE }>() {
                    let sums = add_marked::<A, { $tiles * TILE_VECTORS }>(tiles, &inputs, transmute!(*start));
                    let sums: [f32; $tiles * TILE] = transmute!(sums);
                    *columns = finished(sums, around.relu);
                }
            }
            while let Some((tile, start, columns)) = rest.take::<TILE>() {
                let sums = add_marked::<A, TILE_VECTORS>(tile, &inputs, transmute!(*start));
                let sums: [f32; TILE] = transmute!(sums);
                *columns = finished(sums, around.relu);
            }
            let around = Around { bias: rest.bias, relu: around.relu };
            product::sparse_product::<A>(rest.weights, inputs, around, rest.outputs);
        }

        /// See [`crate::kernels::several::sparse_products`]. Inputs are worked on 64 at a time, for all vectors before
        /// the next: their rows of two tiles fill the first cache, and their marks a word.
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn sparse_products<A: Arithmetic>(
            weights: &[f32],
            pairs: &mut [Pair<'_>],
            around: Around<'_>,
        ) {
            const COLUMNS: usize = $tiles * TILE;
            let Some(Pair { inputs, outputs }) = pairs.first() else { return };
            let (rows, columns) = (inputs.len(), outputs.len());
            let (mut weights, mut column) = (weights, 0);
            while rows > 0 && columns - column >= COLUMNS {
                let Some(tiles) = weights.split_off(..rows.saturating_mul(COLUMNS)) else { return };
                for first in (0..rows).step_by(MARKED) {
                    for pairs in pairs.chunks_mut(MARKED_AHEAD) {
                        // Ahead, so that no vector waits for its own marks.
                        let mut marks = [0; MARKED_AHEAD];
                        for (marks, pair) in marks.iter_mut().zip(pairs.iter()) {
                            *marks = mark_some(pair.inputs, first);
                        }
                        let place = [rows, first, column];
                        let mut marked = pairs.iter_mut().zip(marks).peekable();
                        while let Some((pair, marks)) = marked.next() {
                            // Where additions run beside multiplications, loads are not what takes the time.
                            let two = A::FUSED && $two;
                            match marked.next_if(|(_, other)| two && are_alike(marks, *other)) {
                                Some((other, others)) => {
                                    add_some::<A, 2>(tiles, place, [pair, other], marks | others, around);
                                }
                                None => add_some::<A, 1>(tiles, place, [pair], marks, around),
                            }
                        }
                    }
                }
                column += COLUMNS;
            }
            several::sparse_products::<A>(weights, pairs, around, column);
        }

        /// Marks at most 64 inputs of one vector, from the first on, which are not zero.
        #[inline]
        #[target_feature(enable = $features)]
        fn mark_some(inputs: &[f32], first: usize) -> u64 {
            let inputs = inputs.get(first..).unwrap_or(&[]);
            if let Some(inputs) = inputs.first_chunk() {
                return not_zero(inputs);
            }
            let mut marks = [[0; 2]];
            mark(inputs, &mut marks);
            let [[low, high]] = marks;
            u64::from(low) | u64::from(high) << 32
        }

        /// Adds the rows of at most 64 inputs of some vectors, from the first on. Where one of the vectors has a zero
        /// that is marked for another, its sums stay as they are.
        #[inline]
        #[target_feature(enable = $features)]
        #[allow(unsafe_code)]
        fn add_some<A: Arithmetic, const COUNT: usize>(
            tiles: &[f32],
            [rows, first, column]: [usize; 3],
            pairs: [&mut Pair<'_>; COUNT],
            marks: u64,
            around: Around<'_>,
        ) {
            const COLUMNS: usize = $tiles * TILE;
            let bias = around.bias.and_then(|bias| bias.get(column..)?.first_chunk::<COLUMNS>());
            let mut sums = [transmute!(*bias.unwrap_or(&[0.0; COLUMNS])); COUNT];
            let mut inputs = [&[][..]; COUNT];
            let mut marked = MARKED;
            for ((pair, inputs), sums) in pairs.iter().zip(&mut inputs).zip(&mut sums) {
                let outputs = pair.outputs.get(column..).and_then(|outputs| outputs.first_chunk::<COLUMNS>());
                if let Some(outputs) = outputs.filter(|_| first > 0) {
                    *sums = transmute!(*outputs);
                }
                *inputs = pair.inputs.get(first..).unwrap_or(&[]);
                marked = marked.min(inputs.len());
            }
            if tiles.len() < rows * COLUMNS || first + marked > rows {
                return;
            }
            let mut marks = _bzhi_u64(marks, marked as u32);
            while marks != 0 {
                let index = marks.trailing_zeros() as usize;
                marks &= marks - 1;
                // The compiler loads the row once for all vectors.
                for (sums, inputs) in sums.iter_mut().zip(inputs) {
                    // SAFETY: only inputs that exist are marked, and each has its row: checked above.
                    unsafe { add_row::<A, { $tiles * TILE_VECTORS }>(sums, inputs.get_unchecked(index), tiles, first + index, rows) };
                }
            }
            for (pair, sums) in pairs.into_iter().zip(sums) {
                let outputs = pair.outputs.get_mut(column..).and_then(|outputs| outputs.first_chunk_mut());
                if let Some(outputs) = outputs {
                    let sums: [f32; COLUMNS] = transmute!(sums);
                    *outputs = finished(sums, around.relu && first + marked == rows);
                }
            }
        }

        /// Adds the rows of marked inputs to the sums of tiles, which stand one behind the other.
        #[inline]
        #[target_feature(enable = $features)]
        #[allow(unsafe_code)]
        fn add_marked<A: Arithmetic, const SUMS: usize>(
            tiles: &[f32],
            inputs: &Sparse<'_>,
            start: [$vector; SUMS],
        ) -> [$vector; SUMS] {
            let mut sums = start;
            let (values, count) = (inputs.values, inputs.count);
            if values.len() > count || tiles.len() < count * TILE * SUMS / TILE_VECTORS {
                return sums;
            }
            // Checked here and not for each row: the loop is short beside its branches.
            let mut first = 0;
            for [low, high] in inputs.marks {
                let Some(left) = values.len().checked_sub(first) else { break };
                let mut marks = _bzhi_u64(u64::from(*low) | u64::from(*high) << 32, left.min(MARKED) as u32);
                while marks != 0 {
                    let index: usize = first + marks.trailing_zeros() as usize;
                    marks &= marks - 1;
                    // SAFETY: the mark is of a value that exists, and there are at least as many rows.
                    unsafe { add_row::<A, SUMS>(&mut sums, values.get_unchecked(index), tiles, index, count) };
                }
                first += MARKED;
            }
            if let Some(index) = inputs.one.filter(|index| *index < count) {
                // SAFETY: there are `count` rows.
                unsafe { add_row::<A, SUMS>(&mut sums, &1.0, tiles, index, count) };
            }
            sums
        }

        /// Adds one row of every tile, times an input.
        ///
        /// # Safety
        /// Each tile has `count` rows, and `index` is less.
        #[inline]
        #[target_feature(enable = $features)]
        #[allow(unsafe_code)]
        unsafe fn add_row<A: Arithmetic, const SUMS: usize>(
            sums: &mut [$vector; SUMS],
            input: &f32,
            tiles: &[f32],
            index: usize,
            count: usize,
        ) {
            let input = $spread(*input);
            for (place, sum) in sums.iter_mut().enumerate() {
                let column = place % TILE_VECTORS * (TILE / TILE_VECTORS);
                let start = place / TILE_VECTORS * count * TILE + index * TILE + column;
                // SAFETY: inside row `index` of the vector's tile.
                let weights = unsafe { $load(tiles.as_ptr().add(start)) };
                *sum = multiply_add::<A>(*sum, input, weights);
            }
        }
    };
}

/// Whether two vectors have so many zeros in the same places that they are worked on together: that loads weights once
/// for both, but leaves out no zero that is not in both.
#[inline(always)]
pub(super) fn are_alike(marks: u64, other: u64) -> bool {
    let (either, each) = ((marks | other).count_ones(), marks.count_ones() + other.count_ones());
    // Alone, an input takes a third longer (measured).
    either * 100 <= each * 65
}

pub(super) use sparse_product;
