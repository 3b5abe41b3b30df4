//! Everything that decides how a run of the preset `paper` learns.

use sortie_envs::Spec;
use sortie_learn::configuration::Range::{self, Number, OneOf, Positive, Text, Truth, Whole};
use sortie_learn::configuration::{SHARE, STEPS, require};
use sortie_learn::networks::AimedHead;
use sortie_learn::session::{EnvironmentChoice, Setup};
use sortie_learn::{LearnError, section, sections, words};
use sortie_nn::schedule::linear;

use super::WindowShape;
use crate::alma::agents::{Conditioning, UtilityShape};
use crate::alma::records::LEARNED;
use crate::alma::records::config::{
    self as records, HEADS, RETURNS, ReturnsConfig, WEIGHT, WIDTH, require_multiple,
};

const SPARE: Range = Whole(0, 64);

sections! {
    /// The configuration of a run. Its defaults are those of the dissertation and its public code.
    #[serde(default)]
    Config, KEYS;

    above "What is learned from." {
        /// Windows of whole episodes, which tells this file from those of the preset `fast`.
        learner: String = "windows".to_owned(), OneOf(&["windows"]);
    }

    besides {
        /// Where it learns.
        environment: EnvironmentChoice
    }

    /// The agents' utilities, their mixer, and how both learn.
    low_level: LowLevelConfig {
        /// What agents and mixer see of the subtasks.
        conditioning: Conditioning = Conditioning::Mask, OneOf(Conditioning::WORDS);
        /// Spare subtask marks, shuffled in with the others.
        extra_tasks: usize = 0, SPARE, "subtasks";
        /// Width of embedding and attention, a multiple of the heads.
        width: usize = 128, WIDTH, "columns";
        /// Attention heads.
        heads: usize = 4, HEADS, "heads";
        /// Width of the layer before the head.
        base: usize = 64, WIDTH, "columns";
        /// Inputs of an entity that are not zero, by which first weights are drawn; 0 counts them all, as PyTorch does.
        active_inputs: f32 = 0.0, WEIGHT, "columns";
        /// Whether the own row's embedding is added to what the attention gives, past it; not in the dissertation.
        skip: bool = false, Truth;
        /// What values actions that are aimed at entities: a vector that points at their embeddings, or weights of each
        /// action's own, for which an entity is its number.
        head: AimedHead = AimedHead::Pointing, OneOf(AimedHead::WORDS);
        // A gated recurrent unit before the head, which begins empty in every window.
        /// Whether the agents have a memory, emptied when an episode ends.
        recurrent: bool = false, Truth;
        /// Width of the hypernetworks' embedding and attention, a multiple of their heads.
        hypernetwork_width: usize = 128, WIDTH, "columns";
        /// Heads of the hypernetworks' attention.
        hypernetwork_heads: usize = 4, HEADS, "heads";
        /// Width between the mixer's two layers.
        mixing: usize = 32, WIDTH, "columns";
        /// How mixing weights are kept from being negative.
        nonnegative: Nonnegative = Nonnegative::Softmax, OneOf(Nonnegative::WORDS);
        /// Whether mixing biases go through absolute values, as in the public code of ALMA.
        bias_nonnegative: bool = false, Truth;
        /// Whether each subtask has a PopArt head of its own, as in the public code.
        popart_per_task: bool = false, Truth;
        /// When the PopArt head is rescaled: before values are computed, or as the public code does.
        popart_order: PopArtOrder = PopArtOrder::RescaleFirst, OneOf(PopArtOrder::WORDS);
        /// Whether the agents stay as they are: only the allocator learns.
        frozen: bool = false, Truth;
        /// Learning rate of RMSprop, of both levels.
        learning_rate: f32 = 5e-4, Number(0.0, 1000.0), "step of RMSprop";
        /// Largest norm of the gradient; a longer one is shortened.
        clip: f32 = 10.0, Positive(1e9), "norm";

        within:
        /// How rewards become targets.
        returns: ReturnsConfig = ReturnsConfig { steps: 1, discount: 0.99, shaping: 0.0 }, RETURNS;
    }

    /// Who tells agents without subtasks what to do: COPA.
    coach: CoachConfig {
        /// Whether there is a coach.
        enabled: bool = false, Truth;
        /// Weight of the recognition's term of the loss; the coach's entropy weighs a tenth.
        beta: f32 = 5e-5, WEIGHT, "weight";
    }

    /// Who allocates, and how that is learned.
    allocation: AllocationConfig {
        /// The learned allocator (`learned`), or a rule of the environment by its name.
        by: String = LEARNED.to_owned(), Text;
        /// Steps between decisions, unless the open tasks change; those of a coach too.
        interval: u32 = 5, Whole(1, 100_000), "steps";
        /// Allocations that are proposed for a decision.
        proposals: usize = 32, Whole(1, 4096), "allocations";
        /// Width of embedding and attention of proposal policy and critic, a multiple of their heads.
        width: usize = 128, WIDTH, "columns";
        /// Their attention heads.
        heads: usize = 4, HEADS, "heads";
        /// Spare subtasks, so that the networks serve worlds with more of them.
        extra_tasks: usize = 0, SPARE, "subtasks";
        /// Worth of a reward one decision later.
        discount: f32 = 0.99, SHARE, "factor per decision";
        /// Weight of the proposal policy's entropy.
        entropy: f32 = 0.01, WEIGHT, "weight";
        /// Age from which an episode teaches the allocator nothing.
        oldest: u64 = 150_000, Whole(1, STEPS), "environment steps";
        /// Decisions in an update, at most.
        rows: usize = 400, Whole(2, 100_000), "decisions";
    }

    /// How much is tried out; all three are 0 where a run is measured.
    exploration: ExplorationConfig {
        within:
        /// How often an agent takes a random available action.
        actions: Schedule = Schedule { start: 1.0, end: 0.05, steps: 2_000_000 }, SCHEDULE;
        /// How often a decision takes the first proposal instead of the critic's best.
        proposal: Schedule = Schedule { start: 1.0, end: 0.05, steps: 3_000_000 }, SCHEDULE;
        /// How often an agent is given a random open subtask at a decision.
        allocation: Schedule = Schedule { start: 1.0, end: 0.0, steps: 750_000 }, SCHEDULE;
    }

    /// What is kept, and how often is learned from it.
    learning: LearningConfig {
        /// Episodes kept.
        episodes: usize = 5_000, Whole(1, 1_000_000), "episodes";
        /// Episodes drawn and windows cut for an update.
        windows: usize = 32, Whole(1, 4096), "windows";
        /// States of a window.
        steps: usize = 64, Whole(2, 10_000), "states";
        /// Updates for every episode.
        updates: usize = 1, Whole(0, 10_000), "updates";
        /// When the target of the agents and their mixer is renewed.
        copy_agents_every: u64 = 200, Whole(1, STEPS), "episodes";
        /// When the target of the critic is renewed.
        copy_critic_every: u64 = 50, Whole(1, STEPS), "episodes";
    }
}

