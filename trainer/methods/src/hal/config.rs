//! What a run of HAL leaves open.

use sortie_learn::configuration::Range::{self, Number, Numbers, OneOf, Truth, Whole};
use sortie_learn::configuration::{OPTIMISER, OptimiserConfig, SHARE};
use sortie_learn::sections;
use sortie_nn::schedule::linear;

use crate::options::{Mask, ReturnRules};

const SIZE: Range = Whole(1, 20_000_000);
const BATCH: Range = Whole(1, 65_536);
const CHANCES: Range = Numbers(0.0, 1.0);

sections! {
    /// Sizes, chances and rates; the default is the preset `fast` of HAL.
    Config, KEYS;

    /// What the three networks are shown, and how wide they are.
    network: NetworkConfig {
        /// Cells around the agent, each way across, that are shown one by one; odd.
        crop: usize = 5, Whole(1, 15), "cells";
        /// Whether the nearest cell of every kind is shown.
        nearest: bool = true, Truth;
        /// Width of the two hidden layers, a multiple of 8.
        width: usize = 64, Whole(8, 1024), "columns";
        /// Inputs that differ from zero, which the first weights are sized for.
        active_inputs: usize = 30, Whole(1, 4096), "columns";
    }

    /// Which milestones can be gone for.
    affordances: AffordancesConfig {
        /// What hides milestones: a classifier, the truth, or nothing.
        mask: Mask = Mask::Learned, OneOf(Mask::WORDS);
        /// From where on a milestone counts as afforded.
        threshold: f32 = 0.5, Number(0.001, 0.999), "likelihood";
        /// Whether negatives that look like positives are left out.
        filter: bool = true, Truth;
        /// Updates of the controller for each of the classifier.
        every: u64 = 4, SIZE, "updates";
        /// Kept of each milestone, reached and missed.
        kept: usize = 50_000, SIZE, "states";
        /// That shape the embedding in an update.
        triplets: usize = 64, Whole(0, 65_536), "triplets";
        /// How far apart states of a triplet that belong together are, a deviation.
        spread: f32 = 7.0, Number(0.5, 1000.0), "steps";
        /// Of each milestone in an update.
        batch: usize = 32, BATCH, "states";
        /// Positives on each side that tell how far apart positives are.
        population: usize = 300, Whole(2, 65_536), "states";
    }

    /// How what the controller does becomes targets.
    returns: ReturnsConfig {
        /// Steps after which an option is over without a milestone.
        option_steps: u8 = 51, Whole(1, 254), "steps";
        /// Steps before a target bootstraps.
        steps: u8 = 3, Whole(1, 254), "steps";
        /// Worth of a milestone one step later.
        discount: f32 = 0.93, SHARE, "factor per step";
        /// Whether what an option reached is learned from as if it had been its goal.
        relabel: bool = true, Truth;
        /// Whether actions that change nothing are worth nothing.
        no_operations: bool = true, Truth;
        /// Whether states are shown left for right half of the time.
        mirror: bool = true, Truth;
    }

    /// How the meta-controller learns.
    meta: MetaConfig {
        /// Options before a target bootstraps.
        options: usize = 3, Whole(1, 1000), "options";
        /// Worth of the task one option later.
        discount: f32 = 0.95, SHARE, "factor per option";
        /// Worth of the task one environment step later, besides.
        step_discount: f32 = 0.995, SHARE, "factor per step";
        /// In an update.
        batch: usize = 128, BATCH, "options";
        /// Of them, drawn from episodes that were solved.
        solved: f32 = 0.3, SHARE, "share";
    }

    /// What is kept, and how much of it an update of the controller sees.
    replay: ReplayConfig {
        /// Kept, of all instances.
        capacity: usize = 5_200_000, Whole(1, 1_000_000_000), "steps";
        /// In an update.
        batch: usize = 256, BATCH, "steps";
        /// Of them, drawn from options that reached a milestone, every milestone as often.
        reached: f32 = 0.5, SHARE, "share";
        /// From one update to the next.
        steps_per_update: u64 = 256, SIZE, "environment steps";
    }

    /// How much is tried out: from the first chance to the second in a straight line.
    exploration: ExplorationConfig {
        /// In which everything is drawn.
        first: u64 = 6_400, Whole(0, 20_000_000), "environment steps";
        /// Over which chances change.
        share: f64 = 0.8, SHARE, "share of the run";
        /// Of a random action.
        actions: [f32; 2] = [0.5, 0.05], CHANCES, "probability";
        /// Of any milestone as a goal.
        goals: [f32; 2] = [0.2, 0.05], CHANCES, "probability";
        /// Of a goal that is drawn from the mask, what was seldom reached more often.
        afforded: [f32; 2] = [0.8, 0.2], CHANCES, "probability";
    }

    /// How much of chance is left where agents are measured.
    measured: MeasuredConfig {
        /// Of a random action.
        actions: f32 = 0.05, SHARE, "probability";
        /// Of a random goal, from the mask where there is one.
        goals: f32 = 0.05, SHARE, "probability";
        /// Whether a view that is met again within an option is answered by the next best action, and a goal that was missed
        /// waits for others.
        varied: bool = true, Truth;
    }

    also:
    /// How the weights follow the gradient.
    optimiser: OptimiserConfig = OPTIMISER;
}

impl ReturnsConfig {
    pub(super) fn rules(&self) -> ReturnRules {
        let Self { steps, discount, no_operations, .. } = *self;
        ReturnRules { steps, discount, no_operations }
    }
}

impl ExplorationConfig {
    /// A chance after so many of all environment steps.
    pub fn at(&self, [start, end]: [f32; 2], step: u64, of: u64) -> f32 {
        linear(start, end, (self.share * of as f64) as u64, step)
    }
}
