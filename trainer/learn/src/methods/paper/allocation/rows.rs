//! What the high level learns from: one row for every decision point of the windows.

use super::super::windows::{NO_TASK, Windows};
use super::states::{StateView, States};

/// How decision points become rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowRules {
    /// Environment steps between decisions, by which rewards are divided (`action_length`).
    pub interval: f32,
    /// Rows beyond this number are left out.
    pub most: usize,
    /// Environment steps after which an episode counts for nothing (`decay_old`).
    pub age_limit: f32,
}

/// Decision points in the order of the windows, each with what came of it until the next.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// The states, with the allocations that were chosen.
    pub states: States,
    /// Sum of the team's rewards until the next decision, divided by the interval.
    pub reward: Vec<f32>,
    /// Whether the episode truly ended before the next decision.
    pub terminated: Vec<bool>,
    /// Whether the row can be learned from.
    pub mask: Vec<bool>,
    /// How much it counts, by its age: 1 is new, 0 is too old.
    pub weight: Vec<f32>,
}

impl Rows {
    /// How many rows there are.
    pub fn len(&self) -> usize {
        self.reward.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.reward.is_empty()
    }

    /// Collects the decision points of windows, `now` environment steps into the run.
    pub fn collect(&mut self, windows: &Windows, now: u64, rules: &RowRules) {
        let shape = windows.shape;
        self.states = States::new(shape.agents, shape.entities, shape.tasks);
        self.reward.clear();
        self.terminated.clear();
        self.mask.clear();
        self.weight.clear();
        for window in 0..shape.windows {
            self.collect_window(windows, window, now, rules);
        }
    }

    fn collect_window(&mut self, windows: &Windows, window: usize, now: u64, rules: &RowRules) {
        let steps = window * windows.shape.steps..(window + 1) * windows.shape.steps;
        let first = self.len();
        // After the end of an episode nobody has an allocation until the next episode's first decision.
        let mut between_episodes = false;
        for state in steps {
            if windows.decision[state] {
                if self.len() == rules.most {
                    return;
                }
                self.begin_row(windows, state, between_episodes);
                self.weight.push(age_weight(now, windows.added[state], rules));
                between_episodes = false;
            }
            if let Some(row) = self.len().checked_sub(1).filter(|row| *row >= first) {
                self.reward[row] += windows.reward[state] / rules.interval;
                self.terminated[row] |= windows.terminated[state];
                let timed_out = windows.reset[state] && !windows.terminated[state];
                self.mask[row] &= !timed_out;
            }
            between_episodes |= windows.reset[state] || !windows.has_transition[state];
        }
        // What comes after a window's last decision is not known, unless nothing does.
        if self.len() > first {
            let last = self.len() - 1;
            self.mask[last] &= self.terminated[last];
        }
    }

    fn begin_row(&mut self, windows: &Windows, state: usize, first_of_episode: bool) {
        let shape = windows.shape;
        let entities = state * shape.entities..(state + 1) * shape.entities;
        let agents = state * shape.agents..(state + 1) * shape.agents;
        let nobody = vec![NO_TASK; shape.agents];
        let last = if first_of_episode { &nobody } else { &windows.last_allocation[agents] };
        self.states.push(StateView {
            features: &windows.features,
            first_row: entities.start,
            present: &windows.present[entities.clone()],
            entity_task: &windows.entity_task[entities],
            open: &windows.open[state * shape.tasks..][..shape.tasks],
            last_allocation: last,
        });
        self.reward.push(0.0);
        self.terminated.push(false);
        self.mask.push(windows.has_transition[state]);
    }
}

fn age_weight(now: u64, added: u64, rules: &RowRules) -> f32 {
    let age = now.saturating_sub(added) as f32;
    ((rules.age_limit - age) / rules.age_limit).max(0.0)
}
