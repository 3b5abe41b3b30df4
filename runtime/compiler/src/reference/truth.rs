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
    let finite: Vec<f64> = squares.iter().copied().filter(|square| square.is_finite()).collect();
    let shared = SHARED.powi(2) * finite.iter().sum::<f64>() / finite.len().max(1) as f64;
    let number = |(value, own): (&f64, &f64)| {
        let last = if fits(*value) { ROUNDING / 2.0 * value.abs() } else { 0.0 };
        // Below the smallest normal number engines may take zero.
        let least = f64::from(f32::MIN_POSITIVE);
        let scatter = (own + shared + last.powi(2) + least.powi(2)).sqrt();
        TrueNumber { value: *value, scatter }
    };
    exact.iter().zip(squares).map(number).collect()
}
