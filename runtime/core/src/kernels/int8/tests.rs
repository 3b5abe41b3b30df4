use super::*;
use crate::kernels::Portable;
use crate::kernels::arithmetic::Exact;
use std::vec;
use std::vec::Vec;

const REACH: Reach = Reach { least: 0.0, most: 32_767 };

#[test]
fn no_sum_leaves_i32() {
    for inputs in [1, 2, 31, 64, 511, 512, 513, 1000, 8191, 65_535] {
        let most = i64::from(input_max(inputs));
        let largest_sum = inputs as i64 * 128 * most;
        assert!(most >= 1 && largest_sum <= i64::from(i32::MAX), "{inputs}: {largest_sum}");
    }
    assert_eq!((input_max(512), input_max(513)), (32_767, 32_704));
    let inputs = [[[-32_767; 2]; PAIRS]; 64];
    let rows = [[[-128; 2 * STRIP]; PAIRS]; 64];
    let sums = Portable::<Exact>::new().add_strip(&rows, [&inputs]);
    assert_eq!(sums, [[512 * 128 * 32_767; STRIP]]);
}

#[test]
fn integers_are_the_nearest() {
    for len in [1, 7, 15, 16, 17, 31, 58, 70, 128] {
        let values: Vec<f32> = (0..len).map(|i| (i as f32 - 20.0) / 7.0).collect();
        let largest = values.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        let mut integers = vec![-7; 160];
        let scale = Portable::<Exact>::new().quantise(&values, REACH, &mut integers).unwrap();
        assert!((scale.step * 32_767.0 - largest).abs() < 1e-6 * largest);
        for (value, integer) in values.iter().zip(&integers) {
            let error = (value - f32::from(*integer) * scale.step).abs();
            assert!(error <= 0.51 * scale.step, "{value} became {integer} of {len}");
        }
        assert!(integers[len..].iter().all(|integer| *integer == 0));
        let largest = integers.iter().map(|integer| integer.unsigned_abs()).max();
        assert_eq!(largest, Some(32_767));
    }
}

#[test]
fn a_scale_reaches_as_far_as_is_asked() {
    let mut integers = [1; 32];
    let scale = Portable::<Exact>::new()
        .quantise(&[0.25, -0.5], Reach { least: 1.0, ..REACH }, &mut integers)
        .unwrap();
    assert_eq!((scale.integer(1.0), integers[0], integers[1]), (32_767, 8192, -16_384));
}

#[test]
fn next_to_nothing_is_nothing_and_no_number_is_refused() {
    let mut integers = [1; 32];
    for values in [[0.0, -0.0], [1e-40, -1e-31], [f32::MIN_POSITIVE, 0.0]] {
        let scale = Portable::<Exact>::new().quantise(&values, REACH, &mut integers).unwrap();
        assert_eq!((scale.step, integers), (0.0, [0; 32]));
    }
    for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(Portable::<Exact>::new().quantise(&[0.5, bad], REACH, &mut integers), None);
    }
    let scale =
        Portable::<Exact>::new().quantise(&[f32::MAX, f32::MIN], REACH, &mut integers).unwrap();
    assert!(scale.factor > 0.0 && integers[..2] == [32_767, -32_767]);
}

#[test]
fn sums_become_numbers_once() {
    let kernels = Portable::<Exact>::new();
    // Column c of the only pair has the weights c and 1.
    let mut row = [1; 2 * STRIP];
    for (column, [weight, _]) in row.as_chunks_mut::<2>().0.iter_mut().enumerate() {
        *weight = column as i8;
    }
    let (steps, bias) = ([0.5; STRIP], [-3.0; STRIP]);
    let rows = [row, [0; 2 * STRIP], [0; 2 * STRIP], [0; 2 * STRIP]];
    let mut matrix = Matrix { rows: &rows, groups: 1, steps: &steps, bias: None, relu: false };
    let ask = |matrix: &Matrix<'_>| {
        let (mut inputs, mut outputs) = ([[[0; 2]; PAIRS]; STRIP], [f32::NAN; 8]);
        inputs[0][0] = [4, 10];
        let vector = Vector { inputs: &inputs, step: 0.25, outputs: &mut outputs };
        kernels.int8_products(matrix, &mut [vector]);
        outputs
    };
    let want: [f32; 8] = std::array::from_fn(|column| (4 * column + 10) as f32 * 0.125);
    assert_eq!(ask(&matrix), want);
    matrix = Matrix { bias: Some(&bias), relu: true, ..matrix };
    assert_eq!(ask(&matrix), want.map(|number| (number - 3.0).max(0.0)));
}

#[test]
fn what_is_zero_is_left_out_and_the_one_is_not() {
    let kernels = Portable::<Exact>::new();
    // Three strips; the weights of input i are i + 1, negative in every second column.
    let (inputs, strips) = (150, 3);
    let mut rows = vec![[0; 2 * STRIP]; inputs / 2 * strips];
    for (place, row) in rows.iter_mut().enumerate() {
        for (byte, weight) in row.iter_mut().enumerate() {
            let input = place / strips * 2 + byte % 2;
            *weight = (input as i8 % 100 + 1) * if byte / 2 % 2 == 0 { 1 } else { -1 };
        }
    }
    let weight = |input: usize| f32::from(input as i8 % 100 + 1);
    let steps = [0.5; 3 * STRIP];
    let matrix = Matrix { rows: &rows, groups: 19, steps: &steps, bias: None, relu: false };
    for len in [0, 1, 2, 9, 15, 16, 17, 31, 58, 128, 129, 133, 140] {
        for (every, one) in [(1, None), (7, None), (7, Some(len)), (64, Some(len + 5))] {
            let value = |i: usize| if i.is_multiple_of(every) { 1.0 } else { 0.0 };
            let values: Vec<f32> = (0..len).map(value).collect();
            let (mut integers, mut outputs) = ([7; 160], [f32::NAN; 40]);
            let vector = SparseVector {
                values: &values,
                one,
                integers: &mut integers,
                outputs: &mut outputs,
            };
            assert_eq!(kernels.int8_sparse_product(&matrix, vector), Some(()));
            let sum = (0..len).map(|i| value(i) * weight(i)).sum::<f32>() + one.map_or(0.0, weight);
            for (column, output) in outputs.iter().enumerate() {
                let want = if column % 2 == 0 { sum } else { -sum } * 0.5;
                assert!((output - want).abs() <= 1e-5 * sum, "{column} of {len}: {output}, {want}");
            }
        }
    }
}
