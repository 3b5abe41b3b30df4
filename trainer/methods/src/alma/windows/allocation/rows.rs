//! What the high level learns from: one row for every decision point of the windows.

use super::super::batch::{NO_TASK, Windows};
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

#[cfg(test)]
mod tests {
    use super::super::super::batch::WindowShape;
    use super::*;

    const RULES: RowRules = RowRules { interval: 2.0, most: 400, age_limit: 100.0 };

    /// One window of eight steps that each earn 1, with decisions at these steps.
    fn window(decisions: &[usize]) -> Windows {
        let mut windows = Windows::new(WindowShape {
            windows: 1,
            steps: 8,
            agents: 1,
            entities: 1,
            tasks: 1,
            actions: 1,
            features: 1,
        });
        windows.has_transition[..7].fill(true);
        windows.reward.fill(1.0);
        windows.last_allocation.fill(0);
        decisions.iter().for_each(|step| windows.decision[*step] = true);
        windows
    }

    /// Ends an episode in a step; the final observation follows.
    fn end(windows: &mut Windows, step: usize, terminated: bool) {
        (windows.reset[step], windows.terminated[step]) = (true, terminated);
        windows.has_transition[step + 1] = false;
        windows.reward[step + 1] = 0.0;
    }

    fn rows(windows: &Windows) -> Rows {
        let mut rows = Rows::default();
        rows.collect(windows, 1_000, &RULES);
        rows
    }

    #[test]
    fn rewards_are_summed_between_decisions() {
        let rows = rows(&window(&[1, 3, 6]));
        assert_eq!(rows.reward, [1.0, 1.5, 1.0]);
        assert_eq!(rows.mask, [true, true, false]);
    }

    #[test]
    fn a_true_end_is_learned_from_and_a_time_out_is_not() {
        for terminated in [true, false] {
            let mut windows = window(&[0, 2, 5]);
            end(&mut windows, 3, terminated);
            let rows = rows(&windows);
            assert_eq!(rows.terminated, [false, terminated, false]);
            assert_eq!(rows.mask, [true, terminated, false]);
            assert_eq!(rows.reward[1], 1.0);
        }
    }

    #[test]
    fn the_last_decision_counts_if_the_episode_truly_ended() {
        let mut windows = window(&[0, 3]);
        end(&mut windows, 5, true);
        assert_eq!(rows(&windows).mask, [true, true]);
    }

    #[test]
    fn nobody_has_an_allocation_before_an_episode_s_first_decision() {
        let mut windows = window(&[0, 2, 5, 6]);
        end(&mut windows, 3, true);
        let rows = rows(&windows);
        let last: Vec<u8> = (0..4).map(|row| rows.states.last_allocation(row)[0]).collect();
        assert_eq!(last, [0, 0, NO_TASK, 0]);
    }

    #[test]
    fn rows_count_less_with_age_and_no_more_than_some_are_kept() {
        let mut windows = window(&[0, 2, 4]);
        windows.added = vec![1_000, 1_000, 950, 950, 100, 100, 100, 100];
        assert_eq!(rows(&windows).weight, [1.0, 0.5, 0.0]);
        let mut rows = Rows::default();
        rows.collect(&windows, 1_000, &RowRules { most: 2, ..RULES });
        assert_eq!((rows.len(), rows.mask.as_slice()), (2, [true, true].as_slice()));
    }
}
