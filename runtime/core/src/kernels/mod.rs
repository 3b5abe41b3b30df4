//! Arithmetic on plain slices in a fixed order, so that every target computes the same bits.
//!
//! The contract: products of a matrix and a vector add one input after the other to all outputs; dot products
//! run in 16 lanes that a fixed tree joins. Inputs that are exactly zero may be left out: they add ±0 to sums
//! that are never -0. What a multiply-add rounds is the profile's ([`arithmetic`]).
//!
//! The code is safe Rust over chunks of fixed size, which the compiler turns into vector instructions. It is
//! built once for every target, and on x86-64 for AVX2 and AVX-512 as well: [`Kernels`] is what a build offers,
//! [`build`] chooses one.

pub mod arithmetic;
pub mod build;
pub mod dot;
pub mod int8;
#[cfg(all(feature = "std", target_arch = "x86_64"))]
mod int8_x86;
pub mod mark;
pub mod patches;
pub(crate) mod pause;
pub mod product;
pub mod rows;
pub mod several;
#[cfg(any(test, all(target_os = "none", any(target_arch = "arm", target_arch = "riscv32"))))]
mod small;
pub mod softmax;
#[cfg(test)]
mod tests;
mod work;
#[cfg(all(feature = "std", target_arch = "x86_64"))]
mod x86;

use core::marker::PhantomData;

// What every processor of the target runs: microcontrollers have neither vectors nor flash to waste.
#[cfg(not(all(target_os = "none", any(target_arch = "arm", target_arch = "riscv32"))))]
use Portable as OfTarget;
#[cfg(all(target_os = "none", any(target_arch = "arm", target_arch = "riscv32")))]
use small::Small as OfTarget;

use arithmetic::Arithmetic;
use int8::Int8Kernels;
use mark::Marks;
use patches::{AddRuns, FloatTiles, Fold, PatchLayer, Runs};
use product::{Around, Sparse};
use rows::Rows;
use several::{AddRows, PART, Pair, Strip};
use softmax::Scores;

/// Heads that are attended to together where a build can.
pub const HEADS: usize = 4;

/// What the width of rows is a multiple of that are attended to together.
pub const ATTENDED_WIDTH: usize = 32;

/// A vector of one head: two tiles, or what is not used behind fewer columns.
pub type Head = [f32; 2 * product::TILE];

/// Heads that attend to the same rows. All are as wide, a multiple of [`ATTENDED_WIDTH`].
#[derive(Debug)]
pub struct Heads<'a> {
    /// The heads' vectors.
    pub heads: [&'a mut [f32]; HEADS],
    /// What the vectors are multiplied with.
    pub keys: Rows<'a>,
    /// What is mixed by the weights that come of it, as many.
    pub values: Rows<'a>,
}

/// The kernels of one build and one profile.
pub trait Kernels: Copy + Int8Kernels {
    /// Marks the values that are not zero, and returns whether all are finite ([`mark::mark`]).
    fn mark(self, values: &[f32], marks: &mut [Marks]) -> bool;

    /// Matrix times vector ([`product::product`]).
    fn product(self, weights: &[f32], inputs: &[f32], around: Around<'_>, outputs: &mut [f32]);

    /// Matrix times a vector of which much is zero ([`product::sparse_product`]).
    fn sparse_product(
        self,
        weights: &[f32],
        inputs: Sparse<'_>,
        around: Around<'_>,
        outputs: &mut [f32],
    );

    /// Matrix times several vectors ([`several::products`]).
    fn products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>);

