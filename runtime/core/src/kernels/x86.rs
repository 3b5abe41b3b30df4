//! The kernels for AVX2 and AVX-512.
//!
//! Both are the portable code, compiled once more. Only what the compiler does not find by itself is written with
//! intrinsics, in [`wide`], [`wider`] and [`heads`].

mod heads;
mod runs;
mod sparse;
mod wide;
mod wider;

use core::marker::PhantomData;

use super::arithmetic::Arithmetic;
use super::dot;
use super::mark::Marks;
use super::patches::{self, AddRuns, FloatTiles, Fold, PatchLayer, Runs};
use super::product::{self, Around, Sparse};
use super::rows::Rows;
use super::several::{self, AddRows, PART, Pair, Strip};
use super::softmax::{self, Scores};
use super::work::Work;
use super::{Heads, Kernels};

/// The time, in ticks of the processor's clock: read in a few nanoseconds.
#[inline]
pub(super) fn ticks() -> u64 {
    // SAFETY: every processor of this kind has the instruction.
    #[allow(unsafe_code)]
    unsafe {
        core::arch::x86_64::_rdtsc()
    }
}

/// The rows of a strip, each with its inputs.
struct StripRows<'w, const PARTS: usize, const COUNT: usize> {
    strip: Strip<'w>,
    inputs: [&'w [f32]; COUNT],
    row: usize,
    rows: usize,
}

impl<'w, const PARTS: usize, const COUNT: usize> StripRows<'w, PARTS, COUNT> {
    /// All rows; none where strip or inputs are too short for them.
    #[inline(always)]
    fn new(strip: Strip<'w>, inputs: [&'w [f32]; COUNT]) -> Self {
        let inside = strip.first + PARTS * PART <= strip.width;
        let rows = strip.tile.len().checked_div(strip.width).unwrap_or(0);
        let enough = inside && inputs.iter().all(|inputs| inputs.len() >= rows);
        Self { strip, inputs, row: 0, rows: if enough { rows } else { 0 } }
    }
}

impl<'w, const PARTS: usize, const COUNT: usize> Iterator for StripRows<'w, PARTS, COUNT> {
    type Item = (&'w [[f32; PART]; PARTS], [&'w f32; COUNT]);

    // Checked once in `new` and not for each row and input, which are half as many as the multiply-adds.
    #[inline(always)]
    #[allow(unsafe_code)]
    fn next(&mut self) -> Option<Self::Item> {
        let row = self.row;
        if row == self.rows {
            return None;
        }
        self.row += 1;
        let first = row * self.strip.width + self.strip.first;
        // SAFETY: the strip lies inside the tile's width, and as many rows of that width inside the tile; arrays of
        // floats are aligned as floats are.
        let weights = unsafe { &*self.strip.tile.as_ptr().add(first).cast() };
        // By reference, because numbers are spread over a vector for nothing when they are loaded into it.
        let mut values = [&0.0; COUNT];
        for (value, inputs) in values.iter_mut().zip(&self.inputs) {
            // SAFETY: there are at least as many inputs as rows.
            *value = unsafe { inputs.get_unchecked(row) };
        }
        Some((weights, values))
    }
}

