//! One running episode: its time, its counts, its rewards and its end.

use super::grid::Ground;
use super::metrics::EpisodeMetrics;
use super::rules::{ACTIONS, Change, Constants};
use super::state::{AgentState, BuildingState, City, Status};
use crate::environment::{Step, StepError};

/// What an instance has once.
#[derive(Clone, Debug)]
pub(super) struct Episode {
    pub(super) agents: usize,
    pub(super) buildings: usize,
    pub(super) scenario: usize,
    pub(super) ground: Ground,
    pub(super) open_tasks: u32,
    pub(super) done: bool,
    pub(super) bounces: usize,
    pub(super) metrics: EpisodeMetrics,
}

impl Episode {
    /// Refuses actions that are missing or not available.
    pub(super) fn check_actions(
        &self,
        agents: &[AgentState],
        actions: &[u16],
    ) -> Result<(), StepError> {
        if self.done {
            return Err(StepError::EpisodeOver);
        }
        if actions.len() < agents.len() {
            return Err(StepError::TooFewActions { agents: agents.len(), actions: actions.len() });
        }
        for (index, (agent, &action)) in agents.iter().zip(actions).enumerate() {
            if usize::from(action) >= ACTIONS || agent.available >> action & 1 == 0 {
                return Err(StepError::Unavailable { agent: index, action });
            }
        }
        Ok(())
    }

    /// Advances the time, the counts and the open tasks, and decides whether the episode is over.
    pub(super) fn advance(
        &mut self,
        constants: &Constants,
        buildings: &[BuildingState],
        changes: &[Change],
    ) -> Step {
        let metrics = &mut self.metrics;
        metrics.steps += 1;
        for change in changes {
            metrics.fires_extinguished += u32::from(change.extinguished);
            metrics.buildings_completed += u32::from(change.completed);
            metrics.buildings_burned += u32::from(change.burned);
            metrics.health_delta += change.health_delta;
        }
        let open_before = self.open_tasks;
        self.open_tasks = City { agents: &[], buildings }.open_tasks();

        let (terminated, timed_out) = self.judge(constants, buildings);
        Step { reward: 0.0, terminated, timed_out, tasks_changed: self.open_tasks != open_before }
    }
}

impl Episode {
    /// Decides whether the episode is over, and how.
    fn judge(&mut self, constants: &Constants, buildings: &[BuildingState]) -> (bool, bool) {
        let all_complete = buildings.iter().all(|building| building.status == Status::Complete);
        let any_burned = buildings.iter().any(|building| building.status == Status::BurnedDown);
        let terminated = self.open_tasks == 0 || (constants.end_on_any_burn && any_burned);
        let timed_out = !terminated && self.metrics.steps >= constants.episode_limit;
        self.done = terminated || timed_out;
        self.metrics.solved = all_complete;
        self.metrics.timed_out = timed_out;
        (terminated, timed_out)
    }

    /// Goes on with what had been counted.
    pub(super) fn resume(
        &mut self,
        constants: &Constants,
        buildings: &[BuildingState],
        counted: EpisodeMetrics,
    ) {
        self.metrics = EpisodeMetrics { buildings: buildings.len() as u32, ..counted };
        self.judge(constants, buildings);
    }
}

/// Writes every task's reward and returns the team's.
pub(super) fn rewards(
    constants: &Constants,
    changes: &[Change],
    solved: bool,
    max_reward: f64,
    task_rewards: &mut [f64],
) -> f64 {
    let flag = |value: bool| f64::from(u8::from(value));
    let scaled = |reward: f64| (reward * constants.reward_scale) / max_reward;
    let mut total = constants.ts_pen;
    for (change, task_reward) in changes.iter().zip(task_rewards) {
        let shared = 0.0
            + constants.health_delta_mult * change.health_delta
            + constants.burned_down * flag(change.burned)
            + constants.extinguish * flag(change.extinguished);
        total += shared + constants.complete * flag(change.completed);
        let own = shared + constants.solved * flag(change.completed);
        *task_reward = scaled((0.0 + own) + constants.ts_pen);
    }
    if solved {
        total += constants.solved;
    }
    scaled(total)
}
