//! Latency figures: recorded in nanoseconds, shown in microseconds.

use hdrhistogram::Histogram;
use serde::Serialize;

/// Samples from which on a 99.9th percentile means something.
const SAMPLES_FOR_P999: u64 = 10_000;
/// One minute: a longer wait is counted as that.
const LONGEST_NS: u64 = 60_000_000_000;

pub struct Latency {
    histogram: Histogram<u64>,
}

/// The figures of a distribution, in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Percentiles {
    pub p50: f64,
    pub p99: f64,
    /// 99.9th percentile, absent below 10,000 samples.
    pub p999: Option<f64>,
    pub max: f64,
}

impl Default for Latency {
    /// Nothing measured.
    fn default() -> Self {
        let histogram = Histogram::new_with_max(LONGEST_NS, 3).expect("the bounds are constants");
        Self { histogram }
    }
}

impl Latency {
    pub fn record_ns(&mut self, ns: u64) {
        self.histogram.saturating_record(ns.clamp(1, LONGEST_NS));
    }

    pub fn samples(&self) -> u64 {
        self.histogram.len()
    }

    pub fn percentiles(&self) -> Percentiles {
        let at = |quantile| self.histogram.value_at_quantile(quantile) as f64 / 1000.0;
        Percentiles {
            p50: at(0.5),
            p99: at(0.99),
            p999: (self.samples() >= SAMPLES_FOR_P999).then(|| at(0.999)),
            max: self.histogram.max() as f64 / 1000.0,
        }
    }
}

/// How far samples are from their mean, from one to the next (Welford).
#[derive(Clone, Copy, Debug, Default)]
pub struct Spread {
    samples: u64,
    mean: f64,
    /// Sum of the squared distances.
    squares: f64,
}

impl Spread {
    pub fn record(&mut self, value: f64) {
        self.samples += 1;
        let distance = value - self.mean;
        self.mean += distance / self.samples as f64;
        self.squares += distance * (value - self.mean);
    }

    /// Standard deviation; zero without samples.
    pub fn deviation(&self) -> f64 {
        (self.squares / self.samples.max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_the_standard_deviation() {
        let mut spread = Spread::default();
        assert_eq!(spread.deviation(), 0.0);
        for value in [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0] {
            spread.record(value);
        }
        assert_eq!(spread.deviation(), 2.0);
    }

    #[test]
    fn the_far_tail_is_shown_only_with_enough_samples() {
        let mut latency = Latency::default();
        for ns in 1..SAMPLES_FOR_P999 {
            latency.record_ns(ns * 1000);
        }
        assert_eq!(latency.percentiles().p999, None);
        latency.record_ns(SAMPLES_FOR_P999 * 1000);
        let p999 = latency.percentiles().p999.expect("there are enough samples now");
        assert!((9_980.0..=10_010.0).contains(&p999), "{p999}");
    }
}
