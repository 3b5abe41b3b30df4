//! Everything that decides how a run of the preset `paper` learns, in one readable file.

use serde::{Deserialize, Serialize};
use sortie_nn::schedule::linear;

use super::allocation::{AllocationLearning, AllocationShape, RowRules};
use super::batch::WindowShape;
use super::exploration::Exploration;
use super::low_level::LowLevelConfig;
use super::low_level::coaching::CoachConfig;
use crate::alma::agents::Conditioning;
use crate::alma::records::{self};
use crate::alma::teams::Allocation;
use sortie_learn::LearnError;
use sortie_learn::configuration::require;
use sortie_learn::session::{EnvironmentChoice, Setup};

/// The configuration of a run. Its defaults are those of the dissertation and its public code.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// What is learned from, which tells this file from others.
    pub learner: Learner,
    /// Where it learns.
    #[serde(skip)]
    pub environment: EnvironmentChoice,
    /// The agents' utilities, their mixer, and how both learn.
    pub low_level: LowLevelConfig,
    /// Who tells agents without subtasks what to do: COPA.
    pub coach: CoachConfig,
    /// Who allocates, and how that is learned.
    pub allocation: AllocationConfig,
    /// How much is tried out.
    pub exploration: ExplorationConfig,
    /// What is kept, and how the weights follow the gradient.
    pub learning: LearningConfig,
}

/// What this preset learns from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Learner {
    /// Windows of whole episodes.
    #[default]
    Windows,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            learner: Learner::Windows,
            environment: EnvironmentChoice::default(),
            low_level: LowLevelConfig::default(),
            coach: CoachConfig::default(),
            allocation: AllocationConfig::default(),
            exploration: ExplorationConfig::default(),
            learning: LearningConfig::default(),
        }
    }
}

/// Who allocates, and how that is learned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AllocationConfig {
    /// `learned`, or the rule `heuristic`, `coordinated` or `random`.
    pub by: String,
    /// Steps between decisions, unless the open tasks change; those of a coach too.
    pub interval: u32,
    /// Allocations that are proposed for a decision.
    pub proposals: usize,
    /// Width of embedding and attention of proposal policy and critic.
    pub width: usize,
    /// Their attention heads.
    pub heads: usize,
    /// Spare subtasks, so that the networks serve worlds with more of them than they learned in.
    pub extra_tasks: usize,
    /// Discount of the critic, once per decision.
    pub discount: f32,
    /// Weight of the proposal policy's entropy.
    pub entropy: f32,
    /// Age in environment steps from which an episode teaches the allocator nothing.
    pub oldest: u64,
    /// Decisions in an update, at most.
    pub rows: usize,
}

impl Default for AllocationConfig {
    fn default() -> Self {
        Self {
            by: "learned".to_owned(),
            interval: 5,
            proposals: 32,
            width: 128,
            heads: 4,
            extra_tasks: 0,
            discount: 0.99,
            entropy: 0.01,
            oldest: 150_000,
            rows: 400,
        }
    }
}

/// A number that falls in a straight line over so many environment steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Before the first step.
    pub start: f32,
    /// From step `steps` on.
    pub end: f32,
    /// Environment steps of the way.
    pub steps: u64,
}

impl Schedule {
    fn at(self, step: u64) -> f32 {
        linear(self.start, self.end, self.steps, step)
    }
}

/// How much is tried out; all three are 0 where a run is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExplorationConfig {
    /// How often an agent takes a random available action.
    pub actions: Schedule,
    /// How often a decision takes the first proposal instead of the critic's best.
    pub proposal: Schedule,
    /// How often an agent is given a random open subtask at a decision.
    pub allocation: Schedule,
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self {
            actions: Schedule { start: 1.0, end: 0.05, steps: 2_000_000 },
            proposal: Schedule { start: 1.0, end: 0.05, steps: 3_000_000 },
            allocation: Schedule { start: 1.0, end: 0.0, steps: 750_000 },
        }
    }
}

impl ExplorationConfig {
    /// What is tried out `step` environment steps into a run.
    pub fn at(&self, step: u64) -> Exploration {
        Exploration {
            actions: self.actions.at(step),
            proposal: self.proposal.at(step),
            allocation: self.allocation.at(step),
        }
    }
}

/// What is kept, and how the weights follow the gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningConfig {
    /// Episodes kept.
    pub episodes: usize,
    /// Episodes drawn and windows cut for an update.
    pub windows: usize,
    /// States of a window.
    pub steps: usize,
    /// Updates for every episode.
    pub updates: usize,
    /// Episodes after which the target of the agents and their mixer is renewed.
    pub copy_agents_every: u64,
    /// Episodes after which the target of the critic is renewed.
    pub copy_critic_every: u64,
}

