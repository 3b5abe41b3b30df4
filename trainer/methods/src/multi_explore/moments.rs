//! Running means and variances of all that came so far.

use serde::{Deserialize, Serialize};

/// Mean and variance, and of how many numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// The mean.
    pub mean: f64,
    /// The variance.
    pub variance: f64,
    /// The numbers; a first guess counts little.
    pub count: f64,
}

impl Default for Moments {
    fn default() -> Self {
        Self { mean: 0.0, variance: 1.0, count: 1e-4 }
    }
}

impl Moments {
    /// Adds numbers, at least one.
    pub fn add(&mut self, numbers: &[f64]) {
        let added = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / added;
        let variance = numbers.iter().map(|number| (number - mean).powi(2)).sum::<f64>() / added;
        let (difference, count) = (mean - self.mean, self.count + added);
        let between = difference * difference * self.count * added / count;
        self.variance = (self.variance * self.count + variance * added + between) / count;
        self.mean += difference * added / count;
        self.count = count;
    }
}
