//! The published learner of MA-Exp (Iqbal and Sha 2019; dissertation chapter 4), the preset `paper`: networks with a head for each type of intrinsic reward, and a meta-policy between heads.

mod meta;
mod method;

use sortie_envs::{Random, Spec};
use sortie_learn::configuration::Range::{self, Number, OneOf, Truth, Whole};
use sortie_learn::configuration::SHARE;
use sortie_learn::{sections, words};
use toml::Table;

use crate::actor_critic::losses::Step;
use crate::novelty::{Columns, Intrinsic, Types};

pub use crate::actor_critic::acting::{Policies, PolicyShape};
pub use crate::actor_critic::batch::Batch;
pub use crate::actor_critic::groups::{Draw, Group, Groups, Rows};
pub use crate::actor_critic::heads::{
    HeadBatch, HeadCritic, HeadCriticShape, HeadLearner, HeadRules,
};
pub use meta::{MetaPolicy, Moments};
pub use method::MultiExplore;

const ANY: Range = Number(0.0, 1e6);
const WIDTH: Range = Whole(4, 1024);
const SIZE: Range = Whole(1, 20_000_000);

sections! {
    /// Sizes and rates; the default is the preset `paper`, whose episodes of a turn are its instances.
    Config, KEYS;

    above "What is learned." {
        /// Networks, as published, which tells this file from those of the preset `fast`.
        learner: Learner = Learner::Networks, OneOf(Learner::WORDS);
    }

    /// What is explored for: policies and values for each type of intrinsic reward.
    heads: HeadsConfig {
        /// Types of intrinsic rewards: one, none, or the five that the dissertation chooses among.
        intrinsic: Types = Types::Multi, OneOf(Types::WORDS);
        /// Whether one more head explores for nothing.
        exploits: bool = false, Truth;
    }

    /// Policies, and the critic that learns with them.
    network: NetworkConfig {
        /// Width of the critic's layers.
        critic_width: usize = 128, WIDTH, "columns";
        /// Width of the layer that the policies of an agent share.
        base_width: usize = 128, WIDTH, "columns";
        /// Width of a head's layer in a policy.
        head_width: usize = 32, WIDTH, "columns";
    }

    /// How rewards become targets.
    returns: ReturnsConfig {
        /// Discount of the team's rewards.
        discount: f32 = 0.99, SHARE, "per step";
        /// Discount of intrinsic rewards.
        intrinsic_discount: f32 = 0.99, SHARE, "per step";
        /// What intrinsic values count in what policies learn.
        intrinsic_weight: f32 = 0.1, ANY, "reward per deviation";
        /// How much chance in the choice of actions is worth.
        entropy: f32 = 0.01, ANY, "reward";
    }

    /// What is kept, and how much of it an update sees.
    replay: ReplayConfig {
        /// Kept, of all instances.
        capacity: usize = 1_000_000, SIZE, "steps";
        /// In an update; nothing is learned before as many are kept.
        batch: usize = 1024, Whole(1, 65_536), "steps";
        /// Steps from one period of updates to the next.
        steps_per_period: u64 = 100, SIZE, "environment steps";
        /// Updates of a period.
        updates_per_period: u64 = 50, Whole(1, 10_000), "updates";
    }

    /// How the weights follow the gradient, by Adam.
    optimiser: OptimiserConfig {
        /// Step size of the critic.
        critic_rate: f32 = 0.001, SHARE;
        /// Step size of the policies.
        policy_rate: f32 = 0.001, SHARE;
        /// Share of the way that targets move in an update.
        target_rate: f32 = 0.005, SHARE, "share";
        /// What a weight of the critic adds to its gradient.
        weight_decay: f32 = 0.001, SHARE;
        /// Largest norm of the critic's gradient.
        critic_clip: f32 = 10.0, ANY;
        /// Largest norm of the gradient of an agent's policy.
        policy_clip: f32 = 0.1, ANY;
        /// What the mean squared score of an action counts.
        score_penalty: f32 = 0.001, ANY;
        /// Added to Adam's denominator.
        epsilon: f32 = 1e-8, SHARE;
        /// Whether that is added before the correction of first steps, as PyTorch did until version 1.2.
        early_epsilon: bool = true, Truth;
    }

    /// Which head acts in a turn, an episode of every instance.
    meta: MetaConfig {
        /// Whether any head is drawn, whatever turns return.
        uniform: bool = false, Truth;
        /// Steps of the meta-policy after a turn.
        steps: usize = 100, Whole(1, 100_000), "steps";
        /// Size of its steps.
        rate: f64 = 0.04, SHARE;
        /// What a weight of it adds to its gradient.
        decay: f64 = 0.001, SHARE;
        /// What the entropy of the choice counts beside returns: the inverse of their scale.
        entropy: f64 = 0.2, ANY, "return";
    }
}

words! {
    /// What this preset learns.
    Learner {
        /// Networks, as published.
        Networks = "networks",
    }
}

/// Whether a setup has this learner.
pub(crate) fn is_networks(own: &Table) -> bool {
    own.contains_key("learner")
}

impl Config {
    /// The networks for an environment before their first update; none where it shows no places.
    pub fn learner(&self, spec: &Spec, threads: usize, random: &mut Random) -> Option<HeadLearner> {
        let groups = Groups::new(spec, false, false);
        let critic = HeadCriticShape {
            state: groups.agents() * Columns::of(spec)?.of_state(),
            width: self.network.critic_width,
            paid: self.heads().iter().map(Option::is_some).collect(),
        };
        let shapes = (self.policy_shape(), &critic);
        Some(HeadLearner::new(self.rules(), shapes, groups, threads, random))
    }

    /// What each head is paid for.
    pub fn heads(&self) -> Vec<Option<Intrinsic>> {
        let mut heads = self.heads.intrinsic.heads();
        if !self.heads.exploits && heads.len() > 1 {
            heads.pop();
        }
        heads
    }

    /// How networks learn.
    pub fn rules(&self) -> HeadRules {
        let (returns, optimiser) = (&self.returns, &self.optimiser);
        let OptimiserConfig { epsilon, early_epsilon, .. } = *optimiser;
        let step = |rate, decay| Step { rate, decay, epsilon, early_epsilon };
        HeadRules {
            discounts: [returns.discount, returns.intrinsic_discount],
            entropy: returns.entropy,
            own_weight: returns.intrinsic_weight,
            score_penalty: optimiser.score_penalty,
            steps: [
                step(optimiser.critic_rate, optimiser.weight_decay),
                step(optimiser.policy_rate, 0.0),
            ],
            clips: [optimiser.critic_clip, optimiser.policy_clip],
            target_rate: optimiser.target_rate,
        }
    }

    /// The policies' sizes.
    pub fn policy_shape(&self) -> PolicyShape {
        let widths = [self.network.base_width, self.network.head_width];
        PolicyShape { widths, heads: self.heads().len(), slope: 0.0 }
    }
}
