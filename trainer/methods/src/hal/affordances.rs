//! Which milestones can be reached next, learned from what options came to; and false negatives: states that look like
//! positives though something else happened (dissertation section 6.3).

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::{below, chance};
use sortie_learn::Learner;
use sortie_learn::learner::{Loss, Rules, Shard};
use sortie_learn::trajectory::Place;
use sortie_nn::layers::SparseRows;
use sortie_nn::random::normals;
use sortie_nn::tape::{Pass, Var};

use super::AffordancesConfig;
use crate::options::{Finished, NONE, Replay};
use crate::pictures::{Network, NetworkShape, Shown, Space};

/// A state of an option that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Sample {
    /// Where the option started.
    start: Place,
    /// Its place in the option, and the steps of that.
    step: u8,
    steps: u8,
    /// Drawn for the option as a whole: positives of one parity are measured by those of the other.
    parity: bool,
}

impl Sample {
    fn place(&self) -> Place {
        self.start.after(self.step.into())
    }
}

/// States by what their options came to.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Classes {
    kept: usize,
    /// `[milestones][positive or not]`, each a ring with the number of states that it was given.
    samples: Vec<[(usize, Vec<Sample>); 2]>,
}

const POSITIVE: usize = 1;

impl Classes {
    pub(super) fn new(milestones: usize, kept: usize) -> Self {
        Self { kept, samples: vec![Default::default(); milestones] }
    }

    /// Learns of an option: its states could reach what it reached, and could not what it was meant to reach.
    pub(super) fn add(&mut self, option: &Finished, random: &mut Random) {
        let parity = chance(random, 0.5);
        let missed = if option.goal == option.reached { NONE } else { option.goal };
        for (milestone, class) in [(option.reached, POSITIVE), (missed, 1 - POSITIVE)] {
            let Some(classes) = self.samples.get_mut(usize::from(milestone)) else { continue };
            let (count, samples) = &mut classes[class];
            for step in 0..option.steps {
                let Finished { start, steps, .. } = *option;
                let sample = Sample { start, step, steps, parity };
                if samples.len() < self.kept {
                    samples.push(sample);
                } else {
                    samples[*count % self.kept] = sample;
                }
                *count += 1;
            }
        }
    }

    /// Milestones, as bits, with states of a class.
    fn with(&self, class: usize) -> u32 {
        let known = self.samples.iter().enumerate().filter(|(_, it)| !it[class].1.is_empty());
        known.fold(0, |set, (milestone, _)| set | 1 << milestone)
    }

    /// Milestones, as bits, that were reached ever, and those with states of both classes.
    pub(super) fn known(&self) -> [u32; 2] {
        let reached = self.with(POSITIVE);
        [reached, reached & self.with(1 - POSITIVE)]
    }

    /// A state of a milestone and class.
    fn draw(
        &self,
        milestone: usize,
        class: usize,
        replay: &Replay,
        random: &mut Random,
    ) -> Option<Sample> {
        let samples = &self.samples[milestone][class].1;
        let sample = *samples.get(below(random, samples.len()))?;
        replay.steps.has(sample.place()).then_some(sample)
    }

    /// A state of any milestone and class, both drawn evenly.
    fn draw_any(&self, replay: &Replay, random: &mut Random) -> Option<Sample> {
        let milestone = below(random, self.samples.len());
        let classes =
            [0, 1].into_iter().filter(|class| !self.samples[milestone][*class].1.is_empty());
        let class = classes.clone().nth(below(random, classes.count()))?;
        self.draw(milestone, class, replay, random)
    }

    /// Up to so many positives of one parity.
    fn drawn_positives(
        &self,
        milestone: usize,
        parity: bool,
        count: usize,
        replay: &Replay,
        random: &mut Random,
    ) -> Vec<Place> {
        let draws = (0..4 * count).filter_map(|_| self.draw(milestone, POSITIVE, replay, random));
        let meant = draws.filter(|sample| sample.parity == parity);
        meant.map(|sample| sample.place()).take(count).collect()
    }
}

