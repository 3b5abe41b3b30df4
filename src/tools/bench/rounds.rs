//! Measures engines in alternation, so that whatever slows the machine slows all of them.

use std::thread;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use sortie_cli::latency::Latency;

use super::{VERSION, thread_cpu_s};

/// Bytes written between two calls of [`Pace::Cold`]: more than any cache holds.
const OTHER_WORK_BYTES: usize = 64 << 20;
/// Time between two calls of [`Pace::Spaced`].
const INTERVAL: Duration = Duration::from_millis(100);

/// What is measured: call number i does the same work for every engine.
pub(super) type Work<'a> = Box<dyn FnMut(usize) + 'a>;

/// One of those that take turns.
pub(super) struct Engine<'a> {
    /// What it is called in tables.
    pub(super) name: &'static str,
    pub(super) version: String,
    /// Whether it is ours, so that the others are its peers.
    pub(super) is_ours: bool,
    work: Work<'a>,
}

/// A peer.
pub(super) fn engine<'a>(
    name: &'static str,
    version: &str,
    work: impl FnMut(usize) + 'a,
) -> Engine<'a> {
    Engine { name, version: version.to_owned(), is_ours: false, work: Box::new(work) }
}

/// One of our own engines.
pub(super) fn our_engine<'a>(name: &'static str, work: impl FnMut(usize) + 'a) -> Engine<'a> {
    Engine { name, version: VERSION.to_owned(), is_ours: true, work: Box::new(work) }
}

pub(super) struct Measured {
    pub(super) latency: Latency,
    /// The median of each round, in nanoseconds.
    pub(super) medians_ns: Vec<f64>,
}

/// What lies between two calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Pace {
    /// Nothing: everything stays in the caches.
    Hot,
    /// Other work that writes 64 MB.
    Cold,
    /// A tenth of a second of sleep, as in a process that wakes at 10 Hz.
    Spaced,
}

impl Pace {
    pub(super) const ALL: [Self; 3] = [Self::Hot, Self::Cold, Self::Spaced];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Hot => "hot",
            Self::Cold => "cold",
            Self::Spaced => "10 Hz",
        }
    }

    /// Calls of one engine before the next has its turn.
    fn calls_per_turn(self) -> usize {
        match self {
            Self::Hot => 256,
            Self::Cold => 8,
            Self::Spaced => 1,
        }
    }
}

/// Alternates the engines for `seconds`, turn by turn, at least three rounds.
pub(super) fn alternate(engines: &mut [Engine<'_>], pace: Pace, seconds: f64) -> Vec<Measured> {
    let since = Instant::now();
    let clock = || since.elapsed().as_nanos() as u64;
    take_turns(engines, pace, pace.calls_per_turn(), seconds, &clock)
}

/// The same for work that takes longer than the system's time slices: hot, in processor time of this thread,
/// so many calls in a turn.
pub(super) fn alternate_long(
    engines: &mut [Engine<'_>],
    calls: usize,
    seconds: f64,
) -> Vec<Measured> {
    let clock = || (thread_cpu_s() * 1e9) as u64;
    take_turns(engines, Pace::Hot, calls, seconds, &clock)
}

/// Measures in nanoseconds of `clock`.
fn take_turns(
    engines: &mut [Engine<'_>],
    pace: Pace,
    calls: usize,
    seconds: f64,
    clock: &dyn Fn() -> u64,
) -> Vec<Measured> {
    const FEWEST_ROUNDS: usize = 3;
    let mut between = Between::new(pace);
    let mut calls_ns = Vec::with_capacity(calls);
    if pace != Pace::Hot {
        engines.iter_mut().for_each(|engine| (engine.work)(0));
    }
    let new = || Measured { latency: Latency::default(), medians_ns: Vec::new() };
    let mut measured: Vec<Measured> = engines.iter().map(|_| new()).collect();
    let until = Instant::now() + Duration::from_secs_f64(seconds);
    let mut round = 0;
    while round < FEWEST_ROUNDS || Instant::now() < until {
        for (engine, measured) in engines.iter_mut().zip(&mut measured) {
            calls_ns.clear();
            if pace == Pace::Hot {
                // Not timed: else the first engine would bring the inputs near for all others.
                (round * calls..(round + 1) * calls).for_each(|call| (engine.work)(call));
            }
            for call in round * calls..(round + 1) * calls {
                between.pass();
                let start = clock();
                (engine.work)(call);
                calls_ns.push(clock().saturating_sub(start));
            }
            calls_ns.iter().for_each(|ns| measured.latency.record_ns(*ns));
            calls_ns.sort_unstable();
            measured.medians_ns.extend(calls_ns.get(calls / 2).map(|ns| *ns as f64));
        }
        round += 1;
    }
    measured
}

/// Does what lies between two calls.
struct Between {
    pace: Pace,
    other_work: Vec<u64>,
    written: u64,
}

impl Between {
    fn new(pace: Pace) -> Self {
        let words = if pace == Pace::Cold { OTHER_WORK_BYTES / 8 } else { 0 };
        Self { pace, other_work: vec![0; words], written: 0 }
    }

    fn pass(&mut self) {
        match self.pace {
            Pace::Hot => {}
            Pace::Cold => {
                self.written += 1;
                self.other_work.fill(self.written);
                std::hint::black_box(&self.other_work);
            }
            Pace::Spaced => thread::sleep(INTERVAL),
        }
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

/// How the time is spent.
pub(super) struct Schedule<'a> {
    pub(super) paces: &'a [Pace],
    pub(super) seconds_per_case: f64,
}

impl<'a> Schedule<'a> {
    /// Hot calls are short and many; the others wait most of their time, and make three rounds at least.
    pub(super) fn seconds(&self, pace: Pace) -> f64 {
        let share = match pace {
            Pace::Hot => 0.6,
            Pace::Cold => 0.3,
            Pace::Spaced => 0.1,
        };
        self.seconds_per_case * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_is_taken_round_by_round() {
        // Both are slowed alike in the last round: the ratio does not notice.
        assert_eq!(paired_ratio(&[1.0, 2.0, 50.0], &[10.0, 20.0, 500.0]), [10.0, 10.0, 10.0]);
    }

    #[test]
    fn engines_take_turns_over_the_same_calls() {
        let calls = std::cell::RefCell::new(Vec::new());
        let calls = &calls;
        let engine = |name| engine(name, "", move |call| calls.borrow_mut().push((name, call)));
        let mut engines = [engine("a"), engine("b")];
        let measured = alternate_long(&mut engines, 2, 0.0);
        assert!(measured.iter().all(|engine| engine.medians_ns.len() == 3));
        assert!(measured.iter().all(|engine| engine.latency.samples() == 6));
        let calls = calls.borrow();
        // Each turn begins with its calls once, not timed.
        let first =
            [("a", 0), ("a", 1), ("a", 0), ("a", 1), ("b", 0), ("b", 1), ("b", 0), ("b", 1)];
        assert_eq!(calls[..8], first);
        assert_eq!(calls[8..12], [("a", 2), ("a", 3), ("a", 2), ("a", 3)]);
    }
}
