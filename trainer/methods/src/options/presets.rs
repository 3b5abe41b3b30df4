//! What presets of methods that learn from milestones have in common.

use serde::Serialize;
use sortie_learn::configuration::OptimiserConfig;
use sortie_learn::run::RunConfig;
use sortie_learn::session::Setup;

/// Many instances, and a minute of one processor core.
pub(crate) fn fast(config: &impl Serialize) -> Setup {
    let run = RunConfig {
        steps: 5_000_000,
        evaluate_every: 500_000,
        evaluate_episodes: 100,
        ..RunConfig::default()
    };
    Setup::of(256, run, config)
}

/// The published learner of the iron task; its episodes are as long in training as where it is measured.
pub(crate) fn paper(config: &impl Serialize) -> Setup {
    let run = RunConfig {
        steps: 6_000_000,
        evaluate_every: 200_000,
        evaluate_episodes: 100,
        ..RunConfig::default()
    };
    let mut setup = Setup::of(4, run, config);
    setup.environment.settings.insert("training_limit".to_owned(), 4_320_i64.into());
    setup
}

/// How the weights of the preset `fast` follow the gradient.
pub(crate) fn fast_optimiser() -> OptimiserConfig {
    OptimiserConfig { learning_rate_end: 1e-4, ..OptimiserConfig::default() }
}

/// How those of the published learners do, none of which averages weights.
pub(crate) fn paper_optimiser() -> OptimiserConfig {
    OptimiserConfig {
        learning_rate: 6.25e-4,
        learning_rate_end: 6.25e-4,
        epsilon: 1.5e-4,
        target_rate: 0.0,
        average_rate: 1.0,
        ..OptimiserConfig::default()
    }
}
