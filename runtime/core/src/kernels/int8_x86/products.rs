//! What both builds of the int8 kernels do alike: a row of weights, widened once, times pairs of inputs.

/// Products over vectors of sums. The build has `Sums` of a strip, `Weights` of a row, and the functions `zero`,
/// `widened`, `add_widened`, `add_sums` and `not_zero`.
macro_rules! products {
    ($features:literal) => {
        /// Adds a row of weights, times its pair of inputs.
        #[inline]
        #[target_feature(enable = $features)]
        fn add_row(sums: Sums, row: &Row, inputs: Pair) -> Sums {
            add_widened(sums, widened(row), transmute!(inputs))
        }

        /// [`crate::kernels::int8::Lanes::add_strip`] with `SETS` sums for every column, so that additions need not wait for each other.
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn add_strip<const COUNT: usize, const SETS: usize>(
            rows: &[[Row; PAIRS]],
            inputs: [&[Inputs]; COUNT],
        ) -> [[i32; STRIP]; COUNT] {
            let mut sums = [[zero(); SETS]; COUNT];
            for (index, rows) in rows.iter().enumerate() {
                for (sums, inputs) in sums.iter_mut().zip(inputs) {
                    // Inputs do not end before the rows; zeros that stand for them need no way out of the loop.
                    let inputs = inputs.get(index).unwrap_or(&[[0; 2]; PAIRS]);
                    let sets = rows.as_chunks::<SETS>().0.iter().zip(inputs.as_chunks::<SETS>().0);
                    for (rows, inputs) in sets {
                        for ((sum, row), pair) in sums.iter_mut().zip(rows).zip(inputs) {
                            *sum = add_row(*sum, row, *pair);
                        }
                    }
                }
            }
            // Closures would stay calls: what maps arrays is not built for these instructions.
            let mut joined = [[0; STRIP]; COUNT];
            for (joined, sums) in joined.iter_mut().zip(sums) {
                let mut total = zero();
                for set in sums {
                    total = add_sums(total, set);
                }
                *joined = transmute!(total);
            }
            joined
        }

        /// [`crate::kernels::int8::Lanes::add_runs`].
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn add_runs<const COUNT: usize>(
            rows: &[Row],
            runs: Runs<'_, i16>,
            at: [usize; COUNT],
        ) -> [[i32; STRIP]; COUNT] {
            let mut sums = [zero(); COUNT];
            // Checked once and not for each pair, which are as many as the products of a vector.
            if runs.are_inside(&at, rows.len(), 2) {
                let mut row = rows.as_ptr();
                for outer in 0..runs.counts[0] {
                    for inner in 0..runs.counts[1] {
                        let run = outer * runs.steps[0] + inner * runs.steps[1];
                        let run = runs.from.as_ptr().wrapping_add(run);
                        for pair in 0..runs.length.div_ceil(2) {
                            // SAFETY: there is a row for every pair of all runs.
                            #[allow(unsafe_code)]
                            let weights = widened(unsafe { &*row });
                            row = row.wrapping_add(1);
                            for (sum, at) in sums.iter_mut().zip(at) {
                                // SAFETY: every run lies inside the picture, its last pair whole.
                                #[allow(unsafe_code)]
                                let pair: i32 = unsafe {
                                    run.wrapping_add(at + 2 * pair).cast::<i32>().read_unaligned()
                                };
                                *sum = add_widened(*sum, weights, pair);
                            }
                        }
                    }
                }
            }
            let mut results = [[0; STRIP]; COUNT];
            for (result, sum) in results.iter_mut().zip(sums) {
                *result = transmute!(sum);
            }
            results
        }

        /// [`crate::kernels::int8::Lanes::add_marked`].
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn add_marked<const COUNT: usize>(
            lanes: impl Lanes,
            strips: Strips<'_>,
            inputs: Marked<'_>,
            outputs: &mut [f32],
        ) {
            let mut sums = [zero(); COUNT];
            strips.for_each::<COUNT>(
                inputs,
                |values| not_zero(values),
                |rows, pair| {
                    for (sum, row) in sums.iter_mut().zip(rows) {
                        *sum = add_row(*sum, row, pair);
                    }
                },
            );
            let mut joined = [[0; STRIP]; COUNT];
            for (joined, sum) in joined.iter_mut().zip(sums) {
                *joined = transmute!(sum);
            }
            strips.matrix.finish(lanes, strips.first, &joined, inputs.step, outputs);
        }
    };
}

pub(super) use products;
