//! What is known of one agent: its newest answer, and how it has answered lately.

use hdrhistogram::Histogram;
use sortie_core::wire::ActionMsg;
use sortie_core::{NO_ACTION, UNASSIGNED};
use sortie_ipc::HostProcess;

use super::overview::{Agent, Percentiles, Standing};
use super::window::Window;

/// Two digits: what is shown has no more, and every second of every agent has a histogram of its own.
const DIGITS: u8 = 2;

#[derive(Debug, Default)]
pub(super) struct Seat {
    pub(super) standing: Standing,
    newest: Option<ActionMsg>,
    recent: Window<Played>,
    total: Answers,
    guarded: u64,
}

/// How an agent played.
#[derive(Debug)]
struct Played {
    answers: Answers,
    decide_ns: Histogram<u64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Answers {
    asked: u64,
    fallbacks: u64,
    late: u64,
}

impl Default for Played {
    fn default() -> Self {
        Self { answers: Answers::default(), decide_ns: histogram() }
    }
}

/// One that grows with what is put in.
fn histogram() -> Histogram<u64> {
    Histogram::new(DIGITS).expect("so many digits are possible")
}

impl Seat {
    pub(super) fn take(&mut self, action: &ActionMsg, now_ns: u64) {
        self.newest = Some(*action);
        self.guarded += u64::from(action.has(ActionMsg::GUARD));
        let recent = self.recent.at(now_ns);
        // Of what grows nothing is refused.
        let _ = recent.decide_ns.record(action.decide_ns.into());
        if action.has(ActionMsg::LATE) {
            recent.answers.late += 1;
            self.total.late += 1;
        }
    }

    /// What it has answered to a tick.
    pub(super) fn answer_to(&self, tick: u64) -> Option<u16> {
        self.newest.filter(|newest| newest.tick == tick).map(|newest| newest.action)
    }

    /// The process that acted for it does so no more, unless another does already.
    pub(super) fn leave(&mut self, runner: u32) {
        self.newest = self.newest.filter(|newest| newest.runner != runner);
    }

    /// Counts a tick that asked the agent for an action.
    pub(super) fn judge(&mut self, has_answered: bool, now_ns: u64) {
        for answers in [&mut self.recent.at(now_ns).answers, &mut self.total] {
            answers.asked += 1;
            answers.fallbacks += u64::from(!has_answered);
        }
    }

    pub(super) fn tell(&self, now_ns: u64) -> Agent {
        let mut decide_ns = histogram();
        let mut answers = Answers::default();
        for played in self.recent.recent(now_ns) {
            answers.asked += played.answers.asked;
            answers.fallbacks += played.answers.fallbacks;
            answers.late += played.answers.late;
            let _ = decide_ns.add(&played.decide_ns);
        }
        let share = |count: u64| {
            // An answer may be counted before its tick is.
            (answers.asked > 0).then(|| (count as f64 / answers.asked as f64).min(1.0))
        };
        let at = |quantile| decide_ns.value_at_quantile(quantile) as f64 / 1e3;
        let runner = self.newest.map(|newest| HostProcess::of(newest.runner));
        // What it did in another episode is of no interest.
        let newest = self.newest.filter(|_| self.standing != Standing::Missing);
        let action = newest.map(|newest| newest.action);
        let subtask = newest.map(|newest| newest.task);
        let utility = newest.map(|newest| newest.q);
        Agent {
            standing: self.standing,
            process: runner.map(|runner| runner.pid),
            host: runner.map(|runner| runner.host),
            action: action.filter(|action| *action != NO_ACTION),
            subtask: subtask.filter(|subtask| *subtask != UNASSIGNED),
            utility: utility.filter(|utility| utility.is_finite()),
            fallback_share: share(answers.fallbacks),
            late_share: share(answers.late),
            decide_us: (!decide_ns.is_empty()).then(|| Percentiles { p50: at(0.5), p99: at(0.99) }),
            asked_total: self.total.asked,
            fallbacks_total: self.total.fallbacks,
            guarded_total: self.guarded,
            late_total: self.total.late,
            ..Agent::default()
        }
    }
}
