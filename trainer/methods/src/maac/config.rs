//! What a run of MAAC leaves open.

use serde::{Deserialize, Serialize};

/// Sizes, chances and rates; the default is the preset `fast`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Policies and critic.
    pub network: NetworkConfig,
    /// How rewards become targets.
    pub returns: ReturnsConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How much chance in the choice of actions is worth.
    pub entropy: EntropyConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
    /// What an update computes.
    pub update: UpdateConfig,
}

/// Policies and critic.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Width of the critic's layers.
    pub critic_width: usize,
    /// Width of the policies' layers.
    pub policy_width: usize,
    /// Attention heads.
    pub heads: usize,
    /// What the others count in the critic.
    pub attention: Attention,
    /// Whether agents of a role share their networks.
    pub shared: bool,
    /// Whether agents that share are told which of them they are.
    pub identity: bool,
    /// Whether inputs are normalised over the batch; otherwise they are multiplied.
    pub normalised: bool,
    /// What inputs that are not normalised are multiplied with.
    pub input_scale: f32,
}

/// What the others count in the critic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Attention {
    /// What the critic learns that they count (MAAC).
    Learned,
    /// All the same (MAAC (Uniform)).
    Uniform,
}

/// How rewards become targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReturnsConfig {
    /// Decisions of reward before a value is looked up.
    pub steps: usize,
    /// Discount per environment step.
    pub discount: f32,
    /// Environment steps that an action is held for while learning.
    pub decision_interval: usize,
    /// Scale of the potential that shapes rewards; 0: rewards as they are.
    pub shaping: f32,
}

/// What is kept and how much of it an update sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    /// Decisions that are kept, of all instances.
    pub capacity: usize,
    /// Decisions before the first update.
    pub first: usize,
    /// Decisions that an update sees.
    pub batch: usize,
    /// Environment steps from one period of updates to the next.
    pub steps_per_period: u64,
    /// Updates of a period.
    pub updates_per_period: u64,
}

/// How much chance in the choice of actions is worth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EntropyConfig {
    /// At first.
    pub start: f32,
    /// After `steps`, and from there on.
    pub end: f32,
    /// Environment steps in which it falls, by the same factor each.
    pub steps: u64,
}

/// How the weights follow the gradient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Step size of the critic.
    pub critic_rate: f32,
    /// Step size of the policies.
    pub policy_rate: f32,
    /// Share of the way that targets move in an update.
    pub target_rate: f32,
    /// Share of the way that the weights that are measured move in an update.
    pub average_rate: f32,
    /// What a critic's weight adds to its gradient.
    pub weight_decay: f32,
    /// Largest norm of the critic's gradient, for each agent.
    pub critic_clip: f32,
    /// Largest norm of the gradient of a policy.
    pub policy_clip: f32,
    /// Added to Adam's denominator.
    pub epsilon: f32,
    /// Whether that is added before the correction of the first steps, as PyTorch did until version 1.2.
    pub early_epsilon: bool,
}

/// What an update computes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UpdateConfig {
    /// How an agent's own action counts in targets and policies.
    pub own_actions: OwnActions,
    /// Which values policies learn from.
    pub policy_values: PolicyValues,
    /// What the mean squared score of an action counts.
    pub score_penalty: f32,
    /// What the mean squared score of attention counts.
    pub attention_penalty: f32,
}

/// How an agent's own action counts in targets and policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OwnActions {
    /// All of them, by their chances.
    Expected,
    /// One that is drawn.
    Drawn,
}

/// Which values policies learn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PolicyValues {
    /// Those that the critic's own update computed, for the others' actions of then.
    Kept,
    /// Those of the updated critic for actions that all draw now.
    Fresh,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: NetworkConfig {
                critic_width: 64,
                policy_width: 64,
                heads: 4,
                attention: Attention::Learned,
                shared: true,
                identity: true,
                normalised: false,
                input_scale: 1.0,
            },
            returns: ReturnsConfig { steps: 3, discount: 0.95, decision_interval: 1, shaping: 0.0 },
            replay: ReplayConfig {
                capacity: 24_000,
                first: 4_000,
                batch: 128,
                steps_per_period: 64,
                updates_per_period: 1,
            },
            entropy: EntropyConfig { start: 0.03, end: 0.03, steps: 0 },
            optimiser: OptimiserConfig {
                critic_rate: 0.002,
                policy_rate: 0.001,
                target_rate: 0.03,
                average_rate: 0.01,
                weight_decay: 0.0,
                critic_clip: 10.0,
                policy_clip: 0.5,
                epsilon: 1e-8,
                early_epsilon: false,
            },
            update: UpdateConfig {
                own_actions: OwnActions::Expected,
                policy_values: PolicyValues::Kept,
                score_penalty: 0.001,
                attention_penalty: 0.001,
            },
        }
    }
}

impl Config {
    /// The preset `paper`: the published settings.
    pub fn paper() -> Self {
        let fast = Self::default();
        Self {
            network: NetworkConfig {
                critic_width: 128,
                policy_width: 128,
                shared: false,
                identity: false,
                normalised: true,
                ..fast.network
            },
            returns: ReturnsConfig { steps: 1, discount: 0.99, ..fast.returns },
            replay: ReplayConfig {
                capacity: 1_000_000,
                first: 1_024,
                batch: 1_024,
                steps_per_period: 100,
                updates_per_period: 4,
            },
            entropy: EntropyConfig { start: 0.01, end: 0.01, steps: 0 },
            optimiser: OptimiserConfig {
                critic_rate: 0.001,
                target_rate: 0.001,
                average_rate: 1.0,
                weight_decay: 0.001,
                early_epsilon: true,
                ..fast.optimiser
            },
            update: UpdateConfig {
                own_actions: OwnActions::Drawn,
                policy_values: PolicyValues::Fresh,
                ..fast.update
            },
        }
    }
}

impl EntropyConfig {
    /// What it is worth after so many environment steps.
    pub fn at(&self, env_steps: u64) -> f32 {
        if env_steps >= self.steps {
            return self.end;
        }
        let share = env_steps as f32 / self.steps as f32;
        self.start * (self.end / self.start).powf(share)
    }
}
