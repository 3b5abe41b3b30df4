//! Value factorisation: A-QMIX, VDN and REFIL with its oracles (dissertation chapter 5).
//!
//! Agents share one network; a mixer makes the value of the team from the utilities of their chosen
//! actions, so that both learn from the team's reward. REFIL learns besides from imagined utilities, for
//! which each agent sees only its part of a random partition, or only the rest: a partition says for each
//! agent which entities are in its part (dissertation section 5.4).

mod loss;
mod method;
mod presets;
#[cfg(test)]
mod tests;

use sortie_envs::random::{chance, unit};
use sortie_envs::{EntitySet, Random, Shape, Spec};
use sortie_learn::configuration::Range::{self, OneOf, Positive, Truth, Whole};
use sortie_learn::configuration::{
    EXPLORATION, ExplorationConfig, OPTIMISER, OptimiserConfig, SHARE,
};
use sortie_learn::learner::Rule;
use sortie_learn::networks::{
    AgentShape, AimedHead, Hypernetworks, LookShape, MixerKind, MixerShape, WeightsSum,
};
use sortie_learn::{sections, words};
use sortie_nn::layers::split_attention::HEADS;

pub use loss::{Lesson, Losses, NetworkShape, Networks};
pub use method::ValueFactorisation;
pub use presets::{QMIX, REFIL, VDN};

const SIZE: i64 = 20_000_000;
const COLUMNS: Range = Whole(0, 1024);

sections! {
    /// Sizes, chances and rates; the default is the preset `fast` of A-QMIX.
    Config, KEYS;

    /// The agents' network, and the hypernetwork of the mixer.
    network: NetworkConfig {
        /// Width of embedding and attention: 16, 32, 64 or 128.
        width: usize = 32, Whole(16, 128), "columns";
        /// Non-zero inputs that the first weights are sized for, as rows are mostly zeros; 0: all columns.
        active_inputs: usize = 3, COLUMNS, "columns";
        /// Whether an agent's own embedding reaches the layer before the head, past the attention.
        skip: bool = true, Truth;
        /// Width of what agents remember in a gated recurrent unit, which needs `replay.unit=episodes`; 0: nothing.
        #[serde(default)]
        memory: usize = 0, COLUMNS, "columns";
        /// What values actions that are aimed at entities: a vector that points at their embeddings, or weights of each
        /// action's own, for which an entity is its number.
        #[serde(default)]
        head: AimedHead = AimedHead::Pointing, OneOf(AimedHead::WORDS);
    }

    /// How the utilities of a team become its value.
    mixer: MixerConfig {
        /// Their sum (VDN), a weighted sum and a value of the state, or two layers with non-negative weights (QMIX).
        kind: MixerKind = MixerKind::Linear, OneOf(MixerKind::WORDS);
        /// Whether one network makes all numbers that are mixed with, or one each kind: weights, biases, value.
        #[serde(default)]
        hypernetworks: Hypernetworks = Hypernetworks::Shared, OneOf(Hypernetworks::WORDS);
        /// Width between the layers of `qmix`.
        mixing: usize = 32, Whole(1, 1024), "columns";
        /// What the weights of `linear` add up to: one, or the number of agents.
        #[serde(default)]
        weights_sum: WeightsSum = WeightsSum::One, OneOf(WeightsSum::WORDS);
    }

    /// Utilities of agents that see only their part of a partition, or only the rest, mixed to the same value.
    imagination: ImaginationConfig {
        /// None, drawn anew for every use of a state (REFIL), who truly belongs together (fixed oracle), or both
        /// (randomised oracle).
        partitions: Partitions = Partitions::None, OneOf(Partitions::WORDS);
        /// What imagined values count.
        share: f32 = 0.5, SHARE, "share of the loss";
    }

    /// How rewards become targets.
    returns: ReturnsConfig {
        /// Steps before a target bootstraps.
        steps: usize = 3, Whole(1, 1000), "steps";
        /// Worth of a reward one step later.
        discount: f32 = 0.9, SHARE, "factor per step";
        /// What rewards are multiplied by, so that those of a step are not small against what weights are worth at first.
        #[serde(default = "as_it_is")]
        scale: f32 = 1.0, Positive(1e6), "factor";
    }

    /// What is kept, and how much of it an update sees.
    replay: ReplayConfig {
        /// What is kept and drawn: single states with what followed them, or whole episodes.
        #[serde(default)]
        unit: Unit = Unit::Steps, OneOf(Unit::WORDS);
        /// Kept, of all instances.
        capacity: usize = 200_000, Whole(1, SIZE), "units";
        /// In an update.
        batch: usize = 256, Whole(1, 65_536), "units";
        /// Steps from one update to the next; 0: an update for each episode that ends.
        steps_per_update: u64 = 16, Whole(0, SIZE), "environment steps";
        /// Whether what is drawn is learned from as one of the environment's symmetries shows it, drawn at random.
        #[serde(default)]
        symmetries: bool = true, Truth;
    }

    /// How often agents take a random available action.
    exploration: ExplorationConfig =
        ExplorationConfig { steps: 5_000, ..ExplorationConfig::default() }, EXPLORATION;

    /// How the weights follow the gradient.
    optimiser: OptimiserConfig = OptimiserConfig {
        learning_rate: 3e-3,
        decay_from: 0.6,
        average_rate: 0.001,
        ..OptimiserConfig::default()
    }, OPTIMISER;

    /// What follows the gradient, and the weights.
    #[serde(default)]
    update: UpdateConfig {
        /// How weights follow the gradient. RMSprop has a decay of 0.99 and adds 1e-5 to its denominator.
        rule: Rule = Rule::Adam, OneOf(Rule::WORDS);
        /// Updates from one move of the target network to the next.
        target_every: u64 = 1, Whole(1, SIZE), "updates";
    }
}

