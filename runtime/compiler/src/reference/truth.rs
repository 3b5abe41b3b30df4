//! The truth about an answer, and how far a right engine may be from it.

use sortie_plans::{TrueNumber, fits};

use super::noise::ROUNDING;

/// Runs with noise by which scatter is known. With fewer it is known too badly: at four right engines reach ten times
/// their scatter, at eight six times.
const NOISY_RUNS: usize = 8;

/// All runs: the exact one first.
pub(crate) const RUNS: usize = 1 + NOISY_RUNS;

/// The part of the other numbers' scatter that counts for each: a small number stands in the sums of large ones.
const SHARED: f64 = 0.3;

/// How far below zero, in what an output's smallest number is beside 1, a score is shut: files take 1e8 or the largest number
/// there is from it. What it scatters there is its own; beside it nothing would show of the scores that are open.
const SHUT: f64 = 1.0e4;

/// What every run gives for each wanted output: first the exact numbers, then those of every noisy run.
pub(crate) type Runs = Vec<Vec<Vec<f64>>>;

/// The truth that some runs tell: a list for each output.
pub(crate) fn truth(runs: &Runs) -> Result<Vec<Vec<TrueNumber>>, String> {
    let [exact, noisy @ ..] = &runs[..] else { return Err("nothing was run".to_owned()) };
    let mut squares: Vec<Vec<f64>> = exact.iter().map(|output| vec![0.0; output.len()]).collect();
    for found in noisy {
        for ((squares, exact), found) in squares.iter_mut().zip(exact).zip(found) {
            if found.len() != exact.len() {
                return Err("an output's size depends on rounding".to_owned());
            }
            for ((square, exact), found) in squares.iter_mut().zip(exact).zip(found) {
                // Where no run has a number, right engines agree that there is none.
                let is_same = found == exact || !fits(*found) && !fits(*exact);
                let off = if is_same { 0.0 } else { found - exact };
                *square += off * off / noisy.len() as f64;
            }
        }
    }
    Ok(exact.iter().zip(&squares).map(|(exact, squares)| scattered(exact, squares)).collect())
}

fn scattered(exact: &[f64], squares: &[f64]) -> Vec<TrueNumber> {
    let smallest = exact.iter().map(|value| value.abs()).fold(f64::INFINITY, f64::min);
    let is_open = |value: f64| value > -SHUT * (1.0 + smallest);
    let known = exact.iter().zip(squares).filter(|(value, _)| is_open(**value));
    let known: Vec<f64> = known.map(|(_, square)| *square).filter(|s| s.is_finite()).collect();
    let shared = SHARED.powi(2) * known.iter().sum::<f64>() / known.len().max(1) as f64;
    let number = |(value, own): (&f64, &f64)| {
        let last = if fits(*value) { ROUNDING / 2.0 * value.abs() } else { 0.0 };
        // Below the smallest normal number engines may take zero.
        let least = f64::from(f32::MIN_POSITIVE);
        let scatter = (own + shared + last.powi(2) + least.powi(2)).sqrt();
        TrueNumber { value: *value, scatter }
    };
    exact.iter().zip(squares).map(number).collect()
}