    /// Matrix times several vectors of which much is zero ([`several::sparse_products`]).
    fn sparse_products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>);

    /// Vectors times a matrix that stands row after row ([`several::multiply`]).
    fn multiply(self, vectors: &[f32], matrix: &[f32], sizes: [usize; 2], products: &mut [f32]) {
        several::multiply_plainly(vectors, matrix, sizes, products);
    }

    /// A layer on the patches of a picture.
    fn convolve(self, layer: &PatchLayer<'_>, from: &[f32], to: &mut [f32]);

    /// One number of every channel of patches; a run is a number for every channel.
    fn fold(self, layer: &PatchLayer<'_>, by: Fold, from: &[f32], to: &mut [f32]);

    /// Dot products of one vector with rows ([`dot::dots`]).
    fn dots(self, vector: &[f32], rows: Rows<'_>, products: &mut [f32]);

    /// Scores become weights ([`softmax::softmax`]).
    fn softmax(self, scores: &mut [f32], count: usize) -> bool;

    /// As [`Self::softmax`] for several queries.
    fn softmaxes(self, several: &mut [Scores<'_>]) {
        for one in several {
            one.finite = self.softmax(one.scores, one.count);
        }
    }

    /// The weighted sum of rows ([`product::mix`]).
    fn mix(self, weights: &[f32], rows: Rows<'_>, sums: &mut [f32]);

    /// Most rows that [`Self::attend`] takes; none where heads are attended to one by one.
    const ATTENDED: usize = 0;

    /// What `dots`, `softmax` and `mix` do, for several heads: each becomes what it attends to. Returns false where a
    /// score is not finite. Weights that are needed `soon` may come near meanwhile.
    fn attend(self, _groups: &mut [Heads<'_>], _soon: &[f32]) -> bool {
        false
    }
}

/// The kernels as every processor of the target runs them.
#[derive(Debug)]
pub struct Portable<A>(PhantomData<A>);

impl<A> Portable<A> {
    /// The kernels.
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<A> Default for Portable<A> {
    fn default() -> Self {
        Self::new()
    }
}

impl<A> Clone for Portable<A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A> Copy for Portable<A> {}

impl<A: Arithmetic> Kernels for Portable<A> {
    fn mark(self, values: &[f32], marks: &mut [Marks]) -> bool {
        mark::mark(values, marks)
    }

    fn product(self, weights: &[f32], inputs: &[f32], around: Around<'_>, outputs: &mut [f32]) {
        product::product::<A>(weights, inputs, around, outputs);
    }

    fn sparse_product(
        self,
        weights: &[f32],
        inputs: Sparse<'_>,
        around: Around<'_>,
        outputs: &mut [f32],
    ) {
        product::sparse_product::<A>(weights, inputs, around, outputs);
    }

    fn products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
        several::products::<A, Self>(self, weights, pairs, around);
    }

    fn sparse_products(self, weights: &[f32], pairs: &mut [Pair<'_>], around: Around<'_>) {
        several::sparse_products::<A>(weights, pairs, around, 0);
    }

    fn multiply(self, vectors: &[f32], matrix: &[f32], sizes: [usize; 2], products: &mut [f32]) {
        several::multiply(self, vectors, matrix, sizes, products);
    }

    fn convolve(self, layer: &PatchLayer<'_>, from: &[f32], to: &mut [f32]) {
        let tiles = FloatTiles::<A, Self>::of(self, layer, from);
        patches::convolve::<4, 1>(&tiles, (layer.patches, layer.outputs), to);
    }

    fn fold(self, layer: &PatchLayer<'_>, by: Fold, from: &[f32], to: &mut [f32]) {
        patches::fold::<A>(layer, by, from, to);
    }

    fn dots(self, vector: &[f32], rows: Rows<'_>, products: &mut [f32]) {
        dot::dots(vector, rows, products, dot::four_dots::<A>);
    }

    fn softmax(self, scores: &mut [f32], count: usize) -> bool {
        softmax::softmax(scores, count, softmax::largest)
    }

    fn mix(self, weights: &[f32], rows: Rows<'_>, sums: &mut [f32]) {
        product::mix::<A>(weights, rows, sums);
    }
}

impl<P> AddRows for Portable<P> {
    const GROUP: usize = 6;

    #[inline(always)]
    fn parts<B: Arithmetic>(self, _: usize) -> usize {
        1
    }

    #[inline(always)]
    fn add_rows<A: Arithmetic, const PARTS: usize, const COUNT: usize>(
        self,
        strip: Strip<'_>,
        start: [[f32; PART]; PARTS],
        inputs: [&[f32]; COUNT],
    ) -> [[[f32; PART]; PARTS]; COUNT] {
        several::add_rows::<A, PARTS, COUNT>(strip, start, inputs)
    }
}

impl<P> AddRuns for Portable<P> {
    #[inline(always)]
    fn add_runs<A: Arithmetic, const COUNT: usize>(
        self,
        tile: &[[f32; PART]],
        runs: Runs<'_, f32>,
        at: [usize; COUNT],
        start: [f32; PART],
    ) -> [[f32; PART]; COUNT] {
        patches::add_runs::<A, COUNT>(tile, runs, at, start)
    }
}
