//! Finite differences for tests: one random direction per tensor, in f64 outside the layer.

use crate::random::{signed_unit, stream};

/// Numbers in -1..1 from a seed.
pub fn random(seed: u64, count: usize) -> Vec<f32> {
    let mut generator = stream(seed, 1, 0);
    (0..count).map(|_| signed_unit(&mut generator)).collect()
}

/// Asserts that `gradient` is the slope of `loss` at `at` along random directions.
///
/// Errors are measured against the slope that such a direction has on average. The median of three
/// directions counts, because one step may cross a kink of the loss, and that of nine where two of the
/// three seem to have crossed one.
pub fn assert_gradient(name: &str, at: &[f32], gradient: &[f32], loss: impl Fn(&[f32]) -> f64) {
    assert_eq!(at.len(), gradient.len());
    let step = 3e-4_f32;
    let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
    assert!(norm > 0.0, "gradient of {name} is zero");
    let usual_slope = norm / 3.0_f64.sqrt();
    let error_along = |seed: u64| {
        let direction = random(100 + seed, at.len());
        let moved = |sign: f32| -> Vec<f32> {
            at.iter().zip(&direction).map(|(a, d)| a + sign * step * d).collect()
        };
        let slope = (loss(&moved(1.0)) - loss(&moved(-1.0))) / (2.0 * f64::from(step));
        let want: f64 =
            gradient.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
        ((slope - want).abs() / usual_slope, slope, want)
    };
    let mut errors = Vec::new();
    for directions in [3, 9] {
        errors.extend((errors.len() as u64..directions).map(error_along));
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        if errors[errors.len() / 2].0 < 1e-2 {
            return;
        }
    }
    let (_, slope, want) = errors[errors.len() / 2];
    panic!("gradient of {name}: {want} against slope {slope}");
}
