//! Measures engines in alternation, so that whatever slows the machine slows all of them.

use std::time::{Duration, Instant};

use crate::latency::Latency;

/// Calls of one engine before the next has its turn.
const CALLS_PER_TURN: usize = 256;

/// What is measured: call number i does the same work for every engine.
pub(super) type Work<'a> = &'a mut dyn FnMut(usize);

/// One engine's figures.
pub(super) struct Measured {
    pub(super) latency: Latency,
    /// The median of each round, in nanoseconds.
    pub(super) medians_ns: Vec<f64>,
}

/// Alternates the engines for `seconds`, turn by turn.
pub(super) fn alternate(engines: &mut [Work<'_>], seconds: f64) -> Vec<Measured> {
    for work in engines.iter_mut() {
        turn(work, &mut Vec::new());
    }
    let mut measured: Vec<Measured> = engines
        .iter()
        .map(|_| Measured { latency: Latency::new(), medians_ns: Vec::new() })
        .collect();
    let until = Instant::now() + Duration::from_secs_f64(seconds);
    let mut calls_ns = Vec::with_capacity(CALLS_PER_TURN);
    while Instant::now() < until {
        for (work, measured) in engines.iter_mut().zip(&mut measured) {
            turn(work, &mut calls_ns);
            calls_ns.iter().for_each(|ns| measured.latency.record_ns(*ns));
            calls_ns.sort_unstable();
            measured.medians_ns.push(calls_ns[CALLS_PER_TURN / 2] as f64);
        }
    }
    measured
}

fn turn(work: &mut Work<'_>, calls_ns: &mut Vec<u64>) {
    calls_ns.clear();
    for call in 0..CALLS_PER_TURN {
        let start = Instant::now();
        work(call);
        calls_ns.push(start.elapsed().as_nanos() as u64);
    }
}

/// Median, and the 5th and 95th percentile, of how many times as long the peer took, round by round.
pub(super) fn paired_ratio(ours: &[f64], peer: &[f64]) -> [f64; 3] {
    let mut ratios: Vec<f64> = ours.iter().zip(peer).map(|(ours, peer)| peer / ours).collect();
    ratios.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let last = ratios.len().saturating_sub(1);
        ratios.get((last as f64 * share).round() as usize).copied().unwrap_or(f64::NAN)
    };
    [at(0.5), at(0.05), at(0.95)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_is_taken_round_by_round() {
        // Both are slowed alike in the last round: the ratio does not notice.
        assert_eq!(paired_ratio(&[1.0, 2.0, 50.0], &[10.0, 20.0, 500.0]), [10.0, 10.0, 10.0]);
    }
}
