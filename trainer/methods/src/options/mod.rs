//! Agents that learn from milestones: how their options are played, kept, and learned from.

mod deployed;
mod learning;
mod play;
mod replay;
mod returns;
#[cfg(test)]
pub(crate) mod tests;

use serde::Serialize;
use sortie_envs::{Spec, View};
use sortie_learn::configuration::Range::{Number, Numbers, Whole};
use sortie_learn::configuration::{OptimiserConfig, SHARE, require};
use sortie_learn::learner::Rules;
use sortie_learn::run::RunConfig;
use sortie_learn::session::Setup;
use sortie_learn::{LearnError, Now, section};
use sortie_nn::optimise::AdamRules;
use sortie_nn::schedule::linear;

use crate::pictures::{Body, Shown};

pub(crate) use deployed::deployed;
pub(crate) use learning::{Lesson, Lessons, QNetwork};
pub(crate) use play::{Actors, Chances, Chooser, Recorder};
pub use play::{Mask, MaskCounts, Measured};
pub(crate) use replay::{Finished, NONE, Note, OptionPlace, Replay};
pub(crate) use returns::{Next, Paid, ReturnRules, returns};

section! {
    /// What is kept, and how much of it an update of the controller sees.
    ReplayConfig, pub(crate) REPLAY;

    /// Kept, of all instances.
    capacity: usize = 5_200_000, Whole(1, 1_000_000_000), "steps";
    /// In an update.
    batch: usize = 256, Whole(1, 65_536), "steps";
    /// Of them, drawn from options that reached a milestone, every milestone as often.
    reached: f32 = 0.5, SHARE, "share";
    /// Power of the last error that steps and options are drawn by; 0 draws evenly, but for what `reached` and such keys
    /// say.
    priorities: f64 = 0.0, SHARE, "exponent";
    /// How far losses make up for that, from the start of the run to its end in a straight line.
    importance: [f32; 2] = [0.0, 0.0], Numbers(0.0, 1.0), "exponent";
    /// Before the first update; 0: as long as all is drawn.
    first: u64 = 0, Whole(0, 20_000_000), "environment steps";
    /// From one update to the next.
    steps_per_update: u64 = 256, Whole(1, 20_000_000), "environment steps";
}

section! {
    /// What keeps weights small.
    WeightsConfig, pub(crate) WEIGHTS;

    /// What a weight adds to its slope.
    decay: f32 = 0.0, Number(0.0, 1.0), "slope per weight";
}

impl ReplayConfig {
    /// Those of the published learners.
    pub(crate) fn paper() -> Self {
        Self {
            capacity: 1_000_000,
            batch: 32,
            priorities: 0.4,
            importance: [0.6, 1.0],
            first: 400,
            steps_per_update: 4,
            ..Self::default()
        }
    }

    /// Updates that are due so far, where so many first steps are drawn.
    pub(crate) fn due(&self, drawn: u64, now: Now) -> u64 {
        let first = if self.first == 0 { drawn } else { self.first };
        now.env_steps.saturating_sub(first) / self.steps_per_update
    }

    /// How far losses make up for priorities by now.
    pub(crate) fn importance_at(&self, now: Now) -> f32 {
        let [start, end] = self.importance;
        linear(start, end, now.of, now.env_steps)
    }

    /// What each of so many instances keeps, of options of so many steps.
    ///
    /// # Errors
    /// It is too little.
    pub(crate) fn kept(&self, instances: usize, option_steps: u8) -> Result<usize, LearnError> {
        let kept = self.capacity / instances;
        let few = format!("`replay.capacity` leaves {kept} steps for each instance, too few");
        require(kept > 2 * usize::from(option_steps), &few).map(|()| kept)
    }
}

/// What networks are shown: a body, cells each way across, and whether the nearest; with their widths by their keys.
///
/// # Errors
/// There can be no such networks, or the picture has no such middle.
pub(crate) fn shown(
    spec: &Spec,
    body: Body,
    (crop, nearest): (usize, bool),
    widths: &[(&str, usize)],
) -> Result<Shown, LearnError> {
    for (key, width) in widths {
        let odd = format!("`network.{key}` is {width}, must be a multiple of 8");
        require(width.is_multiple_of(8), &odd)?;
    }
    require(
        body != Body::Convolution || (crop >= Body::SIDE && !nearest),
        &format!(
            "`network.body=convolution` goes over a picture: set `network.nearest=false` and `network.crop` to at least {}",
            Body::SIDE
        ),
    )?;
    Shown::new(spec, crop, nearest, body == Body::Convolution).ok_or_else(|| {
        LearnError::Config(format!("`network.crop` is {crop}: the picture has no such middle"))
    })
}

/// How weights follow the gradient.
pub(crate) fn rules(optimiser: &OptimiserConfig, weights: &WeightsConfig) -> Rules {
    let rules = Rules::from(optimiser);
    Rules { adam: AdamRules { decay: weights.decay, ..rules.adam }, ..rules }
}

/// A reward as it is learned: `sign(r) log2(1 + abs(r))` where that is wanted.
pub(crate) fn learned_as(reward: f32, logarithm: bool) -> f32 {
    if logarithm { (1.0 + reward.abs()).log2().copysign(reward) } else { reward }
}

/// Why an environment is not one for agents that learn from milestones.
pub(crate) fn misfit(spec: &Spec) -> Option<&'static str> {
    if !matches!(spec.view, View::Pictures(_)) {
        return Some("its agent sees a picture, this environment shows something else");
    }
    (!(1..=24).contains(&spec.milestones.len()))
        .then_some("it learns from milestones, of which this environment tells none")
}

/// Many instances, and a minute of one processor core.
pub(crate) fn fast_setup(config: &impl Serialize) -> Setup {
    let run = RunConfig {
        steps: 5_000_000,
        evaluate_every: 500_000,
        evaluate_episodes: 100,
        ..RunConfig::default()
    };
    Setup::of(256, run, config)
}

/// The published learner of the iron task; its episodes are as long in training as where it is measured.
pub(crate) fn paper_setup(config: &impl Serialize) -> Setup {
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
