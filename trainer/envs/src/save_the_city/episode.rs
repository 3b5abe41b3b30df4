//! One running episode: its time, its counts, its rewards and its end.

use super::grid::Ground;
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

/// Counts of one episode, final once it is done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeMetrics {
    /// Steps so far.
    pub steps: u32,
    /// Buildings of the episode.
    pub buildings: u32,
    /// Whether all buildings are complete.
    pub solved: bool,
    /// Whether the time ran out.
    pub timed_out: bool,
    /// Sum of the team's rewards.
    pub episode_return: f64,
    /// Fires put out.
    pub fires_extinguished: u32,
    /// Buildings completed.
    pub buildings_completed: u32,
    /// Buildings lost.
    pub buildings_burned: u32,
    /// Sum of all changes of health.
    pub health_delta: f64,
    pub(super) firefights: KindCount,
    pub(super) builds: KindCount,
}

/// Over (step, building) pairs with at least one agent at work, the kinds that worked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct KindCount {
    pub(super) pairs: u32,
    pub(super) kinds: u32,
}

impl KindCount {
    pub(super) fn add(&mut self, kinds: u8) {
        self.pairs += u32::from(kinds != 0);
        self.kinds += kinds.count_ones();
    }

    fn mean(&self) -> Option<f64> {
        (self.pairs > 0).then(|| f64::from(self.kinds) / f64::from(self.pairs))
    }
}

impl EpisodeMetrics {
    /// Share of the buildings that are complete.
    pub fn proportion_completed(&self) -> f64 {
        f64::from(self.buildings_completed) / f64::from(self.buildings)
    }

    /// Whether no building was lost, which is what the dissertation's text calls success.
    pub fn none_burned(&self) -> bool {
        self.buildings_burned == 0
    }

    /// Mean number of distinct kinds at a fire that anyone fought.
    pub fn types_per_firefight(&self) -> Option<f64> {
        self.firefights.mean()
    }

    /// Mean number of distinct kinds at a building that anyone built.
    pub fn types_per_build(&self) -> Option<f64> {
        self.builds.mean()
    }

    /// All values that the episode has, under the names that reports use.
    pub fn entries(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let flag = |value: bool| Some(f64::from(u8::from(value)));
        [
            ("return", Some(self.episode_return)),
            ("length", Some(f64::from(self.steps))),
            ("solved", flag(self.solved)),
            ("episode_limit", flag(self.timed_out)),
            ("none_burned", flag(self.none_burned())),
            ("prop_buildings_completed", Some(self.proportion_completed())),
            ("fires_extinguished", Some(self.fires_extinguished.into())),
            ("buildings_completed", Some(self.buildings_completed.into())),
            ("buildings_burned", Some(self.buildings_burned.into())),
            ("buildings_health_delta", Some(self.health_delta)),
            ("types_per_firefight", self.types_per_firefight()),
            ("types_per_build", self.types_per_build()),
        ]
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
    }
}
