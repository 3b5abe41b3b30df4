//! MAAC: multi-actor-attention-critic (Iqbal and Sha 2019; dissertation chapter 3).
//!
//! Every agent has a reward and a policy of its own; a critic that looks at the others by attention values its actions
//! while it learns. Deployed are the policies alone.

mod attention;
mod critic;
mod experience;
mod joint;
mod method;
mod presets;

use sortie_learn::configuration::Range::{self, Number, OneOf, Truth, Whole};
use sortie_learn::configuration::SHARE;
use sortie_learn::{sections, words};
use sortie_nn::optimise::AdamRules;
use sortie_nn::random::Generator;

use crate::actor_critic::Rules;
use crate::actor_critic::acting::{Actors, Inputs};
use crate::actor_critic::groups::SLOPE;
use crate::actor_critic::policies::PolicyShape;

pub use crate::actor_critic::critic::Batch;
pub use crate::actor_critic::groups::{Draw, Group, Groups, Rows, Running};
pub use crate::actor_critic::learner::ActorCritic;
pub use crate::actor_critic::policies::Policies;
pub use crate::actor_critic::{OwnActions, PolicyValues};
pub use method::Maac;
pub use presets::{COMA, COMA_SAC, DDPG, MAAC, MADDPG, MADDPG_SAC};

const ANY: Range = Number(0.0, 1e6);
const WIDTH: Range = Whole(4, 1024);
const SIZE: Range = Whole(1, 20_000_000);
const STEPS: Range = Whole(0, 20_000_000_000);
/// Records of a shard of an update.
const SHARD: usize = 128;
const FEW: Range = Whole(1, 1000);

sections! {
    /// Sizes, chances and rates; the default is the preset `fast`.
    Config, KEYS;

    /// Policies, and the critic that learns with them.
    network: NetworkConfig {
        /// What the critic makes of the others: it attends to them (MAAC), all count the same (MAAC (Uniform)), it has
        /// everything in one row, as one for each group of agents (MADDPG) or one for all (COMA), or nothing (DDPG).
        critic: CriticKind = CriticKind::Attention, OneOf(CriticKind::WORDS);
        /// Width of the critic's layers, a multiple of its heads.
        critic_width: usize = 64, WIDTH, "columns";
        /// Width of the policies' layers.
        policy_width: usize = 64, WIDTH, "columns";
        /// Attention heads of the critic.
        heads: usize = 4, Whole(1, 64), "heads";
        /// Whether agents of a role share their networks; each has its own otherwise.
        shared: bool = true, Truth;
        /// Whether agents that share networks are told which of them they are.
        identity: bool = true, Truth;
        /// Whether inputs are normalised over the batch.
        normalised: bool = false, Truth;
        /// What inputs that are not normalised are multiplied with.
        input_scale: f32 = 1.0, ANY, "factor";
    }

    /// How rewards become targets.
    returns: ReturnsConfig {
        /// Decisions before a target bootstraps.
        steps: usize = 3, FEW, "decisions";
        /// Worth of a reward one step later.
        discount: f32 = 0.95, SHARE, "factor per step";
        /// What the target of the next decision counts beside its value, in whole episodes: TD(lambda).
        lambda: f32 = 0.0, SHARE, "share";
        /// Steps that an action is held for while learning; teams that are measured decide at every step.
        decision_interval: usize = 1, FEW, "steps";
        /// Scale of the environment's potential, whose rise is added to rewards while learning; 0: nothing is.
        shaping: f32 = 0.0, ANY, "reward per unit";
    }

    /// What is kept, and how much of it an update sees.
    replay: ReplayConfig {
        /// Whether an update sees the episodes that all instances just ended, once, in place of a batch.
        on_policy: bool = false, Truth;
        /// Kept, of all instances.
        capacity: usize = 24_000, SIZE, "decisions";
        /// Kept before the first update.
        first: usize = 4_000, SIZE, "decisions";
        /// In an update.
        batch: usize = 128, Whole(1, 65_536), "decisions";
        /// Steps from one period of updates to the next.
        steps_per_period: u64 = 64, SIZE, "environment steps";
        /// Updates of a period.
        updates_per_period: u64 = 1, FEW, "updates";
    }

    /// How much chance in the choice of actions is worth, in deviations of rewards.
    entropy: EntropyConfig {
        /// At first.
        start: f32 = 0.03, ANY;
        /// After `steps`, and from there on.
        end: f32 = 0.03, ANY;
        /// Steps in which it falls, by the same factor each.
        steps: u64 = 0, STEPS, "environment steps";
    }

    /// How the weights follow the gradient, by Adam.
    optimiser: OptimiserConfig {
        /// Step size of the critic.
        critic_rate: f32 = 0.002, SHARE;
        /// Step size of the policies.
        policy_rate: f32 = 0.001, SHARE;
        /// Share of the way that targets move in an update.
        target_rate: f32 = 0.03, SHARE, "share";
        /// Share of the way that the policies that are measured move in an update.
        average_rate: f32 = 0.01, SHARE, "share";
        /// What a weight of the critic adds to its gradient.
        weight_decay: f32 = 0.0, SHARE;
        /// Largest norm of the critic's gradient, for each agent.
        critic_clip: f32 = 10.0, ANY;
        /// Largest norm of the gradient of a policy.
        policy_clip: f32 = 0.5, ANY;
        /// Added to Adam's denominator.
        epsilon: f32 = 1e-8, SHARE;
        /// Whether that is added before the correction of first steps, as PyTorch did until version 1.2.
        early_epsilon: bool = false, Truth;
    }

    /// What an update computes.
    update: UpdateConfig {
        /// How an agent's own action counts in targets and policies: all by their chances, one that is drawn, or one that
        /// the critic is shown and whose value says which way its scores should go (DDPG).
        own_actions: OwnActions = OwnActions::Expected, OneOf(OwnActions::WORDS);
        /// What policies learn from: the values that the critic's update computed, or those of the updated critic for
        /// actions that all draw anew.
        policy_values: PolicyValues = PolicyValues::Kept, OneOf(PolicyValues::WORDS);
        /// What the mean squared score of an action counts.
        score_penalty: f32 = 0.001, ANY;
        /// What the mean squared score of attention counts.
        attention_penalty: f32 = 0.001, ANY;
    }
}

