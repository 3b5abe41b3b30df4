//! Softmax of one row of numbers, and its logarithm, in place.

/// Replaces scores by positive weights that sum to 1. An empty row stays empty.
#[inline]
pub fn forward(row: &mut [f32]) {
    let max = row.iter().fold(f32::NEG_INFINITY, |max, score| max.max(*score));
    let mut sum = 0.0;
    for score in row.iter_mut() {
        *score = (*score - max).exp();
        sum += *score;
    }
    row.iter_mut().for_each(|weight| *weight /= sum);
}

/// Turns the gradient of the weights into that of the scores: `p * (d - sum(p * d))`.
#[inline]
pub fn backward(weights: &[f32], gradient: &mut [f32]) {
    let sum: f32 = weights.iter().zip(gradient.iter()).map(|(p, d)| p * d).sum();
    for (p, d) in weights.iter().zip(gradient) {
        *d = p * (*d - sum);
    }
}

/// Replaces scores by the logarithms of their softmax.
pub fn log_forward(row: &mut [f32]) {
    let max = row.iter().fold(f32::NEG_INFINITY, |max, score| max.max(*score));
    let sum: f32 = row.iter().map(|score| (score - max).exp()).sum();
    let level = max + sum.ln();
    row.iter_mut().for_each(|score| *score -= level);
}

/// Turns the gradient of the logarithms into that of the scores: `d - p sum(d)`.
pub fn log_backward(logarithms: &[f32], gradient: &mut [f32]) {
    let sum: f32 = gradient.iter().sum();
    for (logarithm, d) in logarithms.iter().zip(gradient) {
        *d -= logarithm.exp() * sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::{assert_gradient, random};

    fn weights(scores: &[f32]) -> Vec<f32> {
        let mut row = scores.to_vec();
        forward(&mut row);
        row
    }

    #[test]
    fn weights_are_positive_and_sum_to_one() {
        let weights = weights(&[-300.0, 0.0, 2.0]);
        assert!(weights.iter().all(|weight| *weight >= 0.0));
        assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        assert!((weights[2] / weights[1] - 2.0_f32.exp()).abs() < 1e-4);
        forward(&mut []);
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (scores, slope) = (random(1, 6), random(2, 6));
        let mut gradient = slope.clone();
        backward(&weights(&scores), &mut gradient);
        assert_gradient("scores", &scores, &gradient, |scores| {
            weights(scores).iter().zip(&slope).map(|(p, d)| f64::from(*p) * f64::from(*d)).sum()
        });
    }
}
