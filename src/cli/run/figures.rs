//! What a run measures.

use std::collections::{BTreeMap, BTreeSet};

use sortie_core::roles::TickReport;
use sortie_core::wire::ActionMsg;
use sortie_core::{NO_ACTION, limits};

use crate::latency::{Latency, Spread};

/// Latencies and times of a run, tick by tick.
#[derive(Default)]
pub(super) struct Figures {
    /// Decisions of all agents.
    pub(super) decisions: u64,
    /// One decision alone.
    pub(super) decide: Latency,
    /// From a frame's publishing to an agent's action.
    pub(super) act: Latency,
    /// From a frame's publishing to the end of the world's step.
    pub(super) tick: Latency,
    /// From the time at which a frame was due to its publishing, where the world is held to a rate.
    pub(super) delay: Latency,
    /// From one frame's publishing to the next one's, within the run as a whole, and how much that varies.
    pub(super) interval: Latency,
    pub(super) jitter: Spread,
    /// Periods in which no frame came, since the world was late by them.
    pub(super) skipped: u64,
    /// Ticks that were not over when the next frame was due.
    pub(super) overran: u64,
    /// Fallback actions, of agents without an answer in time and of those whose policy refused.
    pub(super) fallbacks: u64,
    /// Those for which a guard refused what an agent observed.
    pub(super) guarded: u64,
    /// Agents for which nobody acts, and since when.
    pub(super) absent: BTreeMap<usize, Since>,
    /// Ids of the processes heard of, the world's included.
    pub(super) processes: BTreeSet<u32>,
    /// When the first frame was published, the newest one, and when its step was over.
    first_ns: Option<u64>,
    published_ns: Option<u64>,
    ended_ns: u64,
    /// A person has let the world stand still since the newest frame.
    stood_still: bool,
}

/// A moment of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Since {
    /// Episode of this world, from 0.
    pub(super) episode: u32,
    /// Step in the episode, from 0.
    pub(super) step: u32,
}

impl Figures {
    /// Takes in a tick.
    pub(super) fn record(&mut self, report: &TickReport<'_>) {
        for answer in report.answers() {
            self.decisions += 1;
            self.fallbacks += u64::from(answer.has(ActionMsg::FALLBACK));
            self.guarded += u64::from(answer.has(ActionMsg::GUARD));
            self.decide.record_ns(u64::from(answer.decide_ns));
            self.act.record_ns(answer.t_ns.saturating_sub(report.published_ns));
        }
        self.fallbacks += unanswered(report);
        self.record_absent(report);
        self.tick.record_ns(report.tick_ns);
        self.record_times(report);
    }

    fn record_absent(&mut self, report: &TickReport<'_>) {
        let is_absent = |agent: usize| report.absent >> agent & 1 == 1;
        self.absent.retain(|agent, _| is_absent(*agent));
        if self.absent.len() < report.absent.count_ones() as usize {
            let now = Since { episode: report.episode, step: report.step };
            for agent in (0..limits::AGENTS).filter(|agent| is_absent(*agent)) {
                self.absent.entry(agent).or_insert(now);
            }
        }
    }

    fn record_times(&mut self, report: &TickReport<'_>) {
        let (published, timing) = (report.published_ns, report.timing);
        self.first_ns.get_or_insert(published);
        self.ended_ns = published.saturating_add(report.tick_ns);
        let before = self.published_ns.replace(published);
        self.overran += u64::from(timing.overran);
        // What a person asked for is not late.
        if std::mem::take(&mut self.stood_still) {
            return;
        }
        self.delay.record_ns(timing.delay_ns);
        self.skipped += timing.skipped;
        if let Some(before) = before {
            let interval_ns = published.saturating_sub(before);
            self.interval.record_ns(interval_ns);
            self.jitter.record(interval_ns as f64);
        }
    }

    /// A person has let the world stand still.
    pub(super) fn stand_still(&mut self) {
        self.stood_still = true;
    }

    /// From the first frame to the end of the last step, in seconds.
    pub(super) fn wall_seconds(&self) -> f64 {
        let first = self.first_ns.unwrap_or(self.ended_ns);
        self.ended_ns.saturating_sub(first) as f64 / 1e9
    }
}

/// Agents that acted without an answer.
fn unanswered(report: &TickReport<'_>) -> u64 {
    let acted = report.actions.iter().enumerate().filter(|(_, action)| **action != NO_ACTION);
    acted.filter(|(agent, _)| report.answered >> agent & 1 == 0).count() as u64
}

#[cfg(test)]
mod tests {
    use sortie_core::StepOutcome;
    use sortie_core::roles::Timing;

    use super::*;

    fn tick(published_ns: u64, timing: Timing) -> TickReport<'static> {
        TickReport {
            tick: 1,
            episode: 0,
            step: 0,
            actions: &[],
            answers: &[],
            answered: 0,
            allocation: None,
            published_ns,
            tick_ns: 1_000_000,
            timing,
            allocations_missed: 0,
            absent: 0,
            degraded: false,
            outcome: StepOutcome { episode_ended: false, tasks_changed: false },
        }
    }

    #[test]
    fn absent_agents_are_named_with_the_moment_since_when() {
        let mut figures = Figures::default();
        let since = |episode, step| Since { episode, step };
        for (at, absent, want) in [
            (since(0, 3), 0, vec![]),
            (since(0, 4), 0b1_0000, vec![(4, since(0, 4))]),
            (since(1, 0), 0b1_0001, vec![(0, since(1, 0)), (4, since(0, 4))]),
            (since(1, 1), 0b0_0010, vec![(1, since(1, 1))]),
            (since(1, 2), 0b1_0010, vec![(1, since(1, 1)), (4, since(1, 2))]),
        ] {
            let Since { episode, step } = at;
            figures.record(&TickReport { episode, step, absent, ..tick(0, Timing::default()) });
            assert_eq!(figures.absent.clone().into_iter().collect::<Vec<_>>(), want);
        }
    }

    #[test]
    fn time_is_told_from_when_frames_were_due() {
        const S: u64 = 1_000_000_000;
        let stopped = Timing { delay_ns: 5 * S, skipped: 250, overran: false };
        let mut figures = Figures::default();
        for (published_ns, timing) in [(S, Timing::default()), (7 * S, stopped)] {
            figures.record(&tick(published_ns, timing));
        }
        assert_eq!((figures.skipped, figures.overran, figures.wall_seconds()), (250, 0, 6.001));
        let near = |us: f64, s: f64| (us / 1e6 / s - 1.0).abs() < 0.001;
        assert!(near(figures.delay.percentiles().max, 5.0));
        assert!(near(figures.interval.percentiles().max, 6.0));
        // A person who looks on lets it stand still.
        figures.stand_still();
        figures.record(&tick(57 * S, Timing { delay_ns: 50 * S, skipped: 2_500, overran: true }));
        assert_eq!((figures.skipped, figures.overran, figures.interval.samples()), (250, 1, 1));
    }
}