/// Sizes of a critic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CriticShape {
    /// What it makes of the others.
    pub kind: CriticKind,
    /// Width of its layers.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Whether it is shown an agent's own action as well, and says what that is worth instead of each.
    pub sees_own: bool,
    /// Whether what it is shown is normalised over the batch.
    pub normalised: bool,
}

words! {
    /// What a critic makes of the others.
    CriticKind {
        /// It learns what they count (MAAC).
        Attention = "attention",
        /// They all count the same (MAAC (Uniform)).
        Uniform = "uniform",
        /// A critic for each group of agents has everything in one row (MADDPG).
        All = "all",
        /// One critic for all agents has everything in one row, and who is asked (COMA).
        One = "one",
        /// Nothing (DDPG).
        Own = "own",
    }
}

impl Config {
    /// The preset `paper`: the published settings.
    pub fn paper() -> Self {
        let mut paper = Self::default();
        let Self { network, returns, replay, entropy, optimiser, update } = &mut paper;
        (network.critic_width, network.policy_width) = (128, 128);
        (network.shared, network.identity, network.normalised) = (false, false, true);
        (returns.steps, returns.discount) = (1, 0.99);
        (replay.capacity, replay.first, replay.batch) = (1_000_000, 1_024, 1_024);
        (replay.steps_per_period, replay.updates_per_period) = (100, 4);
        (entropy.start, entropy.end) = (0.01, 0.01);
        (optimiser.critic_rate, optimiser.weight_decay) = (0.001, 0.001);
        (optimiser.target_rate, optimiser.average_rate) = (0.001, 1.0);
        optimiser.early_epsilon = true;
        (update.own_actions, update.policy_values) = (OwnActions::Drawn, PolicyValues::Fresh);
        paper
    }

    /// What becomes of observations; moments of policies that normalise them.
    fn inputs<'a>(&self, running: Option<&'a Running>) -> Inputs<'a> {
        let NetworkConfig { normalised, input_scale, .. } = self.network;
        Inputs { scale: if normalised { 1.0 } else { input_scale }, running }
    }

    /// Policies that act by these weights.
    fn actors<'a>(&self, learner: &'a ActorCritic, weights: &'a [f32]) -> Actors<'a> {
        let ActorCritic { groups, policies, running, .. } = learner;
        let inputs = self.inputs(running.as_ref());
        Actors { groups, inputs, policies, head: 0, weights }
    }

    /// The critic's sizes.
    pub fn critic_shape(&self) -> CriticShape {
        let NetworkConfig { critic: kind, critic_width: width, heads, normalised, .. } =
            self.network;
        let sees_own = self.update.own_actions == OwnActions::Relaxed;
        CriticShape { kind, width, heads, sees_own, normalised }
    }

    /// Critic and policies before their first update.
    pub fn learner(&self, groups: Groups, threads: usize, random: &mut Generator) -> ActorCritic {
        let width = self.network.policy_width;
        let policies = PolicyShape { widths: [width; 2], heads: 1, slope: SLOPE };
        let critic = critic::critic(self.critic_shape(), &groups, random);
        let policies = Policies::new(policies, &groups, random);
        let (rules, normalised) = (self.rules(groups.agents()), self.network.normalised);
        ActorCritic::new(rules, groups, critic, policies, normalised, threads)
    }

    fn rules(&self, agents: usize) -> Rules {
        let (optimiser, update) = (&self.optimiser, &self.update);
        let OptimiserConfig { epsilon, early_epsilon, weight_decay: decay, .. } = *optimiser;
        Rules {
            own_actions: update.own_actions,
            policy_values: update.policy_values,
            lambda: self.returns.lambda,
            // Nobody is paid for anything else.
            paid_discount: 0.0,
            paid_weight: 0.0,
            penalties: [update.attention_penalty, update.score_penalty],
            rates: [optimiser.critic_rate, optimiser.policy_rate],
            adam: AdamRules { epsilon, early_epsilon, decay },
            clips: [optimiser.critic_clip * agents as f32, optimiser.policy_clip],
            follow: [optimiser.target_rate, optimiser.average_rate],
            shard: SHARD,
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
