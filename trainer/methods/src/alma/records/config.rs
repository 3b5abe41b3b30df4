//! Everything that decides how a run of the preset `fast` learns.

use sortie_envs::Spec;
use sortie_learn::configuration::Range::{self, Number, OneOf, Positive, Text, Truth, Whole};
use sortie_learn::configuration::{OPTIMISER, SHARE, STEPS, exploration, require};
use sortie_learn::networks::{AimedHead, MixerKind, Targets};
use sortie_learn::session::{EnvironmentChoice, Setup};
use sortie_learn::{LearnError, section, sections, words};

use crate::alma::agents::{Columns, Conditioning, UtilityShape};

pub use sortie_learn::configuration::{ExplorationConfig, OptimiserConfig};

const COUNT: Range = Whole(1, 20_000_000);
pub(crate) const HEADS: Range = Whole(1, 64);
pub(crate) const WEIGHT: Range = Number(0.0, 1e6);
pub(crate) const WIDTH: Range = Whole(1, 1024);

sections! {
    /// What a setup says. Its defaults are the preset `fast`.
    #[serde(default)]
    Config, KEYS;

    besides {
        /// Where it learns.
        environment: EnvironmentChoice
    }

    /// Who assigns agents to buildings: a training episode draws its allocator by these weights.
    allocation: AllocationConfig {
        /// Weight of the allocator that the run learns; with 0 it learns none.
        learned: f64 = 1.0, WEIGHT, "weight";
        /// Weight of the hand-written rule that looks at the whole team.
        coordinated: f64 = 0.0, WEIGHT, "weight";
        /// Weight of the dissertation's heuristic.
        heuristic: f64 = 0.0, WEIGHT, "weight";
        /// Weight of uniform assignment.
        random: f64 = 0.0, WEIGHT, "weight";
        /// A rule of the environment by its name, which allocates in all episodes, whatever the weights.
        #[serde(default)]
        rule: String = String::new(), Text;
        /// Steps between decisions, unless the open tasks change.
        interval: u32 = 5, Whole(1, 100_000), "steps";
        /// Largest team that the learned allocator sends to one building.
        team_max: usize = 5, Whole(1, 64), "agents";
    }

    /// The agents' network.
    network: AgentNetworkConfig {
        /// What agents see of the subtasks: their own only, everything with marks, or no subtasks.
        subtask: Conditioning = Conditioning::Mask, OneOf(Conditioning::WORDS);
        /// Width of embedding and attention, a multiple of the heads.
        width: usize = 64, WIDTH, "columns";
        /// Attention heads.
        heads: usize = 4, HEADS, "heads";
        /// Width of the layer before the head.
        base: usize = 64, WIDTH, "columns";
        /// Non-zero inputs that the initial weights of the first layer are sized for; rows are mostly zeros.
        active_inputs: f32 = 8.0, Positive(1e6), "columns";
        /// Whether the own row's embedding is added to what the attention gives, past it; not in the dissertation.
        skip: bool = true, Truth;
        /// What values actions that are aimed at entities: a vector that points at their embeddings, or weights of each
        /// action's own, for which an entity is its number.
        head: AimedHead = AimedHead::Pointing, OneOf(AimedHead::WORDS);
    }

    /// How the utilities of a team become its value.
    mixer: MixerConfig {
        /// Their sum (VDN), a weighted sum, or two layers with non-negative weights (QMIX).
        kind: MixerKind = MixerKind::Sum, OneOf(MixerKind::WORDS);
        /// Width of embedding and attention of the hypernetwork that `linear` and `qmix` have, a multiple of its heads.
        width: usize = 64, WIDTH, "columns";
        /// Its attention heads.
        heads: usize = 4, HEADS, "heads";
        /// Width between the two layers of `qmix`.
        mixing: usize = 32, WIDTH, "columns";
        /// Factor on the rewards under `qmix`, whose layers shrink values at first.
        reward_scale: f32 = 0.2, Positive(1e6), "factor";
    }

    /// How rewards become targets.
    returns: ReturnsConfig = ReturnsConfig::default(), RETURNS;

    /// What the agents keep, and how much of it an update sees.
    replay: ReplayConfig = ReplayConfig::default(), REPLAY;

    /// How often agents take a random available action.
    exploration: ExplorationConfig = ExplorationConfig::default(), &exploration(
        "Length of the way down. Unless set, a run of less than 600,000 steps shrinks it in proportion.",
    );

    /// How the agents' weights follow the gradient.
    optimiser: OptimiserConfig = OptimiserConfig::default(), OPTIMISER;

    /// How the allocator learns. Until it decides, hand-written rules do.
    allocator: AllocatorConfig {
        // Until then the environment's first rule decides in its stead: the first agents wander and teach nothing about teams.
        /// When it begins to learn. Unless set, a run of less than 600,000 steps shrinks it in proportion.
        learns_from: u64 = 120_000, Whole(0, STEPS), "environment steps";
        // From `learns_from` until then an episode is decided by the first rule or by the second, with equal chance.
        /// When it begins to decide. Unless set, a run of less than 600,000 steps shrinks it in proportion.
        decides_from: u64 = 150_000, Whole(0, STEPS), "environment steps";
        /// Worth of a reward one step later.
        discount: f32 = 0.99, SHARE, "factor per step";
        /// What a team is credited with: what its own subtask earns, or its part in what all do, which tells of teams that are
        /// missed elsewhere too.
        credit: Credit = Credit::Subtask, OneOf(Credit::WORDS);
        /// Who is moved to a random open subtask in a decision to explore.
        moved: f64 = 0.15, SHARE, "share of the agents";
        /// How often agents are moved at all.
        moved_decisions: f64 = 0.7, SHARE, "share of the decisions";

        within:
        /// The team-value network.
        network: NetworkConfig = NetworkConfig::default(), NETWORK;
        /// What the allocator keeps, and how much of it an update sees.
        replay: ReplayConfig = ReplayConfig {
            capacity: 60_000,
            batch: 256,
            warm_up: 1_000,
            ..ReplayConfig::default()
        }, REPLAY;
        /// How the allocator's weights follow the gradient.
        optimiser: OptimiserConfig = OptimiserConfig {
            learning_rate_end: 1e-4,
            decay_from: 0.0,
            average_rate: 0.001,
            ..OptimiserConfig::default()
        }, OPTIMISER;
    }
}

