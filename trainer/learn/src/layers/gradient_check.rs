//! Finite differences for tests: one random direction per tensor, in f64 outside the layer.

use crate::random::{Purpose, generator, signed_unit};

/// Numbers in -1..1 from a seed.
pub(crate) fn random(seed: u64, count: usize) -> Vec<f32> {
    let mut generator = generator(seed, Purpose::Weights, 0);
    (0..count).map(|_| signed_unit(&mut generator)).collect()
}

/// Asserts that `gradient` is the slope of `loss` at `at` along random directions.
///
/// The step is large enough for f32 rounding to stay below 1 % and skips no kink that matters:
/// three directions are tried, and their median error counts.
pub(crate) fn assert_gradient(
    name: &str,
    at: &[f32],
    gradient: &[f32],
    loss: impl Fn(&[f32]) -> f64,
) {
    assert_eq!(at.len(), gradient.len());
    let step = 1e-3_f32;
    let mut errors: Vec<(f64, f64, f64)> = (0..3)
        .map(|seed| {
            let direction = random(100 + seed, at.len());
            let moved = |sign: f32| -> Vec<f32> {
                at.iter().zip(&direction).map(|(a, d)| a + sign * step * d).collect()
            };
            let slope = (loss(&moved(1.0)) - loss(&moved(-1.0))) / (2.0 * f64::from(step));
            let want: f64 =
                gradient.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
            ((slope - want).abs() / (0.05 + want.abs()), slope, want)
        })
        .collect();
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (error, slope, want) = errors[1];
    assert!(error < 1e-2, "gradient of {name}: {want} against slope {slope}");
}