/// Builds all kernels for an instruction set.
macro_rules! build {
    ($(#[$doc:meta])* $name:ident, $module:ident, $vectors:ident, $features:literal $(, $heads:ident)?) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub(super) struct $name<A>(PhantomData<A>);

        impl<A> $name<A> {
            /// # Safety
            /// The processor has all features of the build.
            #[allow(unsafe_code)]
            pub(super) const unsafe fn new() -> Self {
                Self(PhantomData)
            }

            /// Runs work that is compiled for these kernels as far as it is inlined.
            #[target_feature(enable = $features)]
            pub(super) fn run<W: Work>(work: W) -> W::Output
            where
                A: Arithmetic,
            {
                // SAFETY: only where the processor has the features is this function called.
                #[allow(unsafe_code)]
                work.run(unsafe { Self::new() })
            }
        }

        impl<A> Clone for $name<A> {
            fn clone(&self) -> Self {
                *self
            }
        }

        impl<A> Copy for $name<A> {}

        // SAFETY (all calls): a value of this type exists only where the processor has the features, which is
        // the one obligation of calling a function that is built with them.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<A: Arithmetic> Kernels for $name<A> {
            #[inline]
            fn mark(self, values: &[f32], marks: &mut [Marks]) -> bool {
                unsafe { $module::mark(values, marks) }
            }

            #[inline]
            fn product(
                self,
                weights: &[f32],
                inputs: &[f32],
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                unsafe { $module::product::<A>(weights, inputs, around, outputs) }
            }

            #[inline]
            fn sparse_product(
                self,
                weights: &[f32],
                inputs: Sparse<'_>,
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                unsafe { $module::sparse_product::<A>(weights, inputs, around, outputs) }
            }

            #[inline]
            fn products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
                unsafe { $module::products::<A>(self, weights, pairs, around) }
            }

            #[inline]
            fn sparse_products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
                unsafe { $module::sparse_products::<A>(weights, pairs, around) }
            }

            #[inline]
            fn multiply(self, vectors: &[f32], matrix: &[f32], sizes: [usize; 2], products: &mut [f32]) {
                unsafe { $module::multiply::<A>(self, vectors, matrix, sizes, products) }
            }

            #[inline]
            fn convolve(self, layer: &PatchLayer<'_>, from: &[f32], to: &mut [f32]) {
                unsafe { $module::convolve::<A>(self, layer, from, to) }
            }

            #[inline]
            fn fold(self, layer: &PatchLayer<'_>, by: Fold, from: &[f32], to: &mut [f32]) {
                unsafe { $module::fold::<A>(layer, by, from, to) }
            }

            #[inline]
            fn dots(self, vector: &[f32], rows: Rows<'_>, products: &mut [f32]) {
                unsafe { $module::dots::<A>(vector, rows, products) }
            }

            #[inline]
            fn softmax(self, scores: &mut [f32], count: usize) -> bool {
                unsafe { $module::softmax(scores, count) }
            }

            #[inline]
            fn mix(self, weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
                unsafe { $module::mix::<A>(weights, rows, sums) }
            }

            $(
            const ATTENDED: usize = $heads::ATTENDED;

            #[inline]
            fn attend(self, groups: &mut [Heads<'_>], soon: &[f32]) -> bool {
                unsafe { $heads::attend::<A>(groups, soon) }
            }

            #[inline]
            fn softmaxes(self, several: &mut [Scores<'_>]) {
                unsafe { $heads::softmaxes(several) }
            }
            )?
        }

        // SAFETY: as above.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<P> AddRows for $name<P> {
            const GROUP: usize = $vectors::GROUP;

            #[inline(always)]
            fn parts<A: Arithmetic>(self, count: usize) -> usize {
                $vectors::parts(count, A::FUSED)
            }

            #[inline(always)]
            fn add_rows<A: Arithmetic, const PARTS: usize, const COUNT: usize>(
                self,
                strip: Strip<'_>,
                start: [[f32; PART]; PARTS],
                inputs: [&[f32]; COUNT],
            ) -> [[[f32; PART]; PARTS]; COUNT] {
                unsafe { $vectors::add_rows::<A, PARTS, COUNT>(strip, start, inputs) }
            }
        }

        // SAFETY: as above.
        #[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
        impl<P> AddRuns for $name<P> {
            #[inline(always)]
            fn add_runs<A: Arithmetic, const COUNT: usize>(
                self,
                tile: &[[f32; PART]],
                runs: Runs<'_, f32>,
                at: [usize; COUNT],
                start: [f32; PART],
            ) -> [[f32; PART]; COUNT] {
                unsafe { $vectors::add_runs::<A, COUNT>(tile, runs, at, start) }
            }
        }

        mod $module {
            use super::*;

            #[target_feature(enable = $features)]
            pub(super) fn mark(values: &[f32], marks: &mut [Marks]) -> bool {
                $vectors::mark(values, marks)
            }

            #[target_feature(enable = $features)]
            pub(super) fn product<A: Arithmetic>(
                weights: &[f32],
                inputs: &[f32],
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                product::product::<A>(weights, inputs, around, outputs);
            }

            #[target_feature(enable = $features)]
            pub(super) fn sparse_product<A: Arithmetic>(
                weights: &[f32],
                inputs: Sparse<'_>,
                around: Around<'_>,
                outputs: &mut [f32],
            ) {
                $vectors::sparse_product::<A>(weights, inputs, around, outputs);
            }

            #[target_feature(enable = $features)]
            pub(super) fn products<A: Arithmetic>(
                kernels: $name<A>,
                weights: &[f32],
                pairs: &mut [Pair<'_>],
                around: Around<'_>,
            ) {
                several::products::<A, $name<A>>(kernels, weights, pairs, around);
            }

            #[target_feature(enable = $features)]
            pub(super) fn sparse_products<A: Arithmetic>(
                weights: &[f32],
                pairs: &mut [Pair<'_>],
                around: Around<'_>,
            ) {
                $vectors::sparse_products::<A>(weights, pairs, around);
            }

            #[target_feature(enable = $features)]
            pub(super) fn multiply<A>(
                kernels: $name<A>,
                vectors: &[f32],
                matrix: &[f32],
                sizes: [usize; 2],
                products: &mut [f32],
            ) {
                several::multiply(kernels, vectors, matrix, sizes, products);
            }

            #[target_feature(enable = $features)]
            pub(super) fn convolve<A: Arithmetic>(
                kernels: $name<A>,
                layer: &PatchLayer<'_>,
                from: &[f32],
                to: &mut [f32],
            ) {
                const MANY: usize = $vectors::PATCHES;
                let tiles = FloatTiles::<A, $name<A>>::of(kernels, layer, from);
                let sizes = (layer.patches, layer.outputs);
                patches::convolve::<MANY, { MANY / 2 }>(&tiles, sizes, to);
            }

            #[target_feature(enable = $features)]
            pub(super) fn fold<A: Arithmetic>(
                layer: &PatchLayer<'_>,
                by: Fold,
                from: &[f32],
                to: &mut [f32],
            ) {
                patches::fold::<A>(layer, by, from, to);
            }

            #[target_feature(enable = $features)]
            pub(super) fn dots<A: Arithmetic>(vector: &[f32], rows: Rows<'_>, products: &mut [f32]) {
                dot::dots(vector, rows, products, |vector, rows| $vectors::four_dots::<A>(vector, rows));
            }

            #[target_feature(enable = $features)]
            pub(super) fn softmax(scores: &mut [f32], count: usize) -> bool {
                softmax::softmax(scores, count, |lanes| $vectors::largest(lanes))
            }

            #[target_feature(enable = $features)]
            pub(super) fn mix<A: Arithmetic>(weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
                product::mix::<A>(weights, rows, sums);
            }
        }
    };
}

build! {
    /// The kernels for processors with AVX2 and fused multiply-add.
    Avx2, avx2, wide, "avx2,fma,bmi1,bmi2,lzcnt,popcnt"
}

build! {
    /// The kernels for processors that also have AVX-512 and its instruction for integer networks.
    Avx512, avx512, wider,
    "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vnni",
    heads
}
