//! What all methods that follow a gradient share: the network that learns, the one that targets are computed by, averaged
//! weights, and one update of all three.
//!
//! A batch is cut into shards. Each of them is a pass of the online network on a tape, its loss, and its gradient; gradients
//! are added in the order of the shards, so that any number of threads gives the same bits. What a shard needs besides, such
//! as the target network's values, it computes on a [spare](Shard::spare) tape without going back through it. Once the
//! largest batch has been seen, an update allocates nothing but what the products' kernels do.
//!
//! Q-learning of one layer, whose target network says what the action is worth that the online network prefers (double
//! Q-learning, van Hasselt et al. 2016):
//!
//! ```
//! # use sortie_learn::learner::{Learner, Loss, Rules};
//! # use sortie_nn::{random::stream, tape::Parameters};
//! # let (seen, next, actions, rewards) = ([0.5; 8 * 3], [0.25; 8 * 3], [1; 8], [1.0; 8]);
//! let mut parameters = Parameters::default();
//! let head = parameters.linear("head", 3, 2, &mut stream(1, 1, 0));
//! let mut learner: Learner<Vec<f32>> = Learner::new(parameters, Rules::default(), 2);
//! // Two shards of four transitions.
//! let report = learner.update(2, 1e-3, |shard| {
//!     let rows = 4 * shard.number..4 * shard.number + 4;
//!     let next = &next[3 * rows.start..3 * rows.end];
//!     let x = shard.pass.input(3, next);
//!     let x = shard.pass.linear(x, head);
//!     let best = |q: &[f32]| u32::from(q[1] > q[0]);
//!     let preferred: Vec<u32> = shard.pass.values(x).chunks(2).map(best).collect();
//!     let mut values = shard.spare.begin_forward(shard.target);
//!     let x = values.input(3, next);
//!     let x = values.linear(x, head);
//!     let worth = values.pick(x, &preferred);
//!     // Every shard has memory of its own, here for its targets.
//!     shard.space.clear();
//!     let targets = rewards[rows.clone()].iter().zip(values.values(worth));
//!     shard.space.extend(targets.map(|(reward, worth)| reward + 0.9 * worth));
//!     let x = shard.pass.input(3, &seen[3 * rows.start..3 * rows.end]);
//!     let x = shard.pass.linear(x, head);
//!     let chosen = shard.pass.pick(x, &actions[rows]);
//!     Loss::of(&mut shard.pass, |pass| pass.squared_error(chosen, &shard.space, 1.0 / 8.0))
//! });
//! # assert!(report.loss > 0.0 && report.gradient_norm > 0.0);
//! ```

use sortie_nn::lanes::in_lanes;
use sortie_nn::layers::elementwise;
use sortie_nn::layers::matrix::Store;
use sortie_nn::optimise::{Adam, AdamRules, RmsProp, clip_norm, move_towards};
use sortie_nn::tape::{Parameters, Pass, Tape, Var};

use crate::configuration::OptimiserConfig;
use crate::error::Result;
use crate::run::UpdateReport;
use crate::state::{State, Tensor};

crate::words! {
    /// How weights follow the gradient.
    Rule {
        /// By its running mean, scaled by the root of its running square.
        Adam = "adam",
        /// By itself, scaled by the root of its running square.
        RmsProp = "rmsprop",
    }
}

/// What an update does with the gradient, and with the weights that follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// How weights follow the gradient.
    pub rule: Rule,
    /// What Adam adds to its denominator, and behind the shortening to the gradient.
    pub adam: AdamRules,
    /// Largest norm of the gradient; a longer one is shortened.
    pub clip: f32,
    /// Updates from one move of the target network to the next.
    pub target_every: u64,
    /// How far it moves then: a share of the way; 1: it becomes a copy.
    pub target_rate: f32,
    /// How far the averaged weights move in every update.
    pub average_rate: f32,
    /// Whether they begin as a plain mean, so that the first weights do not linger.
    pub mean_first: bool,
}

