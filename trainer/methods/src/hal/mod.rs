//! HAL: hierarchical affordance learning (Costales, Iqbal and Sha 2022; dissertation chapter 6).
//!
//! A meta-controller chooses which milestone to go for, a controller acts until a milestone is reached. Which milestones
//! can be reached next is learned from what happened, and masks the choice.

mod affordances;
mod method;
#[cfg(test)]
mod tests;

use sortie_learn::configuration::Range::{self, Number, Numbers, OneOf, Truth, Whole};
use sortie_learn::configuration::{OPTIMISER, OptimiserConfig, SHARE};
use sortie_learn::session::{MethodEntry, Opening, Preset, Setup};
use sortie_learn::trajectory::End;
use sortie_learn::{LearnError, Method, Now, sections};
use sortie_nn::schedule::linear;

use crate::options::{
    Chances, NONE, Note, Paid, REPLAY, ReturnRules, WEIGHTS, fast_optimiser, fast_setup,
    learned_as, misfit, paper_optimiser, paper_setup,
};

pub use crate::options::{Mask, MaskCounts, Measured, ReplayConfig, WeightsConfig};
pub use crate::pictures::Body;
pub use affordances::tolerance;
pub use method::Hal;

const SIZE: Range = Whole(1, 20_000_000);
const BATCH: Range = Whole(1, 65_536);
const CHANCES: Range = Numbers(0.0, 1.0);

sections! {
    /// Sizes, chances and rates; the default is the preset `fast` of HAL.
    Config, KEYS;

    /// What the three networks are shown, and how wide they are.
    network: NetworkConfig {
        /// Two layers over sparse inputs, or convolutions over the picture as published.
        body: Body = Body::Layers, OneOf(Body::WORDS);
        /// Cells around the agent, each way across, that are shown one by one; odd.
        crop: usize = 5, Whole(1, 15), "cells";
        /// Whether the nearest cell of every kind is shown.
        nearest: bool = true, Truth;
        /// Width of the hidden layers of controller and meta-controller, a multiple of 8.
        width: usize = 64, Whole(8, 1024), "columns";
        /// That of the classifier, whose last hidden layer embeds states; 0: the same.
        embedding: usize = 0, Whole(0, 1024), "columns";
        /// Whether the meta-controller's values are a value of the state and advantages of the milestones.
        dueling: bool = false, Truth;
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
        /// Whether milestones that were never reached count as afforded.
        unreached: bool = false, Truth;
        /// Whether the classifier's loss is the squared error of likelihoods; cross entropy otherwise.
        squared: bool = false, Truth;
        /// Whether triplets, positives and classes are learned from at the start, after three and after six tenths of the
        /// updates from one to the next; all in the same update otherwise.
        apart: bool = false, Truth;
        /// Of the classifier, for each milestone whose positives are measured anew.
        refresh: u64 = 4, SIZE, "updates";
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
        /// What a step costs; the goal is worth 1 less that.
        cost: f32 = 0.0, SHARE, "reward";
        /// Whether rewards are learned as `sign(r) log2(1 + abs(r))`.
        logarithm: bool = false, Truth;
        /// Whether values that are looked up are held between 0 and 1.
        bounded: bool = true, Truth;
        /// Whether steps and options behind which time was over, or nothing could be reached any more, are learned from.
        time_outs: bool = true, Truth;
        /// Of the controller, from one copy of the weights to those that targets are computed by to the next; 0 moves these
        /// by `optimiser.target_rate` in every update.
        target_every: u64 = 0, Whole(0, 20_000_000), "updates";
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
        /// Whether values behind an option are looked up for milestones of the mask only.
        masked: bool = true, Truth;
        /// Of the controller, before the first.
        first: u64 = 0, Whole(0, 20_000_000), "updates";
        /// Of the controller for each.
        every: u64 = 1, SIZE, "updates";
        /// That are drawn by priorities: the latest, of all instances.
        kept: usize = 100_000, SIZE, "options";
        /// In an update.
        batch: usize = 128, BATCH, "options";
        /// Of them, drawn from episodes that were solved.
        solved: f32 = 0.3, SHARE, "share";
    }

    /// How much is tried out: from the first chance to the second in a straight line.
    exploration: ExplorationConfig {
        /// In which goals are drawn.
        first: u64 = 6_400, Whole(0, 20_000_000), "environment steps";
        /// In which actions are drawn; 0: as long as goals are.
        first_actions: u64 = 0, Whole(0, 20_000_000), "environment steps";
        /// From which on chances of goals change.
        start: u64 = 0, Whole(0, 20_000_000), "environment steps";
        /// Over which chances change, those of goals from `start` on.
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

    /// What is kept, and how much of it an update of the controller sees.
    replay: ReplayConfig = ReplayConfig::default(), REPLAY;
    /// What keeps weights small.
    weights: WeightsConfig = WeightsConfig::default(), WEIGHTS;
    /// How the weights follow the gradient.
    optimiser: OptimiserConfig = OptimiserConfig::default(), OPTIMISER;
}

impl AffordancesConfig {
    /// The number of the classifier's update, and whether triplets, positives and classes are due.
    fn due(&self, update: u64) -> (u64, [bool; 3]) {
        let (round, turn) = (update / self.every, update % self.every);
        let is_due = |tenths: u64| turn == if self.apart { self.every * tenths / 10 } else { 0 };
        (round, [is_due(0), is_due(3) && round.is_multiple_of(self.refresh), is_due(6)])
    }
}

impl MeasuredConfig {
    /// Goals are drawn from the mask only.
    fn chances(&self) -> Chances<'static> {
        let Self { actions, goals, varied } = *self;
        Chances { actions, goals: 0.0, afforded: goals, reached: &[], varied }
    }
}