words! {
    /// What teams at subtasks are credited with.
    Credit {
        /// What their own subtask earns.
        Subtask = "subtask",
        /// Their part in what all subtasks earn.
        Team = "team",
    }
}

section! {
    /// Sizes of a utility network.
    #[serde(default)]
    NetworkConfig, NETWORK;

    // The dissertation has 128.
    /// Width of embedding and attention, a multiple of the heads.
    width: usize = 64, WIDTH, "columns";
    /// Attention heads.
    heads: usize = 4, HEADS, "heads";
    /// Width of the layer before the head.
    base: usize = 64, WIDTH, "columns";
    // PyTorch would take all columns.
    /// Non-zero inputs that the initial weights of the first layer are sized for; rows are mostly zeros.
    active_inputs: f32 = 8.0, Positive(1e6), "columns";
    /// Whether the own row's embedding is added to what the attention gives, past it; not in the dissertation.
    skip: bool = true, Truth;
}

section! {
    /// How rewards become targets.
    #[serde(default)]
    ReturnsConfig, pub(crate) RETURNS;

    /// Steps before a target bootstraps.
    steps: u32 = 3, Whole(1, 1000), "steps";
    /// Worth of a reward one step later.
    discount: f32 = 0.97, SHARE, "factor per step";
    // Not in the dissertation. It leaves the best policy as it is, and learning takes half as long.
    /// Potential between an agent and its building, or the nearest open one; 0 turns shaping off.
    shaping: f32 = 0.5, Number(-100.0, 100.0), "reward per cell";
}

section! {
    /// What is kept, and how much of it an update sees.
    #[serde(default)]
    ReplayConfig, REPLAY;

    /// Samples kept: records of one step and one building's team, or decisions of the allocator.
    capacity: usize = 1_000_000, COUNT, "samples";
    /// Samples in an update.
    batch: usize = 512, Whole(1, 65_536), "samples";
    /// Steps from one update to the next.
    steps_per_update: u64 = 16, Whole(1, STEPS), "environment steps";
    /// Samples that must be there before the first update.
    warm_up: usize = 2_000, COUNT, "samples";
    /// Whether every drawn sample is turned and mirrored at random, which changes no truth.
    symmetries: bool = true, Truth;
}

impl Config {
    /// What a setup says.
    ///
    /// # Errors
    /// A value is impossible, or does not go together with others.
    pub fn of(setup: &Setup) -> Result<Self, LearnError> {
        let config = Self { environment: setup.environment.clone(), ..setup.own()? };
        config.check()?;
        Ok(config)
    }

    /// Whether the run learns an allocator; without subtasks there is nothing to allocate.
    pub fn learns_allocator(&self) -> bool {
        self.allocation.is_learned() && self.network.subtask.has_subtasks()
    }

    /// Who allocates where the run is measured, by name.
    pub fn measured_allocation(&self) -> &str {
        if self.network.subtask.has_subtasks() { self.allocation.measured() } else { "none" }
    }

