//! Every build gives the same bits, and what works on much at once gives those of one after the other.

use std::vec;
use std::vec::Vec;

use super::arithmetic::{Arithmetic, Exact, Fused};
use super::build::{Build, Work};
use super::product::Around;
use super::rows::Rows;
use super::several::Pair;
use super::softmax::{Scores, slots};
use super::{ATTENDED_WIDTH, HEADS, Heads, Kernels};

/// Any numbers of both signs.
fn numbers(count: usize, seed: usize) -> Vec<f32> {
    let number = |index: usize| ((index + seed) * 2_654_435_761) >> 7 & 0xffff;
    (0..count).map(|index| number(index) as f32 / 32_768.0 - 1.0).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Products of vectors of which half is zero.
struct SparseProducts {
    inputs: usize,
    outputs: usize,
    count: usize,
}

impl Work for SparseProducts {
    type Output = [Vec<u32>; 2];

    fn run(self, kernels: impl Kernels) -> Self::Output {
        let Self { inputs, outputs, count } = self;
        let weights = numbers(inputs * outputs, 1);
        let bias = numbers(outputs, 2);
        let vectors: Vec<f32> = numbers(inputs * count, 3).iter().map(|v| v.max(0.0)).collect();
        let around = Around { bias: Some(&bias), relu: count.is_multiple_of(2) };
        let mut alone = vec![f32::NAN; outputs * count];
        for (vector, products) in vectors.chunks(inputs).zip(alone.chunks_mut(outputs)) {
            kernels.product(&weights, vector, around, products);
        }
        let mut together = vec![f32::NAN; outputs * count];
        let pairs = vectors.chunks(inputs).zip(together.chunks_mut(outputs));
        let mut pairs: Vec<_> = pairs.map(|(inputs, outputs)| Pair { inputs, outputs }).collect();
        kernels.sparse_products(&weights, &mut pairs, around);
        [bits(&alone), bits(&together)]
    }
}

#[test]
fn zeros_are_left_out_of_several_vectors() {
    for (inputs, outputs, count) in
        [(1, 8, 1), (63, 64, 2), (64, 128, 70), (65, 120, 3), (128, 128, 5), (200, 256, 4)]
    {
        let work = || SparseProducts { inputs, outputs, count };
        let [want, _] = Build::PORTABLE.run::<Exact, _>(work());
        for build in Build::all() {
            let [alone, together] = build.run::<Exact, _>(work());
            assert_eq!((&alone, &together), (&want, &want), "{build:?}, {inputs} x {outputs}");
        }
        for build in Build::all().filter(|build| build.fuses()) {
            let [alone, together] = build.run::<Fused, _>(work());
            assert_eq!(alone, together, "{build:?}, fused, {inputs} x {outputs}");
        }
    }
}

/// Vectors times a matrix that stands row after row.
struct Multiplied {
    inputs: usize,
    outputs: usize,
    count: usize,
}

impl Work for Multiplied {
    type Output = Vec<u32>;

    fn run(self, kernels: impl Kernels) -> Self::Output {
        let Self { inputs, outputs, count } = self;
        let (matrix, vectors) = (numbers(inputs * outputs, 7), numbers(inputs * count, 8));
        let mut products = vec![f32::NAN; outputs * count];
        kernels.multiply(&vectors, &matrix, [inputs, outputs], &mut products);
        bits(&products)
    }
}

#[test]
fn plain_matrices_are_multiplied_in_order_and_never_fused() {
    for (inputs, outputs, count) in [(1, 1, 1), (5, 15, 3), (16, 49, 7), (49, 16, 8), (3, 40, 13)] {
        let work = || Multiplied { inputs, outputs, count };
        let (matrix, vectors) = (numbers(inputs * outputs, 7), numbers(inputs * count, 8));
        let sum = |vector: &[f32], column: usize| {
            let weights = matrix[column..].iter().step_by(outputs);
            vector.iter().zip(weights).fold(0.0, |sum, (input, weight)| sum + input * weight)
        };
        let rows = vectors.chunks(inputs);
        let want: Vec<f32> =
            rows.flat_map(|row| (0..outputs).map(move |column| sum(row, column))).collect();
        for build in Build::all() {
            assert_eq!(
                build.run::<Exact, _>(work()),
                bits(&want),
                "{build:?}, {inputs} x {outputs}"
            );
            let fused = build.fuses().then(|| build.run::<Fused, _>(work()));
            assert_eq!(fused.unwrap_or(bits(&want)), bits(&want), "{build:?}, fused profile");
        }
    }
}

/// Attention of heads to some of the rows of two matrices; none where a build has nothing for several heads.
struct Attending {
    width: usize,
    rows: Vec<u16>,
    groups: usize,
}

impl Work for Attending {
    type Output = Option<[Vec<u32>; 2]>;

    fn run(self, kernels: impl Kernels) -> Self::Output {
        fn attended<K: Kernels>(_: K) -> usize {
            K::ATTENDED
        }
        let Self { width, rows: slots_of, groups } = self;
        if slots_of.len() > attended(kernels) {
            return None;
        }
        // Rows of two heads, of which the second is attended to.
        let (stride, first) = (2 * width, width);
        let [keys, values] = [4, 5].map(|seed| numbers(20 * stride, seed));
        let [keys, values] = [&keys, &values].map(|all| Rows {
            floats: &all[first..],
            width,
            stride,
            slots: &slots_of,
        });
        let mut alone = numbers(groups * HEADS * width, 6);
        let mut together = alone.clone();
        for head in alone.chunks_mut(width) {
            let mut scores = vec![0.0; slots(slots_of.len())];
            kernels.dots(head, keys, &mut scores);
            assert!(kernels.softmax(&mut scores, slots_of.len()));
            kernels.mix(&scores, values, head);
        }
        let mut heads = together.chunks_mut(width);
        let mut next = || heads.next().expect("as many heads");
        let group = |_| Heads { heads: [next(), next(), next(), next()], keys, values };
        let mut groups: Vec<Heads<'_>> = (0..groups).map(group).collect();
        assert!(kernels.attend(&mut groups, &[]));
        Some([bits(&alone), bits(&together)])
    }
}

fn check_attention<A: Arithmetic>(build: Build) {
    for width in [ATTENDED_WIDTH, 64, 96, 128] {
        for count in 1..=16 {
            let rows = || (0..count).map(|row| row * 7 % 20).collect();
            let work = Attending { width, rows: rows(), groups: 1 + usize::from(count) % 6 };
            if let Some([alone, together]) = build.run::<A, _>(work) {
                assert_eq!(alone, together, "{build:?}, {count} rows of {width}");
            }
        }
    }
}

#[test]
fn several_heads_attend_as_each_does() {
    for build in Build::all() {
        check_attention::<Exact>(build);
        if build.fuses() {
            check_attention::<Fused>(build);
        }
    }
}

/// Scores of several queries, some of more than a vector, some not finite: weights and what is said of them.
struct Weighing;

impl Work for Weighing {
    type Output = [Vec<(Vec<u32>, bool)>; 2];

    fn run(self, kernels: impl Kernels) -> Self::Output {
        let counts = [1, 16, 7, 0, 2, 33, 16, 5, 11];
        let mut alone: Vec<Vec<f32>> =
            (5..).zip(counts).map(|(seed, count)| numbers(slots(count), seed)).collect();
        alone[1][15] = f32::INFINITY;
        alone[2][7] = f32::NAN;
        alone[4][0] = f32::NAN;
        let mut together = alone.clone();
        let weigh = |(scores, count): (&mut Vec<f32>, usize)| {
            let finite = kernels.softmax(scores, count);
            (bits(scores), finite)
        };
        let alone = alone.iter_mut().zip(counts).map(weigh).collect();
        let scores = together.iter_mut().zip(counts);
        let scores = scores.map(|(scores, count)| Scores { scores, count, finite: true });
        let mut several: Vec<Scores<'_>> = scores.collect();
        kernels.softmaxes(&mut several);
        let together = several.iter().map(|one| (bits(one.scores), one.finite)).collect();
        [alone, together]
    }
}

#[test]
fn several_scores_are_weighed_as_each_is() {
    for build in Build::all() {
        let [alone, together] = build.run::<Exact, _>(Weighing);
        // What is not finite has no weights.
        for (at, (alone, together)) in alone.iter().zip(&together).enumerate() {
            assert_eq!(alone.1, together.1, "{build:?}, {at}");
            assert!(!alone.1 || alone.0 == together.0, "{build:?}, {at}");
            assert_eq!(alone.1, ![1, 4].contains(&at), "{build:?}, {at}");
        }
    }
}