impl From<&OptimiserConfig> for Rules {
    fn from(config: &OptimiserConfig) -> Self {
        let OptimiserConfig { epsilon, clip, target_rate, average_rate, .. } = *config;
        let adam = AdamRules { epsilon, ..AdamRules::default() };
        Self {
            rule: Rule::Adam,
            adam,
            clip,
            target_every: 1,
            target_rate,
            average_rate,
            mean_first: false,
        }
    }
}

impl Default for Rules {
    fn default() -> Self {
        Self::from(&OptimiserConfig::default())
    }
}

/// Networks and optimiser; `S` is what each shard keeps from one update to the next.
#[derive(Debug)]
pub struct Learner<S> {
    /// The network that learns, and explores.
    pub online: Parameters,
    /// The weights that targets are computed by.
    pub target: Vec<f32>,
    /// The averaged weights, which are evaluated and shipped.
    pub average: Vec<f32>,
    rules: Rules,
    optimiser: Optimiser,
    updates: u64,
    threads: usize,
    lanes: Vec<Lane<S>>,
}

/// A part of a batch at work.
#[derive(Debug)]
pub struct Shard<'a, S> {
    /// Its number.
    pub number: usize,
    /// The pass of the online network that the loss is gone back through.
    pub pass: Pass<'a>,
    /// A tape for values, by any of the weights, whose gradients nobody asks for.
    pub spare: &'a mut Tape,
    /// The weights of the online network.
    pub online: &'a [f32],
    /// The weights of the target network.
    pub target: &'a [f32],
    /// What the shard keeps.
    pub space: &'a mut S,
}

/// Which weights shards look by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// Those of the online network.
    Online,
    /// Those of the target network.
    Target,
}

/// What a shard has found.
#[derive(Clone, Copy, Debug)]
pub struct Loss {
    /// The loss that is descended, one number; the whole is the sum over shards.
    pub total: Var,
    /// What is told of it, which is added up as well.
    pub reported: f64,
}

impl Loss {
    /// A loss that is told as it is.
    pub fn of(pass: &mut Pass<'_>, loss: impl FnOnce(&mut Pass<'_>) -> Var) -> Self {
        let total = loss(pass);
        Self { total, reported: pass.values(total)[0].into() }
    }

    /// The part that some values have in the mean squared difference of so many to their targets.
    pub fn mean_square(pass: &mut Pass<'_>, values: Var, targets: &[f32], count: usize) -> Self {
        let pairs = pass.values(values).iter().zip(targets);
        let squares: f64 = pairs.map(|(value, y)| f64::from((value - y) * (value - y))).sum();
        let total = pass.squared_error(values, targets, 1.0 / count as f32);
        Self { total, reported: squares / count as f64 }
    }
}

/// The memory of a shard.
#[derive(Debug, Default)]
struct Lane<S> {
    tape: Tape,
    spare: Tape,
    gradient: Vec<f32>,
    reported: f64,
    space: S,
}

impl<S: Default + Send> Learner<S> {
    /// Begins with these weights, in all three.
    pub fn new(online: Parameters, rules: Rules, threads: usize) -> Self {
        let [target, average] = [online.values.clone(), online.values.clone()];
        let optimiser = Optimiser::new(rules.rule, online.values.len());
        Self { online, target, average, rules, optimiser, updates: 0, threads, lanes: Vec::new() }
    }

