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

impl PopArt {
    /// Moves the statistics towards targets, each with its weight (0 or 1 for a mask), and rescales the weights of the last
    /// linear map and behind them its biases, one pair per output.
    pub fn update(&mut self, targets: impl Iterator<Item = (f64, f64)> + Clone, head: &mut [f32]) {
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
        // The very first statistics replace none.
        if first {
            return;
        }
        let deviation = self.deviation();
        let (factor, shift) = (old_deviation / deviation, (old_mean - self.mean) / deviation);
        let (weights, biases) = head.split_at_mut(head.len() / 2);
        for weight in weights {
            *weight = (f64::from(*weight) * factor) as f32;
        }
        for bias in biases {
            *bias = (f64::from(*bias) * factor + shift) as f32;
        }
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
        let mut head = [1.5_f32, 0.5, 0.25, -2.0];
        for round in 0..20 {
            let raw = [0.7, -1.3];
            let real = |popart: &PopArt, head: &[f32; 4]| {
                let output = |i: usize| f64::from(head[i]) * raw[i] + f64::from(head[2 + i]);
                [popart.denormalise(output(0)), popart.denormalise(output(1))]
            };
            // The very first statistics replace none, so that there is nothing to preserve.
            let before = (round > 0).then(|| real(&popart, &head));
            let targets = [f64::from(round) * 0.3, 4.0, -1.0];
            popart.update(targets.map(|target| (target, 1.0)).into_iter(), &mut head);
            let after = real(&popart, &head);
            for (before, after) in before.into_iter().flatten().zip(after) {
                assert!((before - after).abs() < 1e-6 * (1.0 + before.abs()), "{before} {after}");
            }
        }
    }

    #[test]
    fn constant_targets_keep_a_variance() {
        let mut popart = PopArt::default();
        for _ in 0..2_000 {
            popart.update([(3.0, 1.0), (3.0, 1.0), (99.0, 0.0)].into_iter(), &mut []);
        }
        assert_eq!(popart.variance, LEAST_VARIANCE);
        assert!(popart.normalise(3.0).abs() < 1e-6);
    }
}
