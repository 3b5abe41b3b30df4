//! A centralized allocator that is all there is to learn: agents do what they are given by their environment's script
//! (dissertation section 7.4, figure 7.3).
//!
//! The preset `fast` points at subtasks by an attention model, and learns from whole episodes: several of one start, of which
//! each is as good as it is better than the others (REINFORCE, Williams 1992, with what Kwon et al. 2020 compare an
//! episode with). The preset `paper` draws proposals, of which a critic takes the best.

mod agents;
mod aql;
mod deciding;
mod export;
mod greedy;
mod method;
mod network;
#[cfg(test)]
mod tests;

use sortie_envs::{Spec, View};
use sortie_learn::configuration::Range::{Number, Whole};
use sortie_learn::configuration::{OPTIMISER, OptimiserConfig};
use sortie_learn::run::RunConfig;
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::subtasks::{
    Allocate, AllocatorNetworks, LearnedAllocator, ScriptedAgents, Subtasks,
};
use sortie_learn::{LearnError, Method, section, sections};
use toml::Table;

section! {
    /// Encoder of subtasks and decoder of agents.
    NetworkConfig, NETWORK;

    /// Width of embedding and attention, a multiple of 4.
    width: usize = 64, Whole(4, 1024), "columns";
    /// Layers of the encoder.
    layers: usize = 2, Whole(1, 16), "layers";
}

sections! {
    /// Sizes and rates; the default is the preset `fast`.
    Config, KEYS;

    /// Encoder of subtasks and decoder of agents.
    network: NetworkConfig = NetworkConfig::default(), NETWORK;

    /// What an episode is compared with.
    baseline: BaselineConfig {
        /// Episodes from one start; what they earned on average is the baseline of each. `environment.instances` are a multiple
        /// of it.
        samples: usize = 8, Whole(2, 1024), "episodes";
        /// What the entropy of chances counts.
        entropy: f32 = 0.01, Number(0.0, 100.0), "factor";
    }

    /// How the weights follow the gradient. There is no target network.
    optimiser: OptimiserConfig = optimiser(), OPTIMISER;
}

/// How the weights of both presets follow the gradient.
fn optimiser() -> OptimiserConfig {
    OptimiserConfig {
        learning_rate: 1e-3,
        learning_rate_end: 3e-5,
        decay_from: 0.3,
        clip: 1.0,
        average_rate: 0.01,
        ..OptimiserConfig::default()
    }
}

/// An allocator alone.
pub const ALLOCATOR: MethodEntry = MethodEntry {
    name: "allocator",
    about: "A centralized allocator alone, whose agents follow their environment's script (dissertation section 7.4)",
    keys: |own| if has_critic(own) { aql::KEYS } else { KEYS },
    presets: &[Preset { name: "fast", setup: fast }, Preset { name: "paper", setup: aql::paper }],
    flags: &[],
    compared_with: None,
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

fn fast() -> Setup {
    let run = RunConfig { steps: 12_000_000, evaluate_every: 1_000_000, ..RunConfig::default() };
    Setup::of(256, run, &Config::default())
}

/// Whether it learns by proposals and a critic.
fn has_critic(own: &Table) -> bool {
    own.get("learner").and_then(toml::Value::as_str) == Some("aql")
}

fn misfit(spec: &Spec) -> Option<&'static str> {
    if spec.view != View::Entities || spec.rules.is_empty() {
        return Some("it allocates agents to subtasks, and there are none here");
    }
    if spec.fixed == 0 {
        return Some(
            "it knows subtasks by what stays as it is in an episode, and nothing does here",
        );
    }
    let aims = "its agents head for their subtasks, and no action is aimed at anything here";
    spec.targets.is_empty().then_some(aims)
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    if has_critic(&opening.setup.own) {
        return Ok(Box::new(aql::Aql::new(opening.setup.own()?, opening)?));
    }
    Ok(Box::new(method::Allocator::new(opening.setup.own()?, opening)?))
}

/// Agents that follow their environment's script, and an allocator that decides at every step by this network and these weights.
fn scripted<'a>(
    allocate: impl Allocate + 'a,
    (network, weights): (&'a network::Network, &'a [f32]),
) -> Subtasks<'a> {
    let write = move |most, contract| export::graphs(network, weights, most, contract);
    let allocator = LearnedAllocator {
        allocate: Box::new(allocate),
        networks: AllocatorNetworks::Pointing(Box::new(write)),
        team_max: None,
    };
    let agents = Box::new(ScriptedAgents::new(0));
    Subtasks { agents, are_seen: true, interval: 1, allocator: Some(allocator) }
}