/// The scale of rewards in runs of before there was one.
fn as_it_is() -> f32 {
    1.0
}

words! {
    /// What is kept, and drawn for an update.
    #[derive(Default)]
    Unit {
        /// States, each with what followed it.
        #[default]
        Steps = "steps",
        /// Whole episodes.
        Episodes = "episodes",
    }
}

words! {
    /// Where the partitions of imagined utilities come from.
    Partitions {
        /// Nothing is imagined (A-QMIX, VDN).
        None = "none",
        /// Drawn for every use of a state (REFIL): `p` uniform, then each entity with probability `p`.
        Drawn = "drawn",
        /// Who truly belongs together, as the environment knows (fixed oracle).
        Companions = "companions",
        /// Who truly belongs together and shares the drawn part (randomised oracle).
        DrawnCompanions = "drawn-companions",
    }
}

impl Partitions {
    /// Whether anything is imagined.
    pub fn imagines(self) -> bool {
        self != Self::None
    }

    /// Whether it is about who truly belongs together.
    pub fn needs_companions(self) -> bool {
        matches!(self, Self::Companions | Self::DrawnCompanions)
    }

    /// Draws one part of so many entities, as bits, where the partition is one that is drawn.
    pub fn draw(self, entities: usize, random: &mut Random) -> EntitySet {
        if matches!(self, Self::None | Self::Companions) {
            return 0;
        }
        let probability = unit(random);
        (0..entities)
            .fold(0, |part, entity| part | EntitySet::from(chance(random, probability)) << entity)
    }

    /// The entities in the part of one agent, given the drawn part and the agent's companions.
    pub fn within(self, part: EntitySet, companions: EntitySet, agent: usize) -> EntitySet {
        let drawn = if part >> agent & 1 == 1 { part } else { !part };
        match self {
            Self::None => EntitySet::MAX,
            Self::Drawn => drawn,
            Self::Companions => companions,
            Self::DrawnCompanions => drawn & companions,
        }
    }
}

impl Config {
    /// The preset `paper` of A-QMIX: the dissertation's, as its chapter 5 learns Group Matching.
    pub fn paper() -> Self {
        let mut paper = Self::default();
        let Self { network, mixer, returns, replay, exploration, optimiser, update, .. } =
            &mut paper;
        (network.width, network.active_inputs, network.skip) = (64, 0, false);
        mixer.hypernetworks = Hypernetworks::Separate;
        (returns.steps, returns.discount) = (1, 0.99);
        (replay.unit, replay.capacity, replay.batch) = (Unit::Episodes, 2_000, 32);
        (replay.steps_per_update, replay.symmetries) = (0, false);
        exploration.spread = vec![1.0];
        (optimiser.learning_rate, optimiser.learning_rate_end) = (5e-4, 5e-4);
        (optimiser.decay_from, optimiser.clip) = (1.0, 10.0);
        (optimiser.target_rate, optimiser.average_rate) = (1.0, 1.0);
        (update.rule, update.target_every) = (Rule::RmsProp, 200);
        paper
    }

    /// The preset `fast` where actions are aimed at entities, as in battles.
    ///
    /// Fights are long: a discount as in Group Matching makes a team that hits early and loses.
    pub fn aimed() -> Self {
        let mut aimed = Self::default();
        let Self { network, mixer, returns, replay, exploration, optimiser, .. } = &mut aimed;
        // Half the width learns to advance, and hardly whom to shoot at together.
        (network.width, network.active_inputs) = (128, 0);
        mixer.weights_sum = WeightsSum::Agents;
        (returns.steps, returns.discount) = (1, 0.97);
        replay.batch = 128;
        exploration.steps = 30_000;
        (optimiser.learning_rate, optimiser.learning_rate_end) = (1e-3, 5e-5);
        (optimiser.decay_from, optimiser.target_rate) = (0.4, 0.01);
        optimiser.average_rate = 0.002;
        aimed
    }

    /// The networks for an environment.
    pub fn shape(&self, spec: &Spec) -> NetworkShape {
        let NetworkConfig { width, active_inputs, skip, memory, head } = self.network;
        let MixerConfig { kind, hypernetworks, mixing, weights_sum } = self.mixer;
        let Shape { features: input, actions, .. } = spec.shape;
        let active_inputs = if active_inputs == 0 { input } else { active_inputs };
        let looking = LookShape { input, active_inputs, width, heads: HEADS };
        NetworkShape {
            agent: AgentShape { looking, actions, skip, memory, targets: head.targets(spec) },
            mixer: MixerShape { kind, hypernetworks, weights_sum, looking, mixing },
        }
    }
}
