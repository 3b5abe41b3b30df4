//! The preset `paper`: a policy draws allocations, a critic takes the best of them, and the policy learns to draw that one
//! (amortised Q-learning, Van de Wiele et al. 2020; dissertation section 7.4).
//!
//! As published the critic values a state with an allocation, and learns what the step earned and the best of the next
//! state's proposals by the target network. With `critic.input=after-state` it values the state that follows, which the
//! environment is asked for, so that what the step earns need not be learned; with `critic.target=return` it learns what
//! the rest of the episode earned.

mod method;
mod proposer;
#[cfg(test)]
mod tests;

use sortie_learn::configuration::Range::{Number, OneOf, Whole};
use sortie_learn::configuration::{EXPLORATION, ExplorationConfig, OPTIMISER, OptimiserConfig};
use sortie_learn::run::RunConfig;
use sortie_learn::session::Setup;
use sortie_learn::subtasks::PROPOSALS;
use sortie_learn::{sections, words};

use super::{NETWORK, NetworkConfig, optimiser};

pub(super) use method::Aql;

sections! {
    /// Sizes and rates; the default is the preset `paper`.
    Config, KEYS;

    above "What learns." {
        /// Proposals and a critic, which tells this file from those of the preset `fast`.
        learner: String = "aql".to_owned(), OneOf(&["aql"]);
    }

    /// Encoder and decoder, of what proposes and of the critic.
    network: NetworkConfig = NetworkConfig::default(), NETWORK;

    /// What values proposals.
    critic: CriticConfig {
        /// What it looks at.
        input: CriticInput = CriticInput::Allocation, OneOf(CriticInput::WORDS);
        /// What it learns.
        target: CriticTarget = CriticTarget::Bootstrap, OneOf(CriticTarget::WORDS);
    }

    /// What is proposed.
    proposals: ProposalsConfig {
        /// Allocations that are drawn, of which the critic takes the best.
        count: usize = PROPOSALS, Whole(1, 1024), "allocations";
        /// What the entropy of chances counts.
        entropy: f32 = 0.01, Number(0.0, 100.0), "factor";
    }

    /// What is kept, and learned from.
    replay: ReplayConfig {
        /// Whole episodes that are kept.
        capacity: usize = 4_000, Whole(1, 20_000_000), "episodes";
        /// Episodes of an update.
        batch: usize = 24, Whole(1, 4096), "episodes";
        /// Updates whenever the episodes of all instances are over.
        updates: usize = 2, Whole(1, 1000), "updates";
    }

    /// How often agents are given what they are offered at random.
    exploration: ExplorationConfig = ExplorationConfig {
        start: 0.3,
        steps: 60_000,
        spread: vec![1.0],
        ..ExplorationConfig::default()
    }, EXPLORATION;

    /// How the weights of both networks follow the gradient.
    optimiser: OptimiserConfig = optimiser(), OPTIMISER;
}

words! {
    /// What a critic values.
    CriticInput {
        /// A state, and who was given what in it.
        Allocation = "allocation",
        /// The state that follows; what is earned on the way there is known.
        AfterState = "after-state",
    }
}

words! {
    /// What a critic learns.
    CriticTarget {
        /// What the step earned, and the best proposal in the next state by the target network.
        Bootstrap = "bootstrap",
        /// What the rest of the episode earned.
        Return = "return",
    }
}

pub(super) fn paper() -> Setup {
    let run = RunConfig {
        steps: 200_000,
        evaluate_every: 25_000,
        evaluate_episodes: 200,
        ..RunConfig::default()
    };
    Setup::of(24, run, &Config::default())
}
