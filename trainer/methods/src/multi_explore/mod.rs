//! The published learner of MA-Exp (Iqbal and Sha 2019; dissertation chapter 4), the preset `paper`: networks with a head for each type of intrinsic reward, and a meta-policy between heads.

mod critic;
mod meta;
mod method;

use sortie_envs::{Random, Spec};
use sortie_learn::configuration::Range::{self, Number, OneOf, Truth, Whole};
use sortie_learn::configuration::SHARE;
use sortie_learn::sections;
use sortie_nn::optimise::AdamRules;
use toml::Table;

use crate::actor_critic::Rules;
use crate::novelty::{Columns, Intrinsic, Types};
use critic::HeadCritic;

pub use crate::actor_critic::critic::Batch;
pub use crate::actor_critic::groups::{Draw, Group, Groups, Rows};
pub use crate::actor_critic::learner::ActorCritic;
pub use crate::actor_critic::policies::{Policies, PolicyShape};
pub use crate::actor_critic::{OwnActions, PolicyValues};
pub use meta::{MetaPolicy, Moments};
pub use method::MultiExplore;

const ANY: Range = Number(0.0, 1e6);
const WIDTH: Range = Whole(4, 1024);
const SIZE: Range = Whole(1, 20_000_000);
/// Records of a shard of an update: a critic of many heads has more weights than records.
const SHARD: usize = 256;

sections! {
    /// Sizes and rates; the default is the preset `paper`, whose episodes of a turn are its instances.
    Config, KEYS;

    above "What is learned." {
        /// Networks, as published, which tells this file from those of the preset `fast`.
        learner: String = "networks".to_owned(), OneOf(&["networks"]);
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

/// Whether a setup has this learner.
pub(crate) fn is_networks(own: &Table) -> bool {
    own.contains_key("learner")
}

impl Config {
    /// Critic and policies for an environment before their first update; none where it shows no places.
    pub fn learner(&self, spec: &Spec, threads: usize, random: &mut Random) -> Option<ActorCritic> {
        let groups = Groups::new(spec, false, false);
        let state = groups.agents() * Columns::of(spec)?.of_state();
        Some(self.learner_of(groups, state, threads, random))
    }

    /// The same for agents, each a group of its own, in states of so many numbers.
    pub fn learner_of(
        &self,
        groups: Groups,
        state: usize,
        threads: usize,
        random: &mut Random,
    ) -> ActorCritic {
        let (network, heads) = (&self.network, self.heads());
        let paid: Vec<bool> = heads.iter().map(Option::is_some).collect();
        let widths = [network.base_width, network.head_width];
        let policies = PolicyShape { widths, heads: heads.len(), slope: 0.0 };
        let sizes = [state, network.critic_width];
        let (critic, weights) = HeadCritic::new(sizes, &paid, &groups, random);
        let policies = Policies::new(policies, &groups, random);
        let critic = (Box::new(critic) as Box<_>, weights);
        ActorCritic::new(self.rules(), groups, critic, policies, false, threads)
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
    fn rules(&self) -> Rules {
        let (returns, optimiser) = (&self.returns, &self.optimiser);
        let OptimiserConfig { epsilon, early_epsilon, weight_decay: decay, .. } = *optimiser;
        Rules {
            own_actions: OwnActions::Drawn,
            policy_values: PolicyValues::Fresh,
            lambda: 0.0,
            paid_discount: returns.intrinsic_discount,
            paid_weight: returns.intrinsic_weight,
            penalties: [0.0, optimiser.score_penalty],
            rates: [optimiser.critic_rate, optimiser.policy_rate],
            adam: AdamRules { epsilon, early_epsilon, decay },
            clips: [optimiser.critic_clip, optimiser.policy_clip],
            follow: [optimiser.target_rate, 1.0],
            shard: SHARD,
        }
    }
}
