//! The product of a matrix and inputs of which much is zero: eight vectors of sums stay in registers while the
//! inputs are looked through. (The compiler keeps them there for one tile only, and compares every index twice.)

/// Builds the kernel for an instruction set: its vectors, how to make them, and the tiles of 64 columns that eight
/// of them hold.
macro_rules! sparse_product {
    ($(#[$doc:meta])* $sums:ty, $spread:ident, $load:ident, $tiles:literal, $features:literal) => {
        use $crate::kernels::mark::MARKED;
        use $crate::kernels::product::TILE;

        $(#[$doc])*
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn sparse_product<A: Arithmetic>(
            weights: &[f32],
            inputs: $crate::kernels::product::Sparse<'_>,
            around: $crate::kernels::product::Around<'_>,
            outputs: &mut [f32],
        ) {
            const COLUMNS: usize = $tiles * TILE;
            let (mut weights, mut around, mut outputs) = (weights, around, outputs);
            while outputs.len() >= COLUMNS {
                let Some(tiles) = weights.split_off(..inputs.count.saturating_mul(COLUMNS)) else { return };
                let mut start = [0.0; COLUMNS];
                if let Some(bias) = &mut around.bias {
                    let Some(bias) = bias.split_off(..COLUMNS).and_then(|bias| bias.first_chunk()) else {
                        return;
                    };
                    start = *bias;
                }
                let Some(columns) = outputs.split_off_mut(..COLUMNS) else { return };
                let sums: [f32; COLUMNS] = transmute!(add_marked::<A>(tiles, &inputs, transmute!(start)));
                if let Some(columns) = columns.first_chunk_mut() {
                    *columns = $crate::kernels::product::finished(sums, around.relu);
                }
            }
            $crate::kernels::product::sparse_product::<A>(weights, inputs, around, outputs);
        }

        /// Adds the rows of marked inputs to the sums of tiles, which stand one behind the other.
        #[inline]
        #[target_feature(enable = $features)]
        #[allow(unsafe_code)]
        fn add_marked<A: Arithmetic>(
            tiles: &[f32],
            inputs: &$crate::kernels::product::Sparse<'_>,
            start: $sums,
        ) -> $sums {
            let mut sums = start;
            let (values, count) = (inputs.values, inputs.count);
            if values.len() > count || tiles.len() < count * $tiles * TILE {
                return sums;
            }
            // Checked here and not for each row: the loop is short beside its branches.
            let groups = (0..).step_by(MARKED).zip(values.chunks(MARKED));
            for ((first, group), [low, high]) in groups.zip(inputs.marks) {
                let existing = u64::MAX >> (MARKED - group.len());
                let mut marks = (u64::from(*low) | u64::from(*high) << 32) & existing;
                while marks != 0 {
                    let index: usize = first + marks.trailing_zeros() as usize;
                    marks &= marks - 1;
                    // SAFETY: the mark is of a value that exists, and there are at least as many rows.
                    unsafe { add_row::<A>(&mut sums, values.get_unchecked(index), tiles, index, count) };
                }
            }
            if let Some(index) = inputs.one.filter(|index| *index < count) {
                // SAFETY: there are `count` rows.
                unsafe { add_row::<A>(&mut sums, &1.0, tiles, index, count) };
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
        unsafe fn add_row<A: Arithmetic>(
            sums: &mut $sums,
            input: &f32,
            tiles: &[f32],
            index: usize,
            count: usize,
        ) {
            let input = $spread(*input);
            let of_tile = sums.len() / $tiles;
            for (place, sum) in sums.iter_mut().enumerate() {
                let column = place % of_tile * (TILE / of_tile);
                let start = place / of_tile * count * TILE + index * TILE + column;
                // SAFETY: inside row `index` of the vector's tile.
                let weights = unsafe { $load(tiles.as_ptr().add(start)) };
                *sum = multiply_add::<A>(*sum, input, weights);
            }
        }
    };
}

pub(super) use sparse_product;