    fn check(&self) -> Result<(), LearnError> {
        let weights = self.allocation.weights();
        require(
            weights.iter().any(|(_, weight)| *weight > 0.0),
            "one of the weights of `allocation` must be positive",
        )?;
        let AgentNetworkConfig { width, heads, .. } = self.network;
        require_multiple(("network.width", width), ("network.heads", heads))?;
        require_multiple(("mixer.width", self.mixer.width), ("mixer.heads", self.mixer.heads))?;
        let (steps, instances) = (self.returns.steps as usize, self.environment.instances);
        let least = 4 * steps * instances;
        require(
            self.replay.capacity > least,
            &format!(
                "`replay.capacity` must be more than {least}, four times `returns.steps` for each instance"
            ),
        )?;
        self.replay.check("replay")?;
        let NetworkConfig { width, heads, .. } = self.allocator.network;
        require_multiple(("allocator.network.width", width), ("allocator.network.heads", heads))?;
        self.allocator.replay.check("allocator.replay")
    }
}

/// The name of the allocator that a run learns.
pub(crate) const LEARNED: &str = "learned";

impl AllocationConfig {
    /// The allocators by their names, with their weights.
    pub fn weights(&self) -> [(&str, f64); 5] {
        let by_weight = |weight: f64| if self.rule.is_empty() { weight } else { 0.0 };
        [
            (LEARNED, by_weight(self.learned)),
            ("coordinated", by_weight(self.coordinated)),
            ("heuristic", by_weight(self.heuristic)),
            ("random", by_weight(self.random)),
            (&self.rule, f64::from(u8::from(!self.rule.is_empty()))),
        ]
    }

    /// Whether the run learns an allocator.
    pub fn is_learned(&self) -> bool {
        self.weights()[0].1 > 0.0
    }

    /// Who allocates where the run is measured, by name: the learned allocator, else the rule of most weight.
    pub fn measured(&self) -> &str {
        if self.is_learned() {
            return LEARNED;
        }
        let rules = self.weights().into_iter().skip(1);
        // Of several of one weight the first.
        rules.rev().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(LEARNED, |(name, _)| name)
    }

    /// The rules that allocate in some episode, by name.
    pub fn rules(&self) -> impl Iterator<Item = &str> {
        let rules = self.weights().into_iter().skip(1).filter(|(_, weight)| *weight > 0.0);
        rules.map(|(name, _)| name)
    }
}

/// Refuses the value of a key, a width, that is no multiple of another's, its heads.
pub(crate) fn require_multiple(
    (width_key, width): (&str, usize),
    (heads_key, heads): (&str, usize),
) -> Result<(), LearnError> {
    let reason = format!("`{width_key}` must be a multiple of `{heads_key}`");
    require(width.is_multiple_of(heads), &reason)
}

impl NetworkConfig {
    /// The network's shape for rows of so many columns, with so many outputs.
    pub fn shape(&self, input: usize, actions: usize) -> UtilityShape {
        let Self { width, heads, base, skip, .. } = *self;
        let targets = Targets::default();
        UtilityShape { input, width, heads, base, actions, skip, targets }
    }
}

impl AgentNetworkConfig {
    fn sizes(&self) -> NetworkConfig {
        let Self { width, heads, base, active_inputs, skip, .. } = *self;
        NetworkConfig { width, heads, base, active_inputs, skip }
    }

    /// The network's shape in an environment.
    pub fn shape(&self, spec: &Spec) -> UtilityShape {
        let marks = self.subtask.task_columns(spec.shape.tasks);
        let targets = self.head.targets(spec);
        let columns = Columns::of(&spec.shape, targets).unmarked() + marks;
        UtilityShape { targets, ..self.sizes().shape(columns, spec.shape.actions) }
    }
}

impl MixerConfig {
    /// What rewards are multiplied by.
    pub fn reward_factor(&self) -> f32 {
        if self.kind == MixerKind::Qmix { self.reward_scale } else { 1.0 }
    }
}

impl ReplayConfig {
    /// Refuses values that do not go together; `of` names the section.
    fn check(&self, of: &str) -> Result<(), LearnError> {
        require(
            self.capacity >= self.warm_up,
            &format!("`{of}.capacity` must be at least `{of}.warm_up`"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_measured_under_what_it_learns_or_mostly_sees() {
        let mut allocation = AllocationConfig { coordinated: 3.0, ..AllocationConfig::default() };
        assert_eq!(allocation.measured(), LEARNED);
        allocation.learned = 0.0;
        allocation.heuristic = 1.0;
        assert_eq!(allocation.measured(), "coordinated");
        allocation.random = 4.0;
        assert_eq!(allocation.measured(), "random");
        (allocation.learned, allocation.rule) = (1.0, "nearest".to_owned());
        assert_eq!((allocation.measured(), allocation.is_learned()), ("nearest", false));
        assert!(allocation.rules().eq(["nearest"]));
    }
}
