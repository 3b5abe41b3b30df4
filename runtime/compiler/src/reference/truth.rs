//! The truth about an answer, and how far a right engine may be from it.

use super::{Noise, Reference, Tensor};

/// Runs with noise by which scatter is known. With fewer it is known too badly: at four right engines reach ten times
/// their scatter, at eight six times.
const NOISY_RUNS: u64 = 8;

/// Half of the distance between 1 and the next number of 32 bits.
const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// The part of the other numbers' scatter that counts for each: a small number stands in the sums of large ones.
const SHARED: f64 = 0.3;

/// A number of an answer: what it is, and how far from it a right engine is found, as a root mean square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct True {
    pub(crate) value: f64,
    pub(crate) scatter: f64,
}

impl True {
    /// How far a number is from the truth, in what right engines are found from it.
    pub(crate) fn distance(self, number: f32) -> f64 {
        if f64::from(number) == self.value {
            0.0
        } else {
            (f64::from(number) - self.value).abs() / self.scatter
        }
    }

    /// Whether 32 bits hold the number, and no right engine may find it to be none.
    pub(crate) fn is_finite(self) -> bool {
        self.value.abs() <= f64::from(f32::MAX) && self.scatter.is_finite()
    }
}

/// The true outputs for some inputs, each with its scatter.
pub(crate) fn truth(
    reference: &Reference,
    inputs: &[(String, Tensor)],
    wanted: &[String],
    seed: u64,
) -> Result<Vec<Vec<True>>, String> {
    let run = |noise: Option<&mut Noise>| -> Result<Vec<Vec<f64>>, String> {
        let found = reference.run(inputs.iter().cloned(), wanted, noise)?;
        Ok(found.iter().map(Tensor::to_reals).collect())
    };
    let exact = run(None)?;
    let mut squares: Vec<Vec<f64>> = exact.iter().map(|output| vec![0.0; output.len()]).collect();
    let mut noise = Noise::new(seed);
    for noisy in 0..NOISY_RUNS {
        noise.again(seed ^ noisy);
        let found = run(Some(&mut noise))?;
        for ((squares, exact), found) in squares.iter_mut().zip(&exact).zip(&found) {
            if found.len() != exact.len() {
                return Err("has outputs whose sizes depend on rounding".to_owned());
            }
            for ((square, exact), found) in squares.iter_mut().zip(exact).zip(found) {
                *square +=
                    if found == exact { 0.0 } else { (found - exact).powi(2) / NOISY_RUNS as f64 };
            }
        }
    }
    Ok(exact.iter().zip(&squares).map(|(exact, squares)| scattered(exact, squares)).collect())
}

fn scattered(exact: &[f64], squares: &[f64]) -> Vec<True> {
    let finite: Vec<f64> = squares.iter().copied().filter(|square| square.is_finite()).collect();
    let shared = SHARED.powi(2) * finite.iter().sum::<f64>() / finite.len().max(1) as f64;
    let number = |(value, own): (&f64, &f64)| {
        let last = ROUNDING / 2.0 * value.abs();
        // Below the smallest normal number engines may take zero.
        let least = f64::from(f32::MIN_POSITIVE);
        let scatter = (own + shared + last.powi(2) + least.powi(2)).sqrt();
        True { value: *value, scatter }
    };
    exact.iter().zip(squares).map(number).collect()
}