/// A neighbour in time, in the same option.
fn neighbour(sample: Sample, spread: f32, random: &mut Random) -> Option<Place> {
    if sample.steps < 2 {
        return None;
    }
    loop {
        let offset = (spread * normals(random, 1)[0]).round() as i32;
        let step = i32::from(sample.step) + offset;
        if offset != 0 && (0..i32::from(sample.steps)).contains(&step) {
            return Some(sample.start.after(step as usize));
        }
    }
}

/// The network that tells which milestones can be reached, and whose last hidden layer embeds states.
#[derive(Debug)]
pub(super) struct Classifier {
    network: Network,
    pub(super) learner: Learner<SparseRows>,
    space: Space,
}

/// What the classifier learns from.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) config: &'a AffordancesConfig,
    pub(super) classes: &'a Classes,
    pub(super) replay: &'a Replay,
    pub(super) shown: &'a Shown,
}

/// What an update learns from: states of so many triplets, and one for each label, a milestone and whether it could be
/// reached.
#[derive(Debug, Default)]
struct Drawn {
    places: Vec<Place>,
    triplets: usize,
    labels: Vec<(usize, bool)>,
}

impl Classifier {
    pub(super) fn new(shape: NetworkShape, rules: Rules, random: &mut Random) -> Self {
        let (network, parameters) = Network::new(shape, random);
        Self { network, learner: Learner::new(parameters, rules, 1), space: Space::default() }
    }

    /// The network and its weights: the averaged ones, or those that learn.
    pub(super) fn weights(&self, averaged: bool) -> (&Network, &[f32]) {
        let Learner { online, average, .. } = &self.learner;
        (&self.network, if averaged { average } else { &online.values })
    }

    /// Makes an update: of the embedding by triplets, and of the classifier by states of both classes, as far as each is
    /// due. None where nothing is known yet.
    pub(super) fn update(
        &mut self,
        source: Source<'_>,
        populations: &[Population],
        [embeds, classifies]: [bool; 2],
        learning_rate: f32,
        random: &mut Random,
    ) {
        let (network, mut drawn) = (&self.network, Drawn::default());
        if embeds {
            source.draw_triplets(&mut drawn, random);
        }
        if classifies {
            source.draw_labels(&mut drawn, random);
        }
        if !drawn.places.is_empty() {
            self.learner
                .update(1, learning_rate, |shard| source.loss(network, populations, &drawn, shard));
        }
    }

    /// Measures anew how far apart the positives of a milestone are: those of one parity from those of the other.
    pub(super) fn refresh(
        &mut self,
        population: &mut Population,
        milestone: usize,
        Source { config, classes, replay, shown }: Source<'_>,
        random: &mut Random,
    ) {
        let network = (&self.network, &*self.learner.online.values);
        let [members, others] = [false, true].map(|parity| {
            let count = config.population;
            let places = classes.drawn_positives(milestone, parity, count, replay, random);
            let states = places.iter().map(|place| replay.steps.state(*place));
            self.space.hidden(network, shown, states).to_vec()
        });
        if !members.is_empty() && !others.is_empty() {
            *population = Population::new(&members, &others, self.network.width());
        }
    }
}