impl Default for LearningConfig {
    fn default() -> Self {
        Self {
            episodes: 5_000,
            windows: 32,
            steps: 64,
            updates: 1,
            copy_agents_every: 200,
            copy_critic_every: 50,
        }
    }
}

impl Config {
    /// Windows learned from under the conditions of the preset `fast`: its returns, its width, its
    /// exploration, its steps, and as many updates of as many states. COPA's under that preset.
    pub fn like_fast() -> Self {
        let fast = records::Config::default();
        let agents = fast.exploration;
        let schedule = Schedule { start: agents.start, end: agents.end, steps: agents.steps };
        let width = fast.network.width;
        Self {
            low_level: LowLevelConfig {
                width,
                hypernetwork_width: width,
                active_inputs: fast.network.active_inputs,
                skip: fast.network.skip,
                returns: fast.returns,
                ..LowLevelConfig::default()
            },
            exploration: ExplorationConfig {
                actions: schedule,
                proposal: schedule,
                allocation: schedule,
            },
            learning: LearningConfig {
                windows: 16,
                steps: 32,
                updates: 5,
                copy_agents_every: 40,
                copy_critic_every: 10,
                ..LearningConfig::default()
            },
            ..Self::default()
        }
    }

    /// What a setup says.
    ///
    /// # Errors
    /// A value is impossible, or does not go together with others.
    pub fn of(setup: &Setup) -> Result<Self, LearnError> {
        let config = Self { environment: setup.environment.clone(), ..setup.own()? };
        config.check()?;
        Ok(config)
    }

    /// Who allocates.
    pub fn allocation(&self) -> Result<Allocation, LearnError> {
        Allocation::named(&self.allocation.by).ok_or_else(|| {
            let by = &self.allocation.by;
            LearnError::Config(format!(
                "`allocation.by` is `{by}`, not `learned`, `heuristic`, `coordinated` or `random`"
            ))
        })
    }

    /// Whether the run learns an allocator; without subtasks there is nothing to allocate.
    pub fn learns_allocator(&self) -> bool {
        self.low_level.conditioning.has_subtasks()
            && self.allocation.by == Allocation::Learned.name()
    }

    /// Who allocates, by name.
    pub fn measured_allocation(&self) -> &str {
        if self.low_level.conditioning.has_subtasks() { &self.allocation.by } else { "none" }
    }

    /// How the allocator learns in an environment of these sizes.
    pub fn allocation_learning(&self, sizes: WindowShape) -> AllocationLearning {
        let allocation = &self.allocation;
        AllocationLearning {
            shape: AllocationShape {
                features: sizes.features,
                columns: sizes.tasks + allocation.extra_tasks,
                width: allocation.width,
                heads: allocation.heads,
            },
            proposals: allocation.proposals,
            rows: RowRules {
                interval: allocation.interval as f32,
                most: allocation.rows,
                age_limit: allocation.oldest as f32,
            },
            discount: allocation.discount.into(),
            entropy: allocation.entropy.into(),
            learning_rate: self.low_level.learning_rate,
            gradient_norm: self.low_level.clip,
            as_public_code: false,
        }
    }

    /// Has a coach tell agents without subtasks what to do: COPA.
    pub fn enable_coach(&mut self) {
        self.low_level.conditioning = Conditioning::None;
        self.coach.enabled = true;
    }

    /// Refuses values that do not go together.
    fn check(&self) -> Result<(), LearnError> {
        let Self { low_level, allocation, learning, .. } = self;
        require(
            low_level.width.is_multiple_of(low_level.heads),
            "`low_level.width` must be a multiple of `low_level.heads`",
        )?;
        require(
            low_level.hypernetwork_width.is_multiple_of(low_level.hypernetwork_heads),
            "`low_level.hypernetwork_width` must be a multiple of `low_level.hypernetwork_heads`",
        )?;
        require(
            !self.coach.enabled
                || (low_level.conditioning == Conditioning::None && !low_level.recurrent),
            "agents with a coach have no subtasks and no memory: `low_level.conditioning` must be `none`, \
             `.recurrent` false",
        )?;
        require(
            allocation.width.is_multiple_of(allocation.heads),
            "`allocation.width` must be a multiple of `allocation.heads`",
        )?;
        require(
            learning.episodes >= learning.windows,
            "`learning.episodes` must be at least `learning.windows`",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exploration_falls_to_its_ends() {
        let exploration = ExplorationConfig::default();
        assert_eq!(exploration.at(0), Exploration { actions: 1.0, proposal: 1.0, allocation: 1.0 });
        let late = Exploration { actions: 0.05, proposal: 0.05, allocation: 0.0 };
        assert_eq!(exploration.at(3_000_000), late);
    }
}
