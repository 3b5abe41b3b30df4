//! Which milestones can be reached next, learned from what options came to; and false negatives: states that look like
//! positives though something else happened (dissertation section 6.3).

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::{below, chance};
use sortie_nn::layers::elementwise::{Activation, activate};
use sortie_nn::random::normals;

use super::AffordancesConfig;
use crate::options::{Finished, NONE, Place, Replay};
use crate::pictures::{Learner, Shown, Space, slopes};

/// A state of an option that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Sample {
    place: Place,
    /// Its place in the option, and the steps of that.
    step: u8,
    steps: u8,
    /// Drawn for the option as a whole: positives of one parity are measured by those of the other.
    parity: bool,
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
                let place = option.start.after(step.into());
                let sample = Sample { place, step, steps: option.steps, parity };
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
        replay.has(sample.place).then_some(sample)
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
        meant.map(|sample| sample.place).take(count).collect()
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
            let time = sample.place.time.checked_add_signed(offset)?;
            return Some(Place { time, ..sample.place });
        }
    }
}

/// Slopes by the three embeddings of a triplet: half the square of how much farther than by 1 the neighbour is.
fn triplet_slopes(embedded: &[f32], share: f32, slopes: &mut [f32]) -> f32 {
    let width = embedded.len() / 3;
    let [anchor, near, far] = [0, 1, 2].map(|row| &embedded[row * width..][..width]);
    let distances = [near, far].map(|other| square_distance(anchor, other).sqrt().max(1e-6));
    let excess = (1.0 + distances[0] - distances[1]).max(0.0);
    for column in 0..width {
        let by = [(near, distances[0]), (far, -distances[1])]
            .map(|(other, distance)| share * excess * (anchor[column] - other[column]) / distance);
        slopes[column] = by[0] + by[1];
        slopes[width + column] = -by[0];
        slopes[2 * width + column] = -by[1];
    }
    0.5 * share * excess * excess
}

/// The loss of a likelihood and its slope by the logit: cross entropy, or half the square of the error.
fn class_loss(likelihood: f32, wanted: f32, squared: bool) -> (f32, f32) {
    let error = likelihood - wanted;
    if squared {
        return (0.5 * error * error, error * likelihood * (1.0 - likelihood));
    }
    (-(1.0 - error.abs()).max(1e-9).ln(), error)
}

/// Memory of updates.
#[derive(Debug, Default)]
pub(super) struct Memory {
    places: Vec<Place>,
    labels: Vec<(usize, bool)>,
    space: Space,
    embedding: Vec<f32>,
    logits: Vec<f32>,
}

/// Adds the gradient of an update: of the embedding by triplets, and of the classifier by states of both classes, as far
/// as each is due; negatives are left out where they look like positives. Returns the classifier's loss.
pub(super) fn descend(
    learner: &mut Learner,
    config: &AffordancesConfig,
    [embeds, classifies]: [bool; 2],
    (classes, populations): (&Classes, &[Population]),
    (replay, shown): (&Replay, &Shown),
    memory: &mut Memory,
    random: &mut Random,
) -> f64 {
    let Memory { places, labels, space, embedding, logits } = memory;
    places.clear();
    let triplets = if embeds { config.triplets } else { 0 };
    for _ in 0..triplets {
        let anchor = classes.draw_any(replay, random);
        let near = anchor.and_then(|anchor| neighbour(anchor, config.spread, random));
        let far = classes.draw_any(replay, random);
        if let (Some(anchor), Some(near), Some(far)) = (anchor, near, far) {
            places.extend([anchor.place, near, far.place]);
        }
    }
    let triplets = places.len() / 3;
    labels.clear();
    let both = if classifies { classes.known()[1] } else { 0 };
    for milestone in (0..classes.samples.len()).filter(|milestone| both >> milestone & 1 == 1) {
        for _ in 0..config.batch {
            let is_positive = chance(random, 0.5);
            if let Some(sample) = classes.draw(milestone, is_positive.into(), replay, random) {
                places.push(sample.place);
                labels.push((milestone, is_positive));
            }
        }
    }
    if places.is_empty() {
        return 0.0;
    }
    space.rows.clear();
    places.iter().for_each(|place| shown.push(replay.shown(*place), false, &mut space.rows));
    let network = &learner.network;
    let (width, outputs) = (network.width(), network.outputs());
    let mut pass = space.tape.begin(&learner.online);
    let hidden = network.hidden(&mut pass, &space.rows);
    let head = network.head(&mut pass, hidden);
    embedding.clear();
    embedding.resize(places.len() * width, 0.0);
    let embedded = pass.values(hidden);
    let share = 1.0 / triplets.max(1) as f32;
    let rows = embedded.chunks_exact(3 * width).zip(embedding.chunks_exact_mut(3 * width));
    rows.take(triplets).for_each(|(row, slopes)| _ = triplet_slopes(row, share, slopes));
    logits.clear();
    logits.resize(places.len() * outputs, 0.0);
    let (mut loss, share) = (0.0, 1.0 / config.batch as f32);
    for (row, (milestone, is_positive)) in labels.iter().enumerate() {
        let row = 3 * triplets + row;
        let state = &embedded[row * width..][..width];
        if config.filter && !is_positive && populations[*milestone].holds(state) {
            continue;
        }
        let place = row * outputs + milestone;
        let mut likelihood = [0.0];
        activate(Activation::Sigmoid, &pass.values(head)[place..=place], &mut likelihood);
        let wanted = f32::from(u8::from(*is_positive));
        let (own, slope) = class_loss(likelihood[0], wanted, config.squared);
        logits[place] = share * slope;
        loss += f64::from(share * own);
    }
    let sums = [slopes(&mut pass, hidden, embedding), slopes(&mut pass, head, logits)];
    let sum = pass.add(sums[0], sums[1]);
    pass.backward(sum, &mut learner.gradient);
    loss / f64::from(both.count_ones().max(1))
}