impl Source<'_> {
    /// Draws states, neighbours in time of theirs, and others.
    fn draw_triplets(self, drawn: &mut Drawn, random: &mut Random) {
        let Self { config, classes, replay, .. } = self;
        for _ in 0..config.triplets {
            let anchor = classes.draw_any(replay, random);
            let near = anchor.and_then(|anchor| neighbour(anchor, config.spread, random));
            let far = classes.draw_any(replay, random);
            if let (Some(anchor), Some(near), Some(far)) = (anchor, near, far) {
                drawn.places.extend([anchor.place(), near, far.place()]);
                drawn.triplets += 1;
            }
        }
    }

    /// Draws states of all milestones whose two classes are known.
    fn draw_labels(self, drawn: &mut Drawn, random: &mut Random) {
        let Self { config, classes, replay, .. } = self;
        let both = classes.known()[1];
        for milestone in (0..classes.samples.len()).filter(|it| both >> it & 1 == 1) {
            for _ in 0..config.batch {
                let is_positive = chance(random, 0.5);
                if let Some(sample) = classes.draw(milestone, is_positive.into(), replay, random) {
                    drawn.places.push(sample.place());
                    drawn.labels.push((milestone, is_positive));
                }
            }
        }
    }

    /// What triplets lose in the mean, and what the states of each milestone do; negatives are left out where they look
    /// like positives.
    fn loss(
        self,
        network: &Network,
        populations: &[Population],
        Drawn { places, triplets, labels }: &Drawn,
        shard: &mut Shard<'_, SparseRows>,
    ) -> Loss {
        let Self { config, replay, shown, .. } = self;
        let Shard { pass, space: rows, .. } = shard;
        rows.clear();
        places.iter().for_each(|place| shown.push(replay.steps.state(*place), false, rows));
        let hidden = network.hidden(pass, rows);
        let embedding = triplet_loss(pass, hidden, *triplets);

        let embedded = pass.values(hidden).chunks_exact(network.width()).skip(3 * triplets);
        let (mut kept, mut milestones, mut wanted) = (Vec::new(), Vec::new(), Vec::new());
        for (row, (state, (milestone, is_positive))) in embedded.zip(labels).enumerate() {
            if *is_positive || !config.filter || !populations[*milestone].holds(state) {
                kept.push(network.place(3 * triplets + row, 0));
                milestones.push(*milestone as u32);
                wanted.push(u32::from(*is_positive));
            }
        }
        let values = network.values(pass, hidden, &kept);
        let logits = pass.pick(values, &milestones);
        let share = 1.0 / config.batch as f32;
        let classes = class_loss(pass, logits, &wanted, (config.squared, share));
        Loss::of(pass, |pass| pass.add(embedding, classes))
    }
}

/// Half the mean square of how much less than 1 a state is nearer to its neighbour than to another, for so many triplets
/// of rows.
fn triplet_loss(pass: &mut Pass<'_>, embedded: Var, triplets: usize) -> Var {
    let [anchor, near, far] = [0, 1, 2].map(|first| {
        let rows: Vec<u32> = (0..triplets).map(|triplet| 3 * triplet as u32 + first).collect();
        pass.gather(embedded, &rows)
    });
    let mut distance = |other: Var| {
        let other = pass.scale(other, -1.0);
        let apart = pass.add(anchor, other);
        let squares = pass.multiply(apart, apart);
        let square = pass.sum_columns(squares);
        // A state may be its own neighbour, where a distance of 0 has no slope.
        let square = pass.offset(square, 1e-12);
        pass.root(square)
    };
    let (near, far) = (distance(near), distance(far));
    let farther = pass.scale(far, -1.0);
    let excess = pass.add(near, farther);
    let excess = pass.offset(excess, 1.0);
    let excess = pass.relu(excess);
    pass.squared_error(excess, &vec![0.0; triplets], 0.5 / triplets.max(1) as f32)
}

/// The cross entropy of likelihoods with what is wanted, 1 or 0, or half the square of the error; each counts a share.
fn class_loss(
    pass: &mut Pass<'_>,
    logits: Var,
    wanted: &[u32],
    (squared, share): (bool, f32),
) -> Var {
    if squared {
        let likelihoods = pass.sigmoid(logits);
        let wanted: Vec<f32> = wanted.iter().map(|wanted| *wanted as f32).collect();
        return pass.squared_error(likelihoods, &wanted, 0.5 * share);
    }
    // A likelihood is the softmax of a logit beside 0.
    let nothing = pass.input(1, &vec![0.0; wanted.len()]);
    let both = pass.concat(&[nothing, logits]);
    let logarithms = pass.log_softmax(both);
    let chosen = pass.pick(logarithms, wanted);
    let sum = pass.scatter(chosen, &vec![0; wanted.len()], 1);
    pass.scale(sum, -share)
}

