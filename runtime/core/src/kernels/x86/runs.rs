//! Sums of patches: the loop that convolutions are made of, in vectors of either width.

/// Defines `add_runs` for vectors of a width, so many of which make a part.
macro_rules! add_runs {
    ($(#[$doc:meta])* $vector:ident, $vectors:expr, $one:ident, $features:literal) => {
        $(#[$doc])*
        #[inline]
        #[target_feature(enable = $features)]
        pub(super) fn add_runs<A: Arithmetic, const COUNT: usize>(
            tile: &[[f32; PART]],
            runs: Runs<'_, f32>,
            at: [usize; COUNT],
            start: [f32; PART],
        ) -> [[f32; PART]; COUNT] {
            let first: [$vector; $vectors] = transmute!(start);
            let mut sums = [first; COUNT];
            // Checked once and not for each number, which are as many as the multiply-adds of a vector.
            if runs.are_inside(&at, tile.len(), 1) {
                let mut row = tile.as_ptr();
                for outer in 0..runs.counts[0] {
                    for inner in 0..runs.counts[1] {
                        let run = outer * runs.steps[0] + inner * runs.steps[1];
                        let run = runs.from.as_ptr().wrapping_add(run);
                        for index in 0..runs.length {
                            // SAFETY: the tile has a row for every number of all runs.
                            #[allow(unsafe_code)]
                            let weights: [$vector; $vectors] = transmute!(unsafe { *row });
                            row = row.wrapping_add(1);
                            for (sums, at) in sums.iter_mut().zip(at) {
                                // SAFETY: every run lies inside the picture.
                                #[allow(unsafe_code)]
                                let number = $one(unsafe { *run.wrapping_add(at + index) });
                                for (sum, weights) in sums.iter_mut().zip(weights) {
                                    *sum = multiply_add::<A>(*sum, number, weights);
                                }
                            }
                        }
                    }
                }
            }
            let mut results = [start; COUNT];
            for (result, sums) in results.iter_mut().zip(sums) {
                *result = transmute!(sums);
            }
            results
        }
    };
}

pub(super) use add_runs;
