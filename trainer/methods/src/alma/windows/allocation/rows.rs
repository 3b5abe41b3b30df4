//! What the high level learns from: one row for every decision point of the windows, and the states in which agents are to
//! be allocated.

use sortie_envs::Observation;
use sortie_nn::layers::SparseRows;

use super::AllocationShape;
use crate::alma::windows::config::AllocationConfig;
use crate::alma::windows::{NO_TASK, WindowShape, Windows};

/// What counts of agents and of other entities are multiplied by.
pub(in crate::alma::windows) const COUNT_SCALE: f32 = 0.2;

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
    pub fn collect(&mut self, windows: &Windows, now: u64, config: &AllocationConfig) {
        let shape = windows.shape;
        self.states = States::new(shape.agents, shape.entities, shape.tasks);
        self.reward.clear();
        self.terminated.clear();
        self.mask.clear();
        self.weight.clear();
        for window in 0..shape.windows {
            self.collect_window(windows, window, now, config);
        }
    }

    fn collect_window(
        &mut self,
        windows: &Windows,
        window: usize,
        now: u64,
        config: &AllocationConfig,
    ) {
        let steps = window * windows.shape.steps..(window + 1) * windows.shape.steps;
        let first = self.len();
        // After the end of an episode nobody has an allocation until the next episode's first decision.
        let mut between_episodes = false;
        for state in steps {
            if windows.decision[state] {
                if self.len() == config.rows {
                    return;
                }
                self.begin_row(windows, state, between_episodes);
                self.weight.push(age_weight(now, windows.added[state], config));
                between_episodes = false;
            }
            if let Some(row) = self.len().checked_sub(1).filter(|row| *row >= first) {
                self.reward[row] += windows.reward[state] / config.interval as f32;
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
        let agents = windows.shape.agents;
        let nobody = vec![NO_TASK; agents];
        let before = &windows.last_allocation[state * agents..][..agents];
        self.states.push(windows, state, if first_of_episode { &nobody } else { before });
        self.reward.push(0.0);
        self.terminated.push(false);
        self.mask.push(windows.has_transition[state]);
    }
}

fn age_weight(now: u64, added: u64, config: &AllocationConfig) -> f32 {
    let age = now.saturating_sub(added) as f32;
    let limit = config.oldest as f32;
    ((limit - age) / limit).max(0.0)
}

/// Any number of states of the same sizes, row-major with the states in front.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct States {
    pub(super) agents: usize,
    pub(super) entities: usize,
    pub(super) tasks: usize,
    pub(super) features: SparseRows,
    pub(super) present: Vec<bool>,
    pub(super) entity_task: Vec<u8>,
    pub(super) open: Vec<bool>,
    pub(super) last_allocation: Vec<u8>,
}

impl States {
    /// No states yet, of A agents among N entities and T subtasks.
    pub fn new(agents: usize, entities: usize, tasks: usize) -> Self {
        Self { agents, entities, tasks, ..Self::default() }
    }

    /// Adds a state of some windows, with the allocation `[A]` that was in force before, all [`NO_TASK`] at the beginning of an
    /// episode. Panics if it has other sizes.
    pub fn push(&mut self, windows: &Windows, state: usize, last_allocation: &[u8]) {
        let WindowShape { entities, tasks, .. } = windows.shape;
        assert_eq!((entities, tasks), (self.entities, self.tasks), "entities and subtasks");
        assert_eq!(last_allocation.len(), self.agents, "agents");
        let rows = state * entities..(state + 1) * entities;
        for row in rows.clone() {
            self.features.push_row(&windows.features, row);
            self.features.end_row();
        }
        self.present.extend_from_slice(&windows.present[rows.clone()]);
        self.entity_task.extend_from_slice(&windows.entity_task[rows]);
        self.open.extend_from_slice(&windows.open[state * tasks..][..tasks]);
        self.last_allocation.extend_from_slice(last_allocation);
    }

    /// Adds a state of which everything was observed, with the allocation `[A]` that was in force before. Panics if it
    /// has other sizes; of its subtasks, those that exist count.
    pub fn push_seen(&mut self, seen: &Observation, last_allocation: &[u8]) {
        assert_eq!(seen.entity_task.len(), self.entities, "entities");
        assert_eq!(last_allocation.len(), self.agents, "agents");
        for entity in 0..self.entities {
            let exists = seen.present >> entity & 1 == 1;
            if exists {
                self.features.push_row(&seen.rows, seen.row_of(entity));
            }
            self.features.end_row();
            self.present.push(exists);
            self.entity_task.push(seen.task_of(entity));
        }
        self.open.extend((0..self.tasks).map(|task| seen.open_tasks >> task & 1 == 1));
        self.last_allocation.extend_from_slice(last_allocation);
    }

    /// How many states there are.
    pub(crate) fn len(&self) -> usize {
        self.open.len() / self.tasks.max(1)
    }

    /// The allocation `[A]` that stands in a state.
    pub fn allocation(&self, state: usize) -> &[u8] {
        &self.entity_task[state * self.entities..][..self.agents]
    }

    pub(super) fn present(&self, state: usize) -> &[bool] {
        &self.present[state * self.entities..][..self.entities]
    }

    pub(super) fn entity_task(&self, state: usize) -> &[u8] {
        &self.entity_task[state * self.entities..][..self.entities]
    }

    pub(super) fn open(&self, state: usize) -> &[bool] {
        &self.open[state * self.tasks..][..self.tasks]
    }

    pub(super) fn last_allocation(&self, state: usize) -> &[u8] {
        &self.last_allocation[state * self.agents..][..self.agents]
    }

    /// Entities of a task that are no agents, present or not.
    pub(super) fn others(&self, state: usize, task: u8) -> usize {
        let others = &self.entity_task(state)[self.agents..];
        others.iter().filter(|of| **of == task).count()
    }
}

/// States as a network is shown them.
#[derive(Clone, Copy)]
pub(super) struct Shown<'a> {
    pub(super) shape: AllocationShape,
    pub(super) states: &'a States,
    /// `[T]`: the column of each subtask.
    pub(super) columns: &'a [u8],
}

impl Shown<'_> {
    /// Writes an entity's features, and marks that it belongs to a subtask; returns whether it belongs to one.
    pub(super) fn begin_row(
        self,
        state: usize,
        entity: usize,
        task: u8,
        rows: &mut SparseRows,
    ) -> bool {
        rows.push_row(&self.states.features, state * self.states.entities + entity);
        let column = self.columns.get(usize::from(task));
        column.inspect(|column| rows.push(self.shape.features + usize::from(**column), 1.0));
        column.is_some()
    }
}

/// Agents that an allocation gives to a task.
pub(super) fn team_size(allocation: &[u8], task: u8) -> usize {
    allocation.iter().filter(|of| **of == task && task != NO_TASK).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_learn::networks::Targets;

    fn rules() -> AllocationConfig {
        AllocationConfig { interval: 2, rows: 400, oldest: 100, ..AllocationConfig::default() }
    }

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
            targets: Targets::NONE,
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
        rows.collect(windows, 1_000, &rules());
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
        rows.collect(&windows, 1_000, &AllocationConfig { rows: 2, ..rules() });
        assert_eq!((rows.len(), rows.mask.as_slice()), (2, [true, true].as_slice()));
    }
}
