//! The first layer: a linear layer whose input rows are mostly zeros.
//!
//! One-hot features turn the product into a sum of a dozen weight rows, so the weight is stored
//! `[input, output]` and zero features cost nothing. The result equals the dense product.

use super::vectors::{add_scaled, add_weighted_sum, run_with_width};

pub use sortie_envs::SparseRows;

/// Writes `y [rows, width]` from `weight [input, width]` and `bias [width]`.
pub fn forward(x: &SparseRows, weight: &[f32], bias: &[f32], y: &mut [f32]) {
    run_with_width(
        bias.len(),
        #[inline(always)]
        |width| {
            for (row, y) in y.chunks_exact_mut(width).enumerate() {
                let entries = x.row(row);
                let terms =
                    entries.map(|(column, value)| (value, &weight[column * width..][..width]));
                y.copy_from_slice(bias);
                add_weighted_sum(y, terms);
            }
        },
    );
}

/// Adds the gradients of `weight [input, width]` and `bias [width]`; features have none.
pub fn backward(x: &SparseRows, d_y: &[f32], d_weight: &mut [f32], d_bias: &mut [f32]) {
    run_with_width(
        d_bias.len(),
        #[inline(always)]
        |width| {
            let d_bias = &mut d_bias[..width];
            for (row, d_y) in d_y.chunks_exact(width).enumerate() {
                add_scaled(d_bias, 1.0, d_y);
                for (column, value) in x.row(row) {
                    add_scaled(&mut d_weight[column * width..][..width], value, d_y);
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::{assert_gradient, random};

    const INPUT: usize = 9;
    const WIDTH: usize = 4;

    fn rows() -> SparseRows {
        let mut rows = SparseRows::default();
        rows.push_dense(&[0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.0, -2.0, 0.0]);
        rows.push_dense(&[0.0; INPUT]);
        rows.push_dense(&[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25]);
        rows
    }

    #[test]
    fn stores_only_what_is_not_zero() {
        let rows = rows();
        assert_eq!(rows.len(), 3);
        assert_eq!(rows.row(0).collect::<Vec<_>>(), [(1, 1.0), (3, 0.5), (7, -2.0)]);
        assert_eq!(rows.row(1).count(), 0);
    }

    #[test]
    fn appended_rows_follow_the_own_ones() {
        let mut both = rows();
        both.append(&rows());
        assert_eq!(both.len(), 6);
        for row in 0..3 {
            assert!(both.row(row).eq(rows().row(row)) && both.row(3 + row).eq(rows().row(row)));
        }
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (weight, bias) = (random(1, INPUT * WIDTH), random(2, WIDTH));
        let d_y = random(3, 3 * WIDTH);
        let loss = |weight: &[f32], bias: &[f32]| {
            let mut y = vec![0.0; 3 * WIDTH];
            forward(&rows(), weight, bias, &mut y);
            y.iter().zip(&d_y).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
        };
        let (mut d_weight, mut d_bias) = (vec![0.0; INPUT * WIDTH], vec![0.0; WIDTH]);
        backward(&rows(), &d_y, &mut d_weight, &mut d_bias);
        assert_gradient("weight", &weight, &d_weight, |weight| loss(weight, &bias));
        assert_gradient("bias", &bias, &d_bias, |bias| loss(&weight, bias));
    }
}
