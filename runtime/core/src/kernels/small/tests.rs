//! The bits of the portable kernels, whether factors are looked at or not.

use std::vec;
use std::vec::Vec;

use super::Small;
use crate::kernels::arithmetic::Exact;
use crate::kernels::build::{Build, Work};
use crate::kernels::int8::{
    INPUTS, Int8Kernels, IntegerRows, Matrix, PAIRS, Reach, Row, STRIP, Scale, SparseVector,
    Vector, mixing_max, row_max,
};
use crate::kernels::product::{Around, Sparse};
use crate::kernels::rows::Rows;
use crate::kernels::softmax::slots;
use crate::kernels::{Kernels, Portable};

/// Any numbers of both signs, a third of them zero.
fn numbers(count: usize, seed: usize) -> Vec<f32> {
    let number = |index: usize| ((index + seed) * 2_654_435_761) >> 7 & 0xffff;
    let number = |index| (number(index), number(index) as f32 / 32_768.0 - 1.0);
    (0..count).map(number).map(|(n, v)| if n % 3 == 0 { 0.0 } else { v }).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Everything that is made of numbers of these sizes.
fn floats(kernels: impl Kernels, inputs: usize, outputs: usize) -> Vec<u32> {
    let (weights, values) = (numbers(inputs * outputs, 1), numbers(inputs, 2));
    let bias = numbers(outputs, 3);
    let mut all = Vec::new();
    for (around, one) in [
        (Around::NOTHING, None),
        (Around { bias: Some(&bias), relu: true }, Some(inputs - 1)),
        (Around { bias: Some(&bias), relu: false }, None),
    ] {
        let mut products = vec![f32::NAN; outputs];
        kernels.product(&weights, &values, around, &mut products);
        all.extend(bits(&products));
        let mut marks = vec![[9; 2]; inputs.div_ceil(64)];
        let values = &values[..inputs - usize::from(one.is_some())];
        assert!(kernels.mark(values, &mut marks));
        all.extend(marks.as_flattened());
        let sparse = Sparse { values, marks: &marks, one, count: inputs };
        kernels.sparse_product(&weights, sparse, around, &mut products);
        all.extend(bits(&products));
    }
    let rows = Rows { floats: &weights, width: outputs, stride: outputs, slots: &[2, 0, 1, 4, 3] };
    let mut scores = vec![f32::NAN; slots(5)];
    kernels.dots(&bias, rows, &mut scores);
    all.extend(bits(&scores[..5]));
    assert!(kernels.softmax(&mut scores, 5));
    all.extend(bits(&scores));
    let mut sums = vec![f32::NAN; outputs];
    kernels.mix(&scores, rows, &mut sums);
    all.extend(bits(&sums));
    all
}

#[test]
fn numbers_have_the_bits_of_the_portable_kernels() {
    for inputs in [5, 8, 33, 64, 70, 130] {
        for outputs in [8, 16, 24, 40, 64, 120, 128, 200] {
            let want = floats(Portable::<Exact>::new(), inputs, outputs);
            let skipping = floats(Small::<Exact, true>::new(), inputs, outputs);
            assert_eq!(skipping, want, "{inputs} x {outputs}");
            assert_eq!(floats(Small::<Exact, false>::new(), inputs, outputs), want);
        }
    }
}

#[test]
fn what_is_no_number_is_found() {
    let small = Small::<Exact, true>::new();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for place in 0..72 {
            let mut values = numbers(72, 4);
            values[place] = bad;
            assert!(!small.mark(&values, &mut [[0; 2]; 2]));
            assert_eq!(small.quantise(&values, Reach::of_inputs(96), &mut [0; 96]), None);
            let mut scores = [0.5; 80];
            scores[place] = bad;
            assert!(!small.softmax(&mut scores, 72));
            // A zero times what is no finite number is none.
            let mut product = [0.0; 4];
            small.dots(&values, Rows::first(&[0.0; 72], 72, 1), &mut product);
            assert!(product[0].is_nan(), "{place}");
        }
    }
}

