//! The dense linear layer `y = W x + b`.

use super::matrix::{Matrix, MatrixMut, Store, multiply};
use super::vectors::{add_scaled, run_widest};

/// Sizes of a linear layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinearShape {
    /// Width of an input row.
    pub input: usize,
    /// Width of an output row.
    pub output: usize,
}

/// Writes `y [rows, output]` from `x [rows, input]`, `weight [output, input]`, `bias [output]`.
pub fn forward(shape: LinearShape, x: &[f32], weight: &[f32], bias: &[f32], y: &mut [f32]) {
    product(shape, Store::Replace, x, weight, y);
    add_bias(f32::NEG_INFINITY, bias, y);
}

/// Adds the bias to every row; `least` is what smaller sums are replaced by: 0 makes it a rectified layer.
pub(crate) fn add_bias(least: f32, bias: &[f32], y: &mut [f32]) {
    run_widest(
        #[inline(always)]
        || {
            for row in y.chunks_exact_mut(bias.len()) {
                row.iter_mut().zip(bias).for_each(|(y, bias)| *y = (*y + bias).max(least));
            }
        },
    );
}

/// Writes `y [rows, output]` from `x [rows, input]` and `weight [output, input]`, or adds to it.
pub fn product(shape: LinearShape, store: Store, x: &[f32], weight: &[f32], y: &mut [f32]) {
    let rows = y.len() / shape.output;
    multiply(
        MatrixMut::new(y, rows, shape.output),
        store,
        Matrix::new(x, rows, shape.input),
        Matrix::new(weight, shape.output, shape.input).transposed(),
    );
}

/// Writes the input gradient `d_x [rows, input]` from `d_y [rows, output]`.
pub fn backward_input(
    shape: LinearShape,
    d_y: &[f32],
    weight: &[f32],
    store: Store,
    d_x: &mut [f32],
) {
    let rows = d_x.len() / shape.input;
    multiply(
        MatrixMut::new(d_x, rows, shape.input),
        store,
        Matrix::new(d_y, rows, shape.output),
        Matrix::new(weight, shape.output, shape.input),
    );
}

/// Adds to `d_weight [output, input]` the sum of outer products of `d_y` and `x`.
pub fn backward_weight(shape: LinearShape, x: &[f32], d_y: &[f32], d_weight: &mut [f32]) {
    let rows = x.len() / shape.input;
    multiply(
        MatrixMut::new(d_weight, shape.output, shape.input),
        Store::Add,
        Matrix::new(d_y, rows, shape.output).transposed(),
        Matrix::new(x, rows, shape.input),
    );
}

/// Adds to `d_bias [output]` the column sums of `d_y`.
pub fn backward_bias(d_y: &[f32], d_bias: &mut [f32]) {
    run_widest(
        #[inline(always)]
        || d_y.chunks_exact(d_bias.len()).for_each(|row| add_scaled(d_bias, 1.0, row)),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::{assert_gradient, random};

    const SHAPE: LinearShape = LinearShape { input: 5, output: 3 };
    const ROWS: usize = 7;

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (x, weight, bias) = (random(1, ROWS * 5), random(2, 15), random(3, 3));
        let d_y = random(4, ROWS * 3);
        let loss = |x: &[f32], weight: &[f32], bias: &[f32]| {
            let mut y = vec![0.0; ROWS * 3];
            forward(SHAPE, x, weight, bias, &mut y);
            y.iter().zip(&d_y).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
        };
        let mut d_x = vec![f32::NAN; ROWS * 5];
        backward_input(SHAPE, &d_y, &weight, Store::Replace, &mut d_x);
        let (mut d_weight, mut d_bias) = (vec![0.0; 15], vec![0.0; 3]);
        backward_weight(SHAPE, &x, &d_y, &mut d_weight);
        backward_bias(&d_y, &mut d_bias);

        assert_gradient("x", &x, &d_x, |x| loss(x, &weight, &bias));
        assert_gradient("weight", &weight, &d_weight, |weight| loss(&x, weight, &bias));
        assert_gradient("bias", &bias, &d_bias, |bias| loss(&x, &weight, bias));
    }

    #[test]
    fn two_inputs_add_up_before_the_rectifier() {
        let (x, other_x) = (random(1, ROWS * 5), random(2, ROWS * 5));
        let (weight, other, bias) = (random(3, 15), random(4, 15), random(5, 3));
        let mut y = vec![f32::NAN; ROWS * 3];
        product(SHAPE, Store::Replace, &x, &weight, &mut y);
        product(SHAPE, Store::Add, &other_x, &other, &mut y);
        add_bias(0.0, &bias, &mut y);
        let (mut one, mut two) = (vec![0.0; ROWS * 3], vec![0.0; ROWS * 3]);
        forward(SHAPE, &x, &weight, &bias, &mut one);
        product(SHAPE, Store::Replace, &other_x, &other, &mut two);
        let want: Vec<f32> = one.iter().zip(&two).map(|(a, b)| (a + b).max(0.0)).collect();
        assert!(y.iter().zip(&want).all(|(y, want)| (y - want).abs() < 1e-5), "{y:?} {want:?}");
        assert!(want.contains(&0.0) && want.iter().any(|want| *want > 0.0), "{want:?}");
    }
}