/// Measures anew how far apart the positives of a milestone are: those of one parity from those of the other.
pub(super) fn refresh(
    population: &mut Population,
    milestone: usize,
    count: usize,
    (classes, learner): (&Classes, &Learner),
    (replay, shown): (&Replay, &Shown),
    memory: &mut Memory,
    random: &mut Random,
) {
    let [members, others] = [false, true].map(|parity| {
        let places = classes.drawn_positives(milestone, parity, count, replay, random);
        let states = places.iter().map(|place| (replay.shown(*place), false));
        memory.space.hidden(&learner.network, &learner.online, shown, states).to_vec()
    });
    if !members.is_empty() && !others.is_empty() {
        *population = Population::new(&members, &others, learner.network.width());
    }
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
    use sortie_nn::random::stream;

    use super::super::tests::Scene;
    use super::*;
    use crate::hal::Config;
    use crate::options::End;

    #[test]
    fn slopes_of_triplets_are_those_of_their_loss() {
        let mut embedded: Vec<f32> =
            (0..24).map(|number| 0.3 * (number as f32 * 1.7).sin()).collect();
        let (mut slopes, mut other) = ([0.0; 24], [0.0; 24]);
        assert!(triplet_slopes(&embedded, 0.5, &mut slopes) > 0.0);
        for column in 0..24 {
            let mut loss = |step: f32| {
                embedded[column] += step;
                triplet_slopes(&embedded, 0.5, &mut other)
            };
            let difference = (loss(1e-2) - loss(-2e-2)) / 2e-2;
            embedded[column] += 1e-2;
            assert!((difference - slopes[column]).abs() < 2e-3, "{column}");
        }
        // Far enough is far enough.
        embedded[16..].iter_mut().for_each(|number| *number += 9.0);
        assert_eq!(triplet_slopes(&embedded, 0.5, &mut slopes), 0.0);
        assert_eq!(slopes, [0.0; 24]);
    }

    #[test]
    fn slopes_of_classes_are_those_of_their_loss() {
        let likelihood = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        for (logit, wanted, squared) in
            [(0.3, 1.0, true), (-0.7, 0.0, true), (0.3, 1.0, false), (-0.7, 0.0, false)]
        {
            let loss = |step: f32| class_loss(likelihood(logit + step), wanted, squared).0;
            let (_, slope) = class_loss(likelihood(logit), wanted, squared);
            assert!(((loss(1e-2) - loss(-1e-2)) / 2e-2 - slope).abs() < 1e-4, "{logit} {squared}");
        }
        assert_eq!(class_loss(0.25, 1.0, true).0, 0.5 * 0.5625);
    }

    #[test]
    fn options_teach_what_they_reached_and_what_they_missed() {
        let mut classes = Classes::new(3, 4);
        let mut random = sortie_envs::random::generator(1);
        let start = Place { instance: 0, time: 7 };
        let option =
            Finished { start, steps: 3, goal: 2, reached: NONE, mask: 7, end: End::GoesOn };
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
        let times: Vec<u32> = samples.iter().map(|sample| sample.place.time).collect();
        assert_eq!((*count, times), (6, vec![11, 12, 9, 10]));
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
        let learner = scene.learner(3);
        let (mut classes, mut random) = (Classes::new(3, 1_000), sortie_envs::random::generator(1));
        for number in 0.. {
            let Some(option) = scene.replay.option((0, number)) else { break };
            classes.add(option, &mut random);
        }
        let mut population = Population::default();
        let (from, kept) = ((&classes, &learner), (&scene.replay, &scene.shown));
        refresh(&mut population, 1, 60, from, kept, &mut Memory::default(), &mut random);
        assert!(population.margin > 0.0);
        // Members and others of the same kind are shown alike: nine tenths of the others are held.
        let places: Vec<Place> = classes.samples[1][POSITIVE].1.iter().map(|it| it.place).collect();
        let states = places.iter().map(|place| (scene.replay.shown(*place), false));
        let mut space = Space::default();
        let all = space.hidden(&learner.network, &learner.online, &scene.shown, states);
        let held = all.chunks_exact(learner.network.width()).filter(|it| population.holds(it));
        assert!(held.count() * 10 > places.len() * 8, "{}", population.margin);
    }
}