    /// Updates that were made.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Makes an update: the gradient of so many shards' losses, shortened, moves the online network, and the others follow.
    ///
    /// # Panics
    /// There is no shard.
    pub fn update(
        &mut self,
        shards: usize,
        learning_rate: f32,
        loss: impl Fn(&mut Shard<'_, S>) -> Loss + Sync,
    ) -> UpdateReport {
        let clip = self.rules.clip;
        self.update_by(shards, learning_rate, loss, |gradient| clip_norm(gradient, clip))
    }

    /// The same, where the gradient of all shards is shortened in a way of its own; `shorten` returns its norm before.
    ///
    /// # Panics
    /// There is no shard.
    pub fn update_by(
        &mut self,
        shards: usize,
        learning_rate: f32,
        loss: impl Fn(&mut Shard<'_, S>) -> Loss + Sync,
        shorten: impl FnOnce(&mut [f32]) -> f32,
    ) -> UpdateReport {
        self.in_shards(shards, |[online, target], number, lane| {
            let Lane { tape, spare, gradient, reported, space } = lane;
            let pass = tape.begin(online);
            let mut shard = Shard { number, pass, spare, online, target, space };
            let loss = loss(&mut shard);
            *reported = loss.reported;
            gradient.clear();
            gradient.resize(online.len(), 0.0);
            shard.pass.backward(loss.total, gradient);
        });
        let Self { online, target, average, rules, optimiser, updates, lanes, .. } = self;
        let (first, others) = lanes[..shards].split_first_mut().expect("a batch has shards");
        for other in others {
            elementwise::scale(1.0, &other.gradient, Store::Add, &mut first.gradient);
            first.reported += other.reported;
        }
        let gradient_norm = shorten(&mut first.gradient);
        optimiser.step(rules.adam, &mut online.values, &first.gradient, learning_rate);
        *updates += 1;
        if updates.is_multiple_of(rules.target_every) {
            come_nearer(target, &online.values, rules.target_rate);
        }
        let least = if rules.mean_first { 1.0 / *updates as f32 } else { 0.0 };
        come_nearer(average, &online.values, rules.average_rate.max(least));
        UpdateReport { loss: first.reported, gradient_norm }
    }

    /// Has every shard look at its part of a batch by these weights, without learning from it. What it finds stands in its
    /// [space](Self::spaces) then.
    pub fn look(&mut self, shards: usize, by: By, look: impl Fn(&mut Shard<'_, S>) + Sync) {
        self.in_shards(shards, |[online, target], number, lane| {
            let Lane { tape, spare, space, .. } = lane;
            let pass = tape.begin(if by == By::Target { target } else { online });
            look(&mut Shard { number, pass, spare, online, target, space });
        });
    }

    fn in_shards(&mut self, shards: usize, work: impl Fn([&[f32]; 2], usize, &mut Lane<S>) + Sync) {
        let Self { online, target, threads, lanes, .. } = self;
        lanes.resize_with(shards.max(lanes.len()), Lane::default);
        in_lanes(*threads, &mut lanes[..shards], |number, lane| {
            work([&online.values, target], number, lane);
        });
    }

    /// What each shard keeps, of as many as the largest batch had.
    pub fn spaces(&self) -> impl ExactSizeIterator<Item = &S> {
        self.lanes.iter().map(|lane| &lane.space)
    }

    /// Targets are computed by the weights of now, whatever the rules say.
    pub fn copy_to_target(&mut self) {
        self.target.copy_from_slice(&self.online.values);
    }

    /// The gradient of the last update, as the optimiser saw it; empty before the first.
    pub fn gradient(&self) -> &[f32] {
        self.lanes.first().map_or(&[], |lane| &lane.gradient)
    }

    /// Names everything that later updates depend on.
    pub fn state(&mut self, state: &mut State<'_>) -> Result<()> {
        self.state_as(state, |part| part.to_owned())
    }

    /// The same of one of several learners, by these names for `online`, `target`, `average` and what the optimiser keeps.
    /// Averaged weights are not written where they are copies.
    ///
    /// # Errors
    /// A checkpoint has other tensors.
    pub fn state_as(&mut self, state: &mut State<'_>, name: impl Fn(&str) -> String) -> Result<()> {
        let tensors = self.online.tensors().to_vec();
        let Self { online, target, average, .. } = self;
        state.tensors(&name("online"), &tensors, &mut online.values)?;
        state.tensors(&name("target"), &tensors, target)?;
        if self.rules.average_rate < 1.0 {
            state.tensors(&name("average"), &tensors, average)?;
        } else {
            average.copy_from_slice(&online.values);
        }
        self.optimiser.state(state, &tensors, &name)?;
        state.value(&name("updates"), &mut self.updates)
    }
}

/// Moves weights a share of the way; the whole way without rounding.
fn come_nearer(weights: &mut [f32], to: &[f32], rate: f32) {
    if rate < 1.0 {
        move_towards(weights, to, rate);
    } else {
        weights.copy_from_slice(to);
    }
}

#[derive(Clone, Debug)]
enum Optimiser {
    Adam(Adam),
    RmsProp(RmsProp),
}

impl Optimiser {
    fn new(rule: Rule, parameters: usize) -> Self {
        match rule {
            Rule::Adam => Self::Adam(Adam::new(parameters)),
            Rule::RmsProp => Self::RmsProp(RmsProp::new(parameters)),
        }
    }

    fn step(
        &mut self,
        rules: AdamRules,
        parameters: &mut [f32],
        gradient: &[f32],
        learning_rate: f32,
    ) {
        match self {
            Self::Adam(adam) => adam.step(rules, parameters, gradient, learning_rate),
            Self::RmsProp(rule) => rule.step(parameters, gradient, learning_rate),
        }
    }

    fn state(
        &mut self,
        state: &mut State<'_>,
        tensors: &[Tensor],
        name: impl Fn(&str) -> String,
    ) -> Result<()> {
        match self {
            Self::Adam(adam) => {
                state.tensors(&name("adam-mean"), tensors, &mut adam.mean)?;
                state.tensors(&name("adam-square"), tensors, &mut adam.square)?;
                state.value(&name("adam-steps"), &mut adam.steps)
            }
            Self::RmsProp(rule) => state.tensors(&name("square"), tensors, &mut rule.square),
        }
    }
}

#[cfg(test)]
mod tests {
    use sortie_nn::gradient_check::random;
    use sortie_nn::random::stream;
    use sortie_nn::tape::Linear;

    use super::*;

    fn learner(rules: Rules, threads: usize) -> (Learner<()>, [Linear; 2]) {
        let (mut parameters, drawn) = (Parameters::default(), &mut stream(3, 1, 0));
        let layers =
            [parameters.linear("hidden", 6, 16, drawn), parameters.linear("head", 16, 3, drawn)];
        (Learner::new(parameters, rules, threads), layers)
    }

    const ROWS: usize = 40;

    /// One update on a batch in shards of so many rows.
    fn update((learner, layers): &mut (Learner<()>, [Linear; 2]), rows: usize) -> UpdateReport {
        let (x, targets) = (random(1, 6 * ROWS), random(2, 3 * ROWS));
        learner.update(ROWS / rows, 0.01, |shard| {
            let range = shard.number * rows..(shard.number + 1) * rows;
            let x = shard.pass.input(6, &x[range.start * 6..range.end * 6]);
            let x = shard.pass.linear_rectified(x, layers[0]);
            let y = shard.pass.linear(x, layers[1]);
            let targets = &targets[range.start * 3..range.end * 3];
            Loss::of(&mut shard.pass, |pass| pass.squared_error(y, targets, 1.0 / ROWS as f32))
        })
    }

    #[test]
    fn any_number_of_threads_gives_the_same_weights() {
        let weights = |threads| {
            let mut learner = learner(Rules::default(), threads);
            let reports = [(); 3].map(|()| update(&mut learner, 5));
            (reports, learner.0.online.values, learner.0.target, learner.0.average)
        };
        let one = weights(1);
        assert!(one.0[0].loss > one.0[2].loss, "{:?}", one.0);
        assert_eq!(one, weights(2));
        assert_eq!(one, weights(4));
    }

    #[test]
    fn the_gradient_and_the_loss_are_those_of_the_whole_batch() {
        let of = |rows| update(&mut learner(Rules::default(), 1), rows);
        let (whole, parts) = (of(ROWS), of(4));
        assert!(whole.gradient_norm > 0.1 && whole.loss > 0.1, "{whole:?}");
        assert!((whole.gradient_norm - parts.gradient_norm).abs() < 1e-5, "{whole:?} {parts:?}");
        assert!((whole.loss - parts.loss).abs() < 1e-5, "{whole:?} {parts:?}");
    }

    #[test]
    fn a_gradient_that_is_too_long_is_shortened() {
        let moved = |clip| {
            let rules = Rules { rule: Rule::RmsProp, clip, ..Rules::default() };
            let mut learner = learner(rules, 1);
            let Optimiser::RmsProp(rule) = &learner.0.optimiser else { panic!("RMSprop") };
            assert!(rule.square.iter().all(|square| *square == 0.0));
            update(&mut learner, ROWS);
            let Optimiser::RmsProp(rule) = &learner.0.optimiser else { panic!("RMSprop") };
            rule.square.iter().sum::<f32>().sqrt()
        };
        let (free, short) = (moved(1e9), moved(0.01));
        // RMSprop keeps a hundredth of the squares.
        assert!((short - 0.1 * 0.01).abs() < 1e-5, "{short}");
        assert!(free > 10.0 * short, "{free} {short}");
    }

    #[test]
    fn weights_that_decay_come_down_to_zero_and_never_to_denormal_numbers() {
        let still = |decay: f32, weight: f32, clip: f32| {
            let adam = AdamRules { decay, epsilon: 1e-8, ..AdamRules::default() };
            let rules = Rules { adam, clip, ..Rules::default() };
            let mut learner = learner(rules, 1);
            learner.0.online.values.fill(weight);
            let loss = |shard: &mut Shard<'_, ()>| {
                // A loss that depends on no weight.
                let x = shard.pass.leaf(1, &[1.0]);
                Loss::of(&mut shard.pass, |pass| pass.sum_rows(x))
            };
            for _ in 0..4 {
                learner.0.update(1, 1e-3, loss);
            }
            learner.0.online.values[7]
        };
        assert_eq!(still(0.0, 0.3, 1.0), 0.3);
        // Adam's first steps are of one length, whatever the slope; the norm that is shortened is that of the loss.
        for clip in [1.0, 1e-30] {
            assert!((still(1e-3, 0.3, clip) - (0.3 - 4e-3)).abs() < 1e-5);
        }
        assert_eq!(still(1e-30, 9e-21, 1.0), 0.0);
    }

    #[test]
    fn what_shards_keep_can_be_looked_at_and_targets_are_copied_when_that_is_asked_for() {
        let (parameters, layers) = {
            let learner = learner(Rules::default(), 1);
            (learner.0.online, learner.1)
        };
        let rules = Rules { target_rate: 0.0, ..Rules::default() };
        let mut learner: Learner<Vec<usize>> = Learner::new(parameters, rules, 2);
        learner.update(3, 0.1, |shard| {
            shard.space.push(shard.number);
            let x = shard.pass.input(6, &random(1, 6));
            let y = shard.pass.linear(x, layers[0]);
            Loss::of(&mut shard.pass, |pass| pass.squared_error(y, &[0.0; 16], 1.0))
        });
        assert!(learner.spaces().eq([&[0][..], &[1], &[2]]));
        assert!(learner.target != learner.online.values);
        learner.copy_to_target();
        assert!(learner.target == learner.online.values);
    }

    #[test]
    fn the_target_network_moves_every_so_many_updates_and_averages_always() {
        let rules =
            Rules { target_every: 3, target_rate: 1.0, average_rate: 0.25, ..Rules::default() };
        let mut learner = learner(rules, 1);
        let first = learner.0.target.clone();
        let mut average = first.clone();
        for number in 1..=4 {
            update(&mut learner, ROWS);
            let Learner { online, target, average: own, .. } = &learner.0;
            assert_eq!(*target == online.values, number == 3, "{number}");
            assert_eq!(*target == first, number < 3, "{number}");
            move_towards(&mut average, &online.values, 0.25);
            assert_eq!(*own, average);
        }
        assert_eq!(learner.0.updates(), 4);
    }

    #[test]
    fn averaged_weights_may_begin_as_a_plain_mean() {
        let rules = Rules { average_rate: 0.25, mean_first: true, ..Rules::default() };
        let mut learner = learner(rules, 1);
        let mut all = Vec::new();
        for number in 1..=5 {
            let before = learner.0.average.clone();
            update(&mut learner, ROWS);
            let Learner { online, average, .. } = &learner.0;
            all.push(online.values[7]);
            let mean = all.iter().sum::<f32>() / number as f32;
            let moved = before[7] + 0.25 * (online.values[7] - before[7]);
            let want = if number > 4 { moved } else { mean };
            assert!((average[7] - want).abs() < 1e-6, "{number}");
        }
    }

    #[test]
    fn a_gradient_may_be_shortened_in_another_way() {
        let (mut learner, layers) = learner(Rules::default(), 1);
        let (first, x, targets) = (learner.online.clone(), random(1, 6), random(2, 3));
        let loss = |shard: &mut Shard<'_, ()>| {
            let x = shard.pass.input(6, &x);
            let x = shard.pass.linear_rectified(x, layers[0]);
            let y = shard.pass.linear(x, layers[1]);
            Loss::of(&mut shard.pass, |pass| pass.squared_error(y, &targets, 1.0))
        };
        let report = learner.update_by(2, 0.1, loss, |gradient| {
            assert!(clip_norm(gradient, 1e9) > 0.1);
            gradient.fill(0.0);
            7.0
        });
        assert_eq!((report.gradient_norm, &learner.online), (7.0, &first));
        assert!(learner.gradient().iter().all(|slope| *slope == 0.0));
        assert_eq!(learner.gradient().len(), first.values.len());
    }

    #[test]
    fn shards_look_by_the_weights_that_are_asked_for() {
        let mut parameters = Parameters::default();
        let layer = parameters.linear("layer", 1, 1, &mut stream(3, 1, 0));
        let mut learner: Learner<f32> = Learner::new(parameters, Rules::default(), 2);
        (learner.online.values, learner.target) = (vec![3.0, 0.0], vec![2.0, 1.0]);
        for (by, want) in [(By::Online, [0.0, 3.0, 6.0]), (By::Target, [1.0, 3.0, 5.0])] {
            learner.look(3, by, |Shard { number, pass, space, .. }| {
                let x = pass.input(1, &[*number as f32]);
                let y = pass.linear(x, layer);
                **space = pass.values(y)[0];
            });
            assert_eq!(learner.spaces().copied().collect::<Vec<_>>(), want);
        }
        assert_eq!(learner.updates(), 0);
    }

    #[test]
    fn one_of_several_learners_has_names_of_its_own_and_no_copy_of_its_weights() {
        let rules = Rules { average_rate: 1.0, ..Rules::default() };
        let (mut one, mut other) = (learner(rules, 1), learner(rules, 1));
        update(&mut one, ROWS);
        let name = |part: &str| format!("critic-{part}");
        let mut written = crate::run::checkpoint::Written::default();
        one.0.state_as(&mut State::write(&mut written), name).unwrap();
        let names = written.tensors.iter().map(|(name, ..)| name.split('/').next().unwrap());
        let mut names: Vec<&str> = names.collect();
        names.dedup();
        let want = ["critic-online", "critic-target", "critic-adam-mean", "critic-adam-square"];
        assert_eq!(names, want);
        let folder = tempfile::tempdir().unwrap();
        let place = crate::run::Checkpoints::new(folder.path()).write(1, &written).unwrap();
        let purpose = crate::run::checkpoint::OpenFor::Use;
        let found = crate::run::Checkpoint::open(&place, purpose).unwrap();
        other.0.state_as(&mut State::weights(&found), name).unwrap();
        assert_eq!(other.0.average, one.0.online.values);
    }

    #[test]
    fn what_is_named_is_what_updates_depend_on() {
        for rule in [Rule::Adam, Rule::RmsProp] {
            let rules = Rules { rule, target_every: 2, ..Rules::default() };
            let (mut one, mut other) = (learner(rules, 1), learner(rules, 1));
            update(&mut one, ROWS);
            let mut written = crate::run::checkpoint::Written::default();
            let name = |part: &str| format!("one/{part}");
            one.0.state_as(&mut State::write(&mut written), name).unwrap();
            let second = |part: &str| format!("two/{part}");
            learner(rules, 1).0.state_as(&mut State::write(&mut written), second).unwrap();
            let folder = tempfile::tempdir().unwrap();
            let checkpoints = crate::run::Checkpoints::new(folder.path());
            let place = checkpoints.write(1, &written).unwrap();
            let found =
                crate::run::Checkpoint::open(&place, crate::run::checkpoint::OpenFor::Resume);
            let (found, values) = (found.unwrap(), written.values);
            other.0.state_as(&mut State::read(&found, &values), name).unwrap();
            update(&mut one, ROWS);
            update(&mut other, ROWS);
            assert_eq!(one.0.online, other.0.online);
            assert_eq!((one.0.target, one.0.average), (other.0.target, other.0.average));
        }
    }
}