/// The products of a matrix of int8 weights, dense and sparse.
fn integers(kernels: impl Int8Kernels, inputs: usize, outputs: usize, relu: bool) -> Vec<u32> {
    let groups = inputs.div_ceil(2 * PAIRS);
    let strips = outputs.div_ceil(STRIP);
    // As aligned as weights of a plan are.
    let mut words = vec![0_u32; groups * PAIRS * strips * size_of::<Row>() / 4];
    words
        .iter_mut()
        .zip(1_u32..)
        .for_each(|(word, index)| *word = index.wrapping_mul(2_654_435_761));
    let rows = zerocopy::IntoBytes::as_bytes(words.as_slice());
    let rows = <[Row] as zerocopy::FromBytes>::ref_from_bytes(rows).unwrap();
    let (steps, bias) = (numbers(strips * STRIP, 5), numbers(strips * STRIP, 6));
    let mut all = Vec::new();
    for bias in [None, Some(&bias[..])] {
        let matrix = Matrix { rows, groups, steps: &steps, bias, relu };
        let values = numbers(inputs, 7);
        let mut quantised = vec![9; inputs.div_ceil(INPUTS) * INPUTS];
        let reach = Reach::of_inputs(quantised.len());
        let Scale { step, .. } = kernels.quantise(&values, reach, &mut quantised).unwrap();
        all.extend(quantised.iter().map(|integer| *integer as u32));
        let mut products = vec![f32::NAN; outputs.next_multiple_of(8)];
        let pairs = quantised.as_chunks().0.as_chunks().0;
        kernels
            .int8_products(&matrix, &mut [Vector { inputs: pairs, step, outputs: &mut products }]);
        all.extend(bits(&products));
        for one in [None, Some(inputs - 1)] {
            let values = &values[..inputs - 1];
            let vector =
                SparseVector { values, one, integers: &mut quantised, outputs: &mut products };
            kernels.int8_sparse_product(&matrix, vector).unwrap();
            all.extend(bits(&products));
        }
    }
    all
}

#[test]
fn integers_have_the_bits_of_the_portable_kernels() {
    for inputs in [2, 9, 64, 70, 130, 1100] {
        for outputs in [8, 12, 16, 24, 128, 136] {
            for relu in [false, true] {
                let want = integers(Portable::<Exact>::new(), inputs, outputs, relu);
                let skipping = integers(Small::<Exact, true>::new(), inputs, outputs, relu);
                assert_eq!(skipping, want, "{inputs} x {outputs}");
                let others = integers(Small::<Exact, false>::new(), inputs, outputs, relu);
                assert_eq!(others, want, "{inputs} x {outputs}");
            }
        }
    }
}

/// What attention makes of rows of integers, those of some slots, as large as they may be.
fn attended(kernels: impl Int8Kernels, width: usize, slots: &[u16]) -> Vec<u32> {
    let integer = |index: usize, most: u16| {
        (index.wrapping_mul(2_654_435_761) >> 9) as i32 % (i32::from(most) + 1)
            * if index.is_multiple_of(3) { -1 } else { 1 }
    };
    let integers = |count: usize, most: u16| -> Vec<i16> {
        (0..count).map(|index| integer(index + count, most) as i16).collect()
    };
    let steps = numbers(8, 8);
    let rows = integers(8 * width, row_max(width));
    let rows = IntegerRows { integers: &rows, width, steps: &steps, slots };
    let vector = integers(width, row_max(width));
    let mut products = vec![f32::NAN; slots.len()];
    kernels.int8_dots(&vector, 0.37, rows, &mut products);
    let mut weights = integers(slots.len(), mixing_max(slots.len(), width));
    weights.resize(INPUTS, 0);
    let mut sums = vec![7; width];
    kernels.int8_mix(&weights, rows, &mut sums);
    let mut short = vec![9; width + 5];
    let step = kernels.narrow(&sums, 32_767, &mut short);
    let integers = sums.iter().map(|sum| *sum as u32).chain(short.iter().map(|s| *s as u32));
    bits(&products).into_iter().chain(integers).chain([step.to_bits()]).collect()
}

#[test]
fn attention_has_the_bits_of_the_portable_kernels() {
    /// Attends on the kernels of one build.
    struct Attend<'a>(usize, &'a [u16]);
    impl Work for Attend<'_> {
        type Output = Vec<u32>;

        fn run(self, kernels: impl Kernels) -> Vec<u32> {
            attended(kernels, self.0, self.1)
        }
    }
    for width in [32, 64, 96, 128, 512] {
        for slots in [&[3][..], &[5, 0], &[7, 1, 2], &[0, 1, 2, 3, 4, 5, 6, 7], &[4, 4, 6, 1, 0]] {
            let want = attended(Portable::<Exact>::new(), width, slots);
            for build in Build::all() {
                let got = build.run::<Exact, _>(Attend(width, slots));
                assert_eq!(got, want, "{build:?}, {slots:?} of {width}");
            }
        }
    }
}
