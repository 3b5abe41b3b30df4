//! PopArt: learns in normalised units and keeps the outputs in real units as they were.
//!
//! Statistics of the targets move slowly; whenever they move, the last linear map of the network is
//! rescaled so that nothing changes in real units (van Hasselt et al. 2016, as the public code has it).

use serde::{Deserialize, Serialize};

/// Share of the way that the statistics move in an update.
const RATE: f64 = 0.01;
/// The least variance, so that constant targets divide by something.
const LEAST_VARIANCE: f64 = 1e-4;

/// Mean and variance of the targets of one network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PopArt {
    /// Mean of the targets.
    pub mean: f64,
    /// Variance of the targets.
    pub variance: f64,
    /// Whether targets have been seen; the first ones set the statistics.
    pub started: bool,
}

impl Default for PopArt {
    fn default() -> Self {
        Self { mean: 0.0, variance: 1.0, started: false }
    }
}

/// How the last linear map changes so that its outputs stay as they are in real units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rescale {
    factor: f64,
    shift: f64,
}

impl Rescale {
    /// Rescales weights and biases, one pair per output.
    pub fn apply(&self, weights: &mut [f32], biases: &mut [f32]) {
        for weight in weights {
            *weight = (f64::from(*weight) * self.factor) as f32;
        }
        for bias in biases {
            *bias = (f64::from(*bias) * self.factor + self.shift) as f32;
        }
    }
}

impl PopArt {
    /// Moves the statistics towards targets, each with its weight (0 or 1 for a mask).
    pub fn update(&mut self, targets: impl Iterator<Item = (f64, f64)> + Clone) -> Rescale {
        let total = targets.clone().map(|(_, weight)| weight).sum::<f64>() + 1e-8;
        let mean = |of: &dyn Fn(f64) -> f64| {
            targets.clone().map(|(target, weight)| of(target) * weight).sum::<f64>() / total
        };
        let first = !self.started;
        self.started = true;
        if first {
            self.mean = mean(&|target| target);
        }
        let (old_mean, before) = (self.mean, self.mean);
        let squares = mean(&|target| (target - before) * (target - before));
        self.mean += RATE * mean(&|target| target - before);
        if first {
            self.variance = squares;
        }
        let old_deviation = self.deviation();
        self.variance = ((1.0 - RATE) * (self.variance + RATE * squares)).max(LEAST_VARIANCE);
        if first {
            return Rescale { factor: 1.0, shift: 0.0 };
        }
        let deviation = self.deviation();
        Rescale { factor: old_deviation / deviation, shift: (old_mean - self.mean) / deviation }
    }

    /// A value in real units as the network learns it.
    pub fn normalise(&self, value: f64) -> f64 {
        (value - self.mean) / self.deviation()
    }

    /// An output of the network in real units.
    pub fn denormalise(&self, output: f64) -> f64 {
        output * self.deviation() + self.mean
    }

    fn deviation(&self) -> f64 {
        self.variance.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_in_real_units_stay_as_they_are() {
        let mut popart = PopArt::default();
        let (mut weights, mut biases) = ([1.5_f32, 0.5], [0.25_f32, -2.0]);
        for round in 0..20 {
            let raw = [0.7, -1.3];
            let real = |popart: &PopArt, weights: &[f32; 2], biases: &[f32; 2]| {
                let output = |i: usize| f64::from(weights[i]) * raw[i] + f64::from(biases[i]);
                [popart.denormalise(output(0)), popart.denormalise(output(1))]
            };
            // The very first statistics replace none, so that there is nothing to preserve.
            let before = (round > 0).then(|| real(&popart, &weights, &biases));
            let targets = [f64::from(round) * 0.3, 4.0, -1.0];
            popart
                .update(targets.map(|target| (target, 1.0)).into_iter())
                .apply(&mut weights, &mut biases);
            let after = real(&popart, &weights, &biases);
            for (before, after) in before.into_iter().flatten().zip(after) {
                assert!((before - after).abs() < 1e-6 * (1.0 + before.abs()), "{before} {after}");
            }
        }
    }

    #[test]
    fn constant_targets_keep_a_variance() {
        let mut popart = PopArt::default();
        for _ in 0..2_000 {
            popart.update([(3.0, 1.0), (3.0, 1.0), (99.0, 0.0)].into_iter());
        }
        assert_eq!(popart.variance, LEAST_VARIANCE);
        assert!(popart.normalise(3.0).abs() < 1e-6);
    }
}