/// Degrees of freedom, as the public code has them whatever the sample.
const FREEDOM: f64 = 999.0;
/// The percentile that is to be covered, in deviations of a normal distribution: 0.9.
const COVERED: f64 = 1.281_551_6;
/// The confidence, likewise: 0.95.
const CONFIDENCE: f64 = 1.644_853_6;

/// How many deviations above the mean of so many numbers nine tenths of all lie, with a confidence of 0.95: the
/// one-sided tolerance bound of a normal distribution, whose non-central t is approximated in closed form.
pub fn tolerance(numbers: usize) -> f64 {
    let root = (numbers as f64).sqrt();
    let centre = COVERED * root;
    let shrink = CONFIDENCE * CONFIDENCE / (2.0 * FREEDOM);
    let spread = (1.0 + centre * centre / (2.0 * FREEDOM) - shrink).sqrt();
    (centre + CONFIDENCE * spread) / (1.0 - shrink) / root
}

/// Positives of a milestone, and how far others may be from the nearest of them.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub(super) struct Population {
    /// `[members, width]`: where they are embedded.
    members: Vec<f32>,
    margin: f32,
}

impl Population {
    /// From members and others of the same kind, `[others, width]`.
    pub(super) fn new(members: &[f32], others: &[f32], width: usize) -> Self {
        let mut distances: Vec<f32> =
            others.chunks_exact(width).map(|other| nearest(members, other)).collect();
        let count = distances.len() as f64;
        let mean = distances.iter().map(|it| f64::from(*it)).sum::<f64>() / count;
        let square = distances.iter().map(|it| (f64::from(*it) - mean).powi(2)).sum::<f64>();
        let deviation = (square / (count - 1.0).max(1.0)).sqrt();
        distances.sort_unstable_by(f32::total_cmp);
        distances.dedup();
        let margin = mean + tolerance(distances.len()) * deviation;
        Self { members: members.to_vec(), margin: margin as f32 }
    }

    /// Whether an embedded state looks like one of them.
    fn holds(&self, state: &[f32]) -> bool {
        !self.members.is_empty() && nearest(&self.members, state) <= self.margin
    }
}

/// The distance to the nearest of some rows.
fn nearest(rows: &[f32], to: &[f32]) -> f32 {
    let squares = rows.chunks_exact(to.len()).map(|row| square_distance(row, to));
    squares.fold(f32::INFINITY, f32::min).sqrt()
}

