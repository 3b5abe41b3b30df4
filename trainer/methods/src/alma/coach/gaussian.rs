//! Normal distributions of independent numbers, on a tape.

use std::f32::consts::PI;

use sortie_nn::tape::{Pass, Var};

/// Bounds of the logarithm of a variance.
const LOG_VARIANCE: (f32, f32) = (-10.0, 0.0);
/// Bounds of the logarithm of a density.
const LOG_DENSITY: (f32, f32) = (-1000.0, 0.0);
/// Bounds of the entropy of a number.
const ENTROPY: (f32, f32) = (0.0, 10.0);

/// Distributions of so many rows of numbers.
#[derive(Clone, Copy, Debug)]
pub struct Gaussian {
    /// `[rows, R]`
    pub means: Var,
    /// Logarithms of variances `[rows, R]`.
    pub log_variances: Var,
}

impl Gaussian {
    /// Means, and logarithms of variances that are kept within their bounds.
    pub(super) fn bounded(t: &mut Pass<'_>, [means, log_variances]: [Var; 2]) -> Self {
        let (least, most) = LOG_VARIANCE;
        Self { means, log_variances: t.clamp(log_variances, least, most) }
    }

    /// Numbers `[rows, R]` drawn with as many standard normal ones.
    pub fn draw(self, t: &mut Pass<'_>, noise: &[f32]) -> Var {
        let width = t.size(self.means)[1];
        let halves = t.scale(self.log_variances, 0.5);
        let (deviations, noise) = (t.exp(halves), t.input(width, noise));
        let distances = t.multiply(noise, deviations);
        t.add(self.means, distances)
    }

    /// Logarithms of the densities of numbers, within their bounds.
    pub(crate) fn log_density(self, t: &mut Pass<'_>, numbers: Var) -> Var {
        let negative = t.scale(self.means, -1.0);
        let distances = t.add(numbers, negative);
        let squares = t.multiply(distances, distances);
        let negative = t.scale(self.log_variances, -1.0);
        let precisions = t.exp(negative);
        let scaled = t.multiply(squares, precisions);
        let sum = t.add(scaled, self.log_variances);
        let sum = t.offset(sum, (2.0 * PI).ln());
        let logarithms = t.scale(sum, -0.5);
        t.clamp(logarithms, LOG_DENSITY.0, LOG_DENSITY.1)
    }
}

/// The entropies of numbers whose logarithms of variances these are, within their bounds.
pub(crate) fn entropies(t: &mut Pass<'_>, log_variances: Var) -> Var {
    let sum = t.offset(log_variances, 1.0 + (2.0 * PI).ln());
    let entropies = t.scale(sum, 0.5);
    t.clamp(entropies, ENTROPY.0, ENTROPY.1)
}
