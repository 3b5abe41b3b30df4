//! The keys that runs of several methods have, and the types of their sections.

use sortie_nn::schedule::linear;

use super::key::Range::{Number, Numbers, OneOf, Positive, Text, Truth, Whole};
use super::key::{Key, Range, Section};
use crate::section;

/// Most environment steps that anything may last.
pub const STEPS: i64 = 1_000_000_000_000;
/// A share or a probability.
pub const SHARE: Range = Number(0.0, 1.0);

/// Where a run of any method learns.
pub const WHERE: [Section; 2] = [
    Section {
        name: "environment",
        about: "The world to learn in.",
        keys: &[
            Key::new("name", "", Text, "Name of the environment."),
            Key::new(
                "set",
                "",
                Text,
                "Starts that episodes are drawn from; empty for the default.",
            ),
            INSTANCES,
            Key::new(
                "failures",
                "probability",
                SHARE,
                "How probable it is in each step that an agent fails: for the rest of the episode it repeats its last action, and allocators leave it out. Evaluations have no failures.",
            ),
        ],
    },
    Section {
        name: "environment.settings",
        about: "Numbers of the rules that differ from the usual ones; which there are is up to the environment.",
        keys: &[],
    },
];

/// Episodes that run at the same time.
pub const INSTANCES: Key = Key::new(
    "instances",
    "episodes",
    Whole(1, 4096),
    "Episodes that run at the same time; one that ends restarts at once, or with all others where whole episodes are learned from.",
);

section! {
    /// How the weights follow the gradient.
    #[serde(default)]
    OptimiserConfig, pub OPTIMISER;

    /// Learning rate of Adam.
    learning_rate: f32 = 1e-3, Number(0.0, 1000.0), "step of Adam";
    /// Learning rate at the end of the run.
    learning_rate_end: f32 = 0.0, Number(0.0, 1000.0), "step of Adam";
    /// When the learning rate begins to go to its end, in a straight line.
    decay_from: f64 = 0.5, SHARE, "share of the run";
    /// Added to Adam's denominator.
    epsilon: f32 = 1e-5, Positive(1.0), "slope";
    /// Largest norm of the gradient; a longer one is shortened.
    clip: f32 = 10.0, Positive(1e9), "norm";
    /// How far the target network moves towards the weights.
    target_rate: f32 = 0.01, SHARE, "share per update";
    /// How far the averaged weights move, which are evaluated and shipped.
    average_rate: f32 = 0.0005, SHARE, "share per update";
}

impl OptimiserConfig {
    /// The learning rate, `step` environment steps into a run of `steps`.
    pub fn learning_rate_at(&self, step: u64, steps: u64) -> f32 {
        let from = (self.decay_from * steps as f64) as u64;
        let (start, end) = (self.learning_rate, self.learning_rate_end);
        if step < from {
            return start;
        }
        linear(start, end, steps.saturating_sub(from), step.saturating_sub(from))
    }
}

section! {
    /// How much the agents try out: a random available action with probability epsilon.
    #[serde(default)]
    ExplorationConfig, pub EXPLORATION;

    /// At the first step.
    start: f32 = 1.0, SHARE, "probability";
    /// From step `steps` on.
    end: f32 = 0.05, SHARE, "probability";
    /// Length of the way down.
    steps: u64 = 60_000, Whole(0, STEPS), "environment steps";
    /// Factors on the probability, dealt to the instances in turn: some act greedily, some more wildly.
    spread: Vec<f32> = vec![0.0, 0.2, 1.0, 2.0], Numbers(0.0, 100.0), "factor";
}

impl ExplorationConfig {
    /// Epsilon before the instances' factors, `step` environment steps into a run.
    pub fn epsilon_at(&self, step: u64) -> f32 {
        linear(self.start, self.end, self.steps, step)
    }
}

/// The keys of exploration, with a sentence about its way down.
pub const fn exploration(steps: &'static str) -> [Key; 4] {
    let mut keys = [EXPLORATION[0], EXPLORATION[1], EXPLORATION[2], EXPLORATION[3]];
    keys[2].about = steps;
    keys
}

section! {
    /// How long to learn, and when to measure and save.
    #[serde(default)]
    RunConfig, OF_RUN;

    /// Folder of a run whose weights this one begins with; empty for a run from scratch.
    from: String = String::new(), Text;
    /// Instructions of matrix products, which decide the last bits of every result; `widest`, what the processor
    /// has, becomes the name of what that is as soon as a run begins.
    products: String = WIDEST.to_owned(), OneOf(&[WIDEST, "avx512", "avx2", "neon", "plain"]);
    /// How long to learn.
    steps: u64 = 600_000, Whole(1, STEPS), "environment steps";
    /// When a run ends that has not taken all steps, evaluations included; what goes by shares of the run follows. 0:
    /// never, and only such runs repeat byte for byte.
    cpu_seconds: f64 = 0.0, Number(0.0, 1e9), "processor seconds";
    /// From one evaluation, and checkpoint, to the next.
    evaluate_every: u64 = 50_000, Whole(1, STEPS), "environment steps";
    /// Greedy episodes of an evaluation.
    evaluate_episodes: usize = 500, Whole(1, 1_000_000), "episodes";
    /// Greedy episodes of the evaluation at the end, fresh ones that were never used before; 0 leaves it out.
    final_episodes: usize = 2_000, Whole(0, 1_000_000), "episodes";
    /// From one checkpoint to the next, besides those of evaluations.
    checkpoint_minutes: f64 = 5.0, Positive(1e6), "minutes";
    /// Whether checkpoints hold the replay, which is most of them. Without it what was learned can be used, and the run
    /// cannot be resumed.
    checkpoint_replay: bool = true, Truth;
}

/// What `run.products` says where the processor decides.
pub const WIDEST: &str = "widest";

/// How long a run of any method learns.
pub const RUN: Section = Section {
    name: "run",
    about: "How long to learn, and when to measure and save.",
    keys: OF_RUN,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learning_rate_stays_and_then_falls() {
        let optimiser = OptimiserConfig {
            learning_rate: 2.0,
            learning_rate_end: 1.0,
            decay_from: 0.5,
            ..OptimiserConfig::default()
        };
        let rates = [0, 50, 75, 100, 200].map(|step| optimiser.learning_rate_at(step, 100));
        assert_eq!(rates, [2.0, 2.0, 1.5, 1.0, 1.0]);
        let constant = OptimiserConfig { decay_from: 1.0, ..optimiser };
        assert_eq!([0, 50, 99].map(|step| constant.learning_rate_at(step, 100)), [2.0; 3]);
    }
}