impl ReturnsConfig {
    /// What the goal is worth, and what every other step costs.
    fn worth(&self) -> [f32; 2] {
        [1.0 - self.cost, self.cost].map(|reward| learned_as(reward, self.logarithm))
    }

    fn rules(&self) -> ReturnRules {
        let Self { steps, discount, no_operations, time_outs, .. } = *self;
        ReturnRules { steps, discount, no_operations, time_outs }
    }

    /// What steps are to a goal: its options end by any milestone, and pay for their own. Without hindsight a step that
    /// reached another costs nothing.
    fn paid(&self, goal: u8) -> impl Fn(&Note, End) -> Paid + use<> {
        let ([worth, cost], relabel) = (self.worth(), self.relabel);
        move |note, _| Paid {
            reward: match note.reached {
                NONE => -cost,
                reached if reached == goal => worth,
                _ if relabel => -cost,
                _ => 0.0,
            },
            is_last: note.ends_option,
            is_over: note.reached != NONE,
        }
    }
}

impl ExplorationConfig {
    /// A chance after so many of all environment steps, if it changes from some of them on.
    fn at(&self, [start, end]: [f32; 2], from: u64, now: Now) -> f32 {
        let over = self.share * now.of.saturating_sub(from) as f64;
        linear(start, end, over as u64, now.env_steps.saturating_sub(from))
    }

    /// The chance of a random action.
    fn actions_at(&self, now: Now) -> f32 {
        let first = if self.first_actions == 0 { self.first } else { self.first_actions };
        if now.env_steps < first { 1.0 } else { self.at(self.actions, 0, now) }
    }

    /// The chances of any goal, and of one that is drawn from the mask.
    fn goals_at(&self, mask: Mask, now: Now) -> [f32; 2] {
        let [any, afforded] =
            [self.goals, self.afforded].map(|chances| self.at(chances, self.start, now));
        match mask {
            _ if now.env_steps < self.first => [1.0, 0.0],
            Mask::Learned => [any, afforded],
            Mask::Oracle => [0.0, any + afforded],
            Mask::None => [any, 0.0],
        }
    }
}

impl Config {
    /// The published settings of the iron task (dissertation chapter 6 and the public code).
    fn paper() -> Self {
        let (replay, optimiser) = (ReplayConfig::paper(), paper_optimiser());
        let mut paper = Self { replay, optimiser, ..Self::default() };
        let Self { network, affordances, returns, meta, exploration, .. } = &mut paper;
        (network.body, network.crop, network.nearest) = (Body::Convolution, 11, false);
        (network.width, network.embedding, network.dueling) = (512, 128, true);
        (affordances.unreached, affordances.squared, affordances.apart) = (true, true, true);
        (affordances.refresh, affordances.every) = (1, 10);
        (affordances.triplets, affordances.population) = (32, 1_000);
        (returns.steps, returns.discount, returns.cost) = (10, 0.99, 0.01);
        (returns.logarithm, returns.bounded, returns.time_outs) = (true, false, false);
        (returns.no_operations, returns.mirror) = (false, false);
        returns.target_every = 10_000;
        (meta.discount, meta.step_discount, meta.masked) = (0.99, 1.0, false);
        (meta.first, meta.every, meta.batch) = (1_600, 10, 32);
        (exploration.first_actions, exploration.start) = (400, 25_600);
        exploration.afforded = [0.8, 0.0];
        paper.measured.varied = false;
        paper.weights.decay = 1e-5;
        paper
    }
}

/// HAL: affordances are learned.
pub const HAL: MethodEntry = MethodEntry {
    name: "hal",
    about: "An agent that learns which milestones it can reach, which to go for, and how (HAL, dissertation chapter 6)",
    keys: |_| KEYS,
    presets: &[
        Preset { name: "fast", setup: || fast(Mask::Learned) },
        Preset { name: "paper", setup: || paper(Mask::Learned) },
    ],
    flags: &[],
    compared_with: None,
    in_proportion: &[],
    suit: |_, _, _| {},
    settle_older: |_| {},
    misfit,
    open,
};

/// HAL that is told the truth.
pub const HAL_ORACLE: MethodEntry = MethodEntry {
    name: "hal-oracle",
    about: "The same agent, told which milestones it can reach (oracle mask)",
    presets: &[
        Preset { name: "fast", setup: || fast(Mask::Oracle) },
        Preset { name: "paper", setup: || paper(Mask::Oracle) },
    ],
    ..HAL
};

/// Two levels without a mask.
pub const H_DQN: MethodEntry = MethodEntry {
    name: "h-dqn",
    about: "The same agent, which may go for any milestone at any time (H-Rainbow with HER)",
    presets: &[
        Preset { name: "fast", setup: || fast(Mask::None) },
        Preset { name: "paper", setup: || paper(Mask::None) },
    ],
    ..HAL
};

fn fast(mask: Mask) -> Setup {
    let mut config = Config::default();
    config.affordances.mask = mask;
    if mask == Mask::None {
        // What did best without a mask; with one an option that gains nothing has to cost more.
        config.meta = MetaConfig { options: 10, discount: 0.98, ..config.meta };
    }
    config.optimiser = fast_optimiser();
    fast_setup(&config)
}

fn paper(mask: Mask) -> Setup {
    let mut config = Config::paper();
    config.affordances.mask = mask;
    paper_setup(&config)
}

fn open(opening: &Opening<'_>) -> Result<Box<dyn Method>, LearnError> {
    let config: Config = opening.setup.own()?;
    Ok(Box::new(Hal::new(config, opening)?))
}
