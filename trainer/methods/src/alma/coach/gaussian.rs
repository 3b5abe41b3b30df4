//! Normal distributions of independent numbers, as rows: means, then logarithms of variances.

use std::f32::consts::PI;

/// Bounds of the logarithm of a variance.
const LOG_VARIANCE: (f32, f32) = (-10.0, 0.0);
/// Bounds of the logarithm of a density.
const LOG_DENSITY: (f32, f32) = (-1000.0, 0.0);
/// Bounds of the entropy of a number.
const ENTROPY: (f32, f32) = (0.0, 10.0);

/// Keeps logarithms of variances within their bounds, in rows `[rows, 2 R]`.
pub(super) fn clamp(width: usize, rows: &mut [f32]) {
    let (least, most) = LOG_VARIANCE;
    for row in rows.chunks_exact_mut(2 * width) {
        row[width..].iter_mut().for_each(|value| *value = value.clamp(least, most));
    }
}

/// Zeroes the slopes of what stands at a bound.
pub(super) fn clamp_backward(width: usize, rows: &[f32], d_rows: &mut [f32]) {
    let (least, most) = LOG_VARIANCE;
    for (row, d_row) in rows.chunks_exact(2 * width).zip(d_rows.chunks_exact_mut(2 * width)) {
        for (value, slope) in row[width..].iter().zip(&mut d_row[width..]) {
            if *value <= least || *value >= most {
                *slope = 0.0;
            }
        }
    }
}

/// What is drawn from a row `[2 R]` with standard normal numbers `[R]`.
pub fn drawn<'a>(row: &'a [f32], noise: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
    let (means, log_variances) = row.split_at(noise.len());
    let numbers = means.iter().zip(log_variances).zip(noise);
    numbers.map(|((mean, log_variance), noise)| mean + noise * deviation(*log_variance))
}

/// The standard deviation that belongs to the logarithm of a variance.
pub(crate) fn deviation(log_variance: f32) -> f32 {
    (0.5 * log_variance).exp()
}

/// A number's logarithm of density within its bounds, and its slopes by number, mean and logarithm of the
/// variance, in this order.
pub(crate) fn log_density(number: f32, mean: f32, log_variance: f32) -> (f32, [f32; 3]) {
    let (least, most) = LOG_DENSITY;
    let distance = number - mean;
    let scaled = distance * (-log_variance).exp();
    let square = distance * scaled;
    let density = -0.5 * (square + log_variance + (2.0 * PI).ln());
    let slopes = if (least..=most).contains(&density) {
        [-scaled, scaled, 0.5 * (square - 1.0)]
    } else {
        [0.0; 3]
    };
    (density.clamp(least, most), slopes)
}

/// A number's entropy within its bounds, and its slope by the logarithm of the variance.
pub(crate) fn entropy(log_variance: f32) -> (f32, f32) {
    let (least, most) = ENTROPY;
    let entropy = 0.5 * (1.0 + (2.0 * PI).ln() + log_variance);
    let slope = if (least..=most).contains(&entropy) { 0.5 } else { 0.0 };
    (entropy.clamp(least, most), slope)
}
