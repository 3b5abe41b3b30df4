//! What a run of HAL leaves open.

use serde::{Deserialize, Serialize};
use sortie_learn::configuration::OptimiserConfig;
use sortie_nn::schedule::linear;

/// Sizes, chances and rates; the default is the preset `fast` of HAL.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What the networks are shown, and how wide they are.
    pub network: NetworkConfig,
    /// Which milestones can be gone for.
    pub affordances: AffordancesConfig,
    /// How the controller's rewards become targets.
    pub returns: ReturnsConfig,
    /// How the meta-controller's do.
    pub meta: MetaConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How much is tried out.
    pub exploration: ExplorationConfig,
    /// What is left to chance where agents are measured, and what they do instead.
    pub measured: MeasuredConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
}

/// What the networks are shown, and how wide they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Cells of the picture around its middle, each way across, that are shown one by one; odd.
    pub crop: usize,
    /// Whether the nearest cell of every channel is shown.
    pub nearest: bool,
    /// Width of the two hidden layers of each network.
    pub width: usize,
    /// Inputs that differ from zero, which the first weights are sized for.
    pub active_inputs: usize,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self { crop: 5, nearest: true, width: 64, active_inputs: 30 }
    }
}

/// Where the mask of milestones comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mask {
    /// A classifier that learns from what options came to.
    #[default]
    Learned,
    /// The truth.
    Oracle,
    /// All milestones, always.
    None,
}

/// Which milestones can be gone for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AffordancesConfig {
    /// Where the mask comes from.
    pub mask: Mask,
    /// Likelihood from which on a milestone counts as afforded.
    pub threshold: f32,
    /// Whether negatives that look like positives are left out.
    pub filter: bool,
    /// Updates of the controller for each of the classifier.
    pub every: u64,
    /// States that are kept of each milestone and class.
    pub kept: usize,
    /// Triplets that shape the embedding in an update.
    pub triplets: usize,
    /// How far apart neighbours in time are, the deviation of a normal distribution.
    pub spread: f32,
    /// States of each milestone in an update.
    pub batch: usize,
    /// Positives on each side that tell how far apart positives are.
    pub population: usize,
}

impl Default for AffordancesConfig {
    fn default() -> Self {
        Self {
            mask: Mask::Learned,
            threshold: 0.5,
            filter: true,
            every: 4,
            kept: 50_000,
            triplets: 64,
            spread: 7.0,
            batch: 32,
            population: 300,
        }
    }
}

/// How the controller's rewards become targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReturnsConfig {
    /// Steps after which an option is over without a milestone.
    pub option_steps: u8,
    /// Steps of reward before a value is looked up.
    pub steps: u8,
    /// Discount per step.
    pub discount: f32,
    /// Whether what an option reached is learned from as if it had been its goal.
    pub relabel: bool,
    /// Whether actions that change nothing are worth nothing.
    pub no_operations: bool,
    /// Whether states are shown left for right half of the time.
    pub mirror: bool,
}

impl Default for ReturnsConfig {
    fn default() -> Self {
        Self {
            option_steps: 51,
            steps: 3,
            discount: 0.93,
            relabel: true,
            no_operations: true,
            mirror: true,
        }
    }
}

/// How the meta-controller's rewards become targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MetaConfig {
    /// Options before a value is looked up.
    pub options: usize,
    /// Discount per option.
    pub discount: f32,
    /// Discount per environment step of an option, besides.
    pub step_discount: f32,
    /// Options of an update.
    pub batch: usize,
    /// Share of them that is drawn from episodes that were solved.
    pub solved: f32,
}

impl Default for MetaConfig {
    fn default() -> Self {
        Self { options: 10, discount: 0.98, step_discount: 0.995, batch: 128, solved: 0.3 }
    }
}

/// What is kept and how much of it an update sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    /// Steps that are kept, of all instances.
    pub capacity: usize,
    /// Steps of an update of the controller.
    pub batch: usize,
    /// Share of them that is drawn from options that reached a milestone, every milestone as often.
    pub reached: f32,
    /// Environment steps for each update.
    pub steps_per_update: u64,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self { capacity: 5_200_000, batch: 256, reached: 0.5, steps_per_update: 256 }
    }
}

/// How much is tried out. Chances go in a straight line from the first to the second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExplorationConfig {
    /// Environment steps in which everything is drawn.
    pub first: u64,
    /// Share of the run that chances change over.
    pub share: f64,
    /// Chance of a random action.
    pub actions: [f32; 2],
    /// Chance of any milestone as a goal.
    pub goals: [f32; 2],
    /// Chance of a goal that is drawn from the mask, those that were seldom reached more often.
    pub afforded: [f32; 2],
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self {
            first: 6_400,
            share: 0.8,
            actions: [0.5, 0.05],
            goals: [0.2, 0.05],
            afforded: [0.8, 0.2],
        }
    }
}

impl ExplorationConfig {
    /// A chance after so many of all environment steps.
    pub fn at(&self, [start, end]: [f32; 2], step: u64, of: u64) -> f32 {
        linear(start, end, (self.share * of as f64) as u64, step)
    }
}

/// What is left to chance where agents are measured, and what they do instead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredConfig {
    /// Chance of a random action.
    pub actions: f32,
    /// Chance of a random goal, from the mask where there is one.
    pub goals: f32,
    /// Whether what is met again is answered otherwise: the same view within an option by the next best action, a mask
    /// since the last milestone by a goal that was missed less often. It needs no chance.
    pub varied: bool,
}

impl Default for MeasuredConfig {
    fn default() -> Self {
        Self { actions: 0.05, goals: 0.05, varied: true }
    }
}
