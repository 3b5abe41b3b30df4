//! MAPPO and IPPO: proximal policy optimisation (Schulman et al. 2017) for teams.
//!
//! Agents share one policy and learn from their team's reward, on what they did since they learned last, a few times over.
//! How good a decision was says a critic: of MAPPO it values the state (Yu et al. 2022), of IPPO what the agent itself sees
//! (de Witt et al. 2020).

mod lesson;
mod method;
mod networks;
#[cfg(test)]
mod tests;

use sortie_envs::{Spec, View};
use sortie_learn::configuration::Range::{Numbers, OneOf, Positive, Whole};
use sortie_learn::configuration::{OPTIMISER, OptimiserConfig, SHARE, require};
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::{LearnError, Method, sections, words};
use sortie_nn::layers::split_attention::HEADS;

pub use method::Mappo;

sections! {
    /// Sizes and rates; the default is the preset `fast` of MAPPO.
    Config, KEYS;

    /// Actor and critic: attention over entities, or two hidden layers where agents see vectors.
    network: NetworkConfig {
        /// What the critic values: the whole state (MAPPO), or what each agent sees itself (IPPO).
        critic: Sees = Sees::State, OneOf(Sees::WORDS);
        /// Width of embedding and attention, a multiple of 4, or of hidden layers.
        width: usize = 32, Whole(4, 1024), "columns";
        /// Inputs that differ from zero, which the first weights are sized for where entities are seen; 0: all columns.
        active_inputs: usize = 3, Whole(0, 1024), "columns";
    }

    /// What is learned from at a time.
    rollout: RolloutConfig {
        /// Of each instance, from one time that is learned to the next.
        steps: usize = 64, Whole(1, 65_536), "environment steps";
    }

    /// How rewards become advantages and targets.
    returns: ReturnsConfig {
        /// Worth of a reward one step later.
        discount: f32 = 0.99, SHARE, "factor per step";
        /// What errors of the critic one step later count in an advantage: lambda of generalised advantages.
        lambda: f32 = 0.95, SHARE, "factor per step";
        /// What rewards are multiplied with, so that returns are about 1.
        scale: f32 = 1.0, Positive(1e6), "factor";
    }

    /// How often a rollout is learned from, and how far at most.
    update: UpdateConfig {
        /// How often each step is learned from.
        epochs: usize = 4, Whole(1, 100), "times";
        /// Updates in an epoch.
        minibatches: usize = 8, Whole(1, 1024), "updates";
        /// By which share chances of actions may move from what they were, before more of it counts for nothing.
        clip: f32 = 0.2, Positive(1.0), "share";
        /// What the entropy of chances counts, at the first step and at the last.
        entropy: [f32; 2] = [0.01, 0.01], Numbers(0.0, 100.0), "factor";
    }

    /// How the weights follow the gradient. There is no target network.
    optimiser: OptimiserConfig = OptimiserConfig {
        learning_rate: 2e-3,
        clip: 0.5,
        average_rate: 0.01,
        ..OptimiserConfig::default()
    }, OPTIMISER;
}

words! {
    /// What a critic values.
    Sees {
        /// The state.
        State = "state",
        /// What each agent sees itself.
        Own = "own",
    }
}

/// A critic of the state.
pub const MAPPO: MethodEntry = MethodEntry {
    name: "mappo",
    about: "Proximal policy optimisation with one policy for all agents and a critic of the state (MAPPO, Yu et al. 2022)",
    keys: |_| KEYS,
    presets: &[Preset { name: "fast", setup: || fast(Sees::State) }],
    flags: &[],
    compared_with: None,
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

/// A critic of what agents see.
pub const IPPO: MethodEntry = MethodEntry {
    name: "ippo",
    about: "The same, whose critic knows no more than each agent itself sees (IPPO, de Witt et al. 2020)",
    presets: &[Preset { name: "fast", setup: || fast(Sees::Own) }],
    ..MAPPO
};

fn fast(critic: Sees) -> Setup {
    let run = RunConfig { steps: 1_000_000, evaluate_every: 50_000, ..RunConfig::default() };
    let mut config = Config::default();
    config.network.critic = critic;
    Setup::of(32, run, &config)
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    if let View::Pictures(_) = spec.view {
        return Some("its agents see entities or vectors, this environment shows a picture");
    }
    (!spec.roles.is_empty())
        .then_some("its agents share one policy, here they have different roles")
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    let width = config.network.width;
    let odd = format!("`network.width` is {width}, must be a multiple of {HEADS}");
    require(width.is_multiple_of(HEADS), &odd)?;
    Ok(Box::new(Mappo::new(config, opening)))
}