/// The squared distance of two rows, in eight sums that the compiler keeps apart.
fn square_distance(one: &[f32], other: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 8];
    for (one, other) in one.chunks_exact(8).zip(other.chunks_exact(8)) {
        for (sum, (one, other)) in sums.iter_mut().zip(one.iter().zip(other)) {
            *sum += (one - other) * (one - other);
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use sortie_learn::trajectory::End;
    use sortie_nn::gradient_check::{assert_gradient, random};
    use sortie_nn::random::stream;
    use sortie_nn::tape::Tape;

    use super::super::tests::Scene;
    use super::*;
    use crate::hal::Config;
    use crate::pictures::Heads;

    #[test]
    fn losses_are_those_of_naive_lists_and_have_their_slopes() {
        let (embedded, logits) = (random(1, 6 * 8), random(2, 3));
        let distance = |rows: &[f32], one: usize, other: usize| {
            let pairs = rows[8 * one..][..8].iter().zip(&rows[8 * other..]);
            pairs.map(|(one, other)| (one - other).powi(2)).sum::<f32>().sqrt()
        };
        let triplets = |rows: &[f32]| {
            let excess = |first| {
                let [near, far] = [1, 2].map(|other| distance(rows, first, first + other));
                (1.0 + near - far).max(0.0)
            };
            f64::from(0.25 * (excess(0).powi(2) + excess(3).powi(2)))
        };
        let wanted = [1, 0, 1];
        let classes = |logits: &[f32], squared: bool| {
            let likelihood = |logit: f32| 1.0 / (1.0 + (-logit).exp());
            let pairs = logits.iter().zip(wanted);
            let losses = pairs.map(|(logit, wanted)| match (squared, wanted) {
                (true, wanted) => 0.5 * (likelihood(*logit) - wanted as f32).powi(2),
                (_, 1) => -likelihood(*logit).ln(),
                _ => -(1.0 - likelihood(*logit)).ln(),
            });
            f64::from(losses.sum::<f32>() * 0.25)
        };
        for (number, at) in [&embedded, &logits, &logits].into_iter().enumerate() {
            let naive = |at: &[f32]| match number {
                0 => triplets(at),
                _ => classes(at, number == 1),
            };
            let mut tape = Tape::default();
            let mut pass = tape.begin(&[]);
            let leaf = pass.leaf(if number == 0 { 8 } else { 1 }, at);
            let loss = match number {
                0 => triplet_loss(&mut pass, leaf, 2),
                _ => class_loss(&mut pass, leaf, &wanted, (number == 1, 0.25)),
            };
            pass.backward(loss, &mut []);
            assert!((f64::from(pass.values(loss)[0]) - naive(at)).abs() < 1e-6);
            assert_gradient("loss", at, pass.slopes(leaf).unwrap(), naive);
        }
    }

    #[test]
    fn states_that_are_one_and_triplets_that_are_far_enough_have_no_slopes() {
        let mut tape = Tape::default();
        let mut pass = tape.begin(&[]);
        let leaf = pass.leaf(2, &[1.0, 2.0, 1.0, 2.0, 9.0, 9.0]);
        let loss = triplet_loss(&mut pass, leaf, 1);
        pass.backward(loss, &mut []);
        assert_eq!(pass.slopes(leaf), Some(&[0.0; 6][..]));
    }

    /// Of what is drawn negatives that look like positives are left out; with nothing drawn nothing is lost.
    #[test]
    fn negatives_that_look_like_positives_teach_nothing() {
        let scene = Scene::new(Config::default());
        let heads = Heads { goals: 1, actions: 3, dueling: false };
        let mut generator = stream(1, 1, 0);
        let classifier = Classifier::new(scene.shape(heads), Rules::default(), &mut generator);
        let (network, weights) = classifier.weights(false);
        let places: Vec<_> = (0..4).map(|number| Place::default().after(number)).collect();
        let states = places.iter().map(|place| scene.replay.steps.state(*place));
        let members = Space::default().hidden((network, weights), &scene.shown, states).to_vec();
        let alike = Population { members, margin: 1e-3 };
        let loss = |labels: Vec<(usize, bool)>, filter: bool| {
            let drawn = Drawn { places: places[..labels.len()].to_vec(), triplets: 0, labels };
            let config = AffordancesConfig { filter, ..Config::default().affordances };
            let populations = [Population::default(), alike.clone(), Population::default()];
            let [mut tape, mut spare] = [Tape::default(), Tape::default()];
            let mut shard = Shard {
                number: 0,
                pass: tape.begin(weights),
                spare: &mut spare,
                online: weights,
                target: weights,
                space: &mut SparseRows::default(),
            };
            let (classes, config) = (&Classes::new(3, 1), &config);
            let source = Source { config, classes, replay: &scene.replay, shown: &scene.shown };
            source.loss(network, &populations, &drawn, &mut shard).reported
        };
        assert_eq!(loss(vec![(1, false); 4], true), 0.0);
        assert!(loss(vec![(1, false); 4], false) > 0.0);
        let all = vec![(1, false), (1, true), (2, false), (1, false)];
        let (some, rest) = (loss(all.clone(), true), loss(all, false));
        assert!(some > 0.0 && some < rest, "{some} {rest}");
    }

    #[test]
    fn options_teach_what_they_reached_and_what_they_missed() {
        let mut classes = Classes::new(3, 4);
        let mut random = sortie_envs::random::generator(1);
        let start = Place::default().after(7);
        let option = Finished { start, steps: 3, goal: 2, reached: NONE, mask: 7, end: End::Open };
        for (goal, reached, want) in [
            (2, NONE, [0b000, 0b000]),
            (0, 1, [0b010, 0b000]),
            (2, 2, [0b110, 0b100]),
            (1, 0, [0b111, 0b111]),
        ] {
            classes.add(&Finished { goal, reached, ..option }, &mut random);
            assert_eq!(classes.known(), want, "{goal} {reached}");
        }
        classes
            .add(&Finished { goal: 2, reached: 2, start: start.after(3), ..option }, &mut random);
        let (count, samples) = &classes.samples[2][POSITIVE];
        let times = samples.iter().map(|sample| sample.place().since(Place::default()));
        assert_eq!((*count, times.collect()), (6, vec![11, 12, 9, 10]));
    }

    #[test]
    fn neighbours_are_other_states_of_the_same_option() {
        let (start, mut random) = (Place::default().after(7), sortie_envs::random::generator(1));
        let sample = |steps| Sample { start, step: 2, steps, parity: true };
        let mut steps: Vec<usize> = (0..200)
            .map(|_| neighbour(sample(6), 2.0, &mut random).unwrap().since(start))
            .collect();
        steps.sort_unstable();
        steps.dedup();
        assert_eq!(steps, [0, 1, 3, 4, 5]);
        let alone = Sample { step: 0, ..sample(1) };
        assert_eq!(neighbour(alone, 2.0, &mut random), None);
    }

    #[test]
    fn tolerances_agree_with_the_table_of_the_public_code() {
        for (numbers, want) in [
            (1, 2.9307),
            (2, 2.4487),
            (5, 2.0214),
            (10, 1.8064),
            (50, 1.5212),
            (100, 1.4549),
            (500, 1.3710),
            (1_000, 1.3538),
        ] {
            assert!((tolerance(numbers) / want - 1.0).abs() < 4e-4, "{numbers}");
        }
    }

    #[test]
    fn what_lies_among_positives_is_held_and_what_lies_far_off_is_not() {
        let mut random = stream(1, 1, 0);
        let mut cloud = |centre: f32, count: usize| -> Vec<f32> {
            normals(&mut random, 8 * count).iter().map(|number| centre + number).collect()
        };
        let population = Population::new(&cloud(0.0, 300), &cloud(0.0, 300), 8);
        let held =
            |rows: Vec<f32>| rows.chunks_exact(8).filter(|row| population.holds(row)).count();
        let near = held(cloud(0.0, 1_000));
        assert!((860..=960).contains(&near), "{near}");
        assert_eq!(held(cloud(5.0, 1_000)), 0);
        assert!(!Population::default().holds(&[0.0; 8]));
    }
    /// By their own they would all be at distance 0, and nothing but themselves would look like them.
    #[test]
    fn positives_are_measured_by_those_of_other_options() {
        let scene = Scene::new(Config::default());
        let heads = Heads { goals: 1, actions: 3, dueling: false };
        let mut random = sortie_envs::random::generator(1);
        let mut classifier = Classifier::new(scene.shape(heads), Rules::default(), &mut random);
        let mut classes = Classes::new(3, 1_000);
        for number in 0.. {
            let Some(option) = scene.replay.option((0, number)) else { break };
            classes.add(option, &mut random);
        }
        let mut population = Population::default();
        let config = &AffordancesConfig { population: 60, ..Config::default().affordances };
        let source =
            Source { config, classes: &classes, replay: &scene.replay, shown: &scene.shown };
        classifier.refresh(&mut population, 1, source, &mut random);
        assert!(population.margin > 0.0);
        // Members and others of the same kind are shown alike: nine tenths of the others are held.
        let places: Vec<Place> = classes.samples[1][POSITIVE].1.iter().map(Sample::place).collect();
        let states = places.iter().map(|place| scene.replay.steps.state(*place));
        let (mut space, network) = (Space::default(), classifier.weights(false));
        let all = space.hidden(network, &scene.shown, states);
        let held = all.chunks_exact(network.0.width()).filter(|it| population.holds(it));
        assert!(held.count() * 10 > places.len() * 8, "{}", population.margin);
    }
}