section! {
    /// A probability that falls in a straight line.
    Schedule, SCHEDULE;

    /// Before the first step.
    start: f32 = 0.0, SHARE, "probability";
    /// From step `steps` on.
    end: f32 = 0.0, SHARE, "probability";
    /// Length of the way.
    steps: u64 = 0, Whole(0, STEPS), "environment steps";
}

words! {
    /// When the PopArt head is rescaled to new statistics.
    PopArtOrder {
        /// Before values are computed, so that they and the targets are in the same units.
        RescaleFirst = "rescale-first",
        /// Between the forward and the backward pass, as the public code does.
        Reference = "reference",
    }
}

words! {
    /// How mixing weights are kept from being negative.
    Nonnegative {
        /// A softmax over the mixing width.
        Softmax = "softmax",
        /// Absolute values.
        Absolute = "absolute",
    }
}

/// How much is tried out in a round.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exploration {
    /// How often an agent takes a random available action.
    pub actions: f32,
    /// How often a decision takes the first proposal instead of the critic's best.
    pub proposal: f32,
    /// How often an agent is given a random open subtask at a decision.
    pub allocation: f32,
}

impl Schedule {
    fn at(&self, step: u64) -> f32 {
        linear(self.start, self.end, self.steps, step)
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

impl Config {
    /// Windows learned from under the conditions of the preset `fast`: its returns, its width, its
    /// exploration, its steps, and as many updates of as many states. COPA's under that preset.
    pub fn like_fast() -> Self {
        let records::Config { network, returns, exploration: agents, .. } =
            records::Config::default();
        let mut config = Self::default();
        let Self { low_level, exploration, learning, .. } = &mut config;
        (low_level.width, low_level.hypernetwork_width) = (network.width, network.width);
        (low_level.active_inputs, low_level.skip) = (network.active_inputs, network.skip);
        low_level.returns = returns;
        let ExplorationConfig { actions, proposal, allocation } = exploration;
        for schedule in [actions, proposal, allocation] {
            *schedule = Schedule { start: agents.start, end: agents.end, steps: agents.steps };
        }
        (learning.windows, learning.steps, learning.updates) = (16, 32, 5);
        (learning.copy_agents_every, learning.copy_critic_every) = (40, 10);
        config
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

    /// The rule that allocates, by name, where one does.
    pub fn rule(&self) -> Option<&str> {
        let by = &*self.allocation.by;
        (self.low_level.conditioning.has_subtasks() && by != LEARNED).then_some(by)
    }

    /// The shape of the agents' network in an environment.
    pub fn agents(&self, spec: &Spec) -> UtilityShape {
        self.low_level.shape(WindowShape::of(spec))
    }

    /// Whether the run learns an allocator; without subtasks there is nothing to allocate.
    pub fn learns_allocator(&self) -> bool {
        self.low_level.conditioning.has_subtasks() && self.allocation.by == LEARNED
    }

    /// Who allocates, by name.
    pub fn measured_allocation(&self) -> &str {
        if self.low_level.conditioning.has_subtasks() { &self.allocation.by } else { "none" }
    }

    /// Has a coach tell agents without subtasks what to do: COPA.
    pub fn enable_coach(&mut self) {
        self.low_level.conditioning = Conditioning::None;
        self.coach.enabled = true;
    }

    fn check(&self) -> Result<(), LearnError> {
        let Self { low_level, allocation, learning, .. } = self;
        let LowLevelConfig { width, heads, hypernetwork_width, hypernetwork_heads, .. } =
            *low_level;
        require_multiple(("low_level.width", width), ("low_level.heads", heads))?;
        let heads = ("low_level.hypernetwork_heads", hypernetwork_heads);
        require_multiple(("low_level.hypernetwork_width", hypernetwork_width), heads)?;
        require(
            !self.coach.enabled
                || (low_level.conditioning == Conditioning::None && !low_level.recurrent),
            "agents with a coach have no subtasks and no memory: `low_level.conditioning` must be `none`, \
             `.recurrent` false",
        )?;
        let AllocationConfig { width, heads, .. } = *allocation;
        require_multiple(("allocation.width", width), ("allocation.heads", heads))?;
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
