//! Values of actions learned from what is kept (double Q-learning, equation 6.1).

use sortie_envs::Random;
use sortie_learn::Learner;
use sortie_learn::learner::{Loss, Rules, Shard};
use sortie_learn::run::UpdateReport;
use sortie_learn::trajectory::{Place, importance};
use sortie_nn::layers::SparseRows;

use super::replay::{NONE, Replay};
use super::returns::Next;
use crate::pictures::{Network, NetworkShape, Shown, best};

/// What an action in a state should be worth, for one goal or two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lesson {
    pub(crate) state: Place,
    pub(crate) is_mirrored: bool,
    pub(crate) action: usize,
    /// The goals whose values are corrected, and what was earned for them.
    pub(crate) goals: [(u8, f32); 2],
    /// Where a value is looked up besides; nowhere where nothing can follow.
    pub(crate) next: Option<Next>,
    /// What it was drawn by.
    pub(crate) priority: f64,
}

impl Lesson {
    fn goals(&self) -> impl Iterator<Item = (usize, f32)> + use<> {
        let goals = self.goals.into_iter().filter(|(goal, _)| *goal != NONE);
        goals.map(|(goal, earned)| (goal.into(), earned))
    }
}

/// A network that learns what actions are worth.
#[derive(Debug)]
pub(crate) struct QNetwork {
    pub(crate) network: Network,
    pub(crate) learner: Learner<Memory>,
}

/// What an update fills and uses.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    rows: SparseRows,
    /// Which values are looked at, see [`Network::place`].
    places: Vec<u32>,
    actions: Vec<u32>,
    /// Of every goal of every lesson.
    targets: Vec<f32>,
    /// What their errors are multiplied by.
    weights: Vec<f32>,
    /// How far off the values of each lesson were, in the mean over its goals.
    errors: Vec<f32>,
}

/// What lessons are made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lessons<'a> {
    pub(crate) lessons: &'a [Lesson],
    pub(crate) replay: &'a Replay,
    pub(crate) shown: &'a Shown,
    /// How far losses make up for priorities.
    pub(crate) exponent: f32,
    /// Whether values that are looked up are held between 0 and 1.
    pub(crate) bounded: bool,
}

impl QNetwork {
    pub(crate) fn new(shape: NetworkShape, rules: Rules, random: &mut Random) -> Self {
        let (network, parameters) = Network::new(shape, random);
        Self { network, learner: Learner::new(parameters, rules, 1) }
    }

    /// The network and its weights: the averaged ones, which are measured, or those that learn, which explore.
    pub(crate) fn weights(&self, averaged: bool) -> (&Network, &[f32]) {
        let Learner { online, average, .. } = &self.learner;
        (&self.network, if averaged { average } else { &online.values })
    }

    /// Makes an update. It is one shard: a batch of so small rows is through before a thread would have started.
    pub(crate) fn update(&mut self, lessons: Lessons<'_>, learning_rate: f32) -> UpdateReport {
        let Self { network, learner } = self;
        learner.update(1, learning_rate, |shard| lessons.loss(network, shard))
    }

    /// How far off the values of each lesson of the last update were.
    pub(crate) fn errors(&self) -> &[f32] {
        self.learner.spaces().next().map_or(&[], |memory| &memory.errors)
    }
}

impl Lessons<'_> {
    /// Half the mean, over lessons, of the squares of weighted errors.
    pub(crate) fn loss(self, network: &Network, shard: &mut Shard<'_, Memory>) -> Loss {
        self.find_targets(network, shard);
        let Shard { pass, space, .. } = shard;
        let Memory { rows, places, actions, targets, weights, errors } = &mut **space;
        rows.clear();
        places.clear();
        actions.clear();
        weights.clear();
        let priorities = self.lessons.iter().map(|lesson| lesson.priority);
        let all = self.lessons.iter().zip(importance(priorities, self.exponent.into()));
        for (row, (lesson, weight)) in all.enumerate() {
            self.shown.push(self.replay.steps.state(lesson.state), lesson.is_mirrored, rows);
            for (goal, _) in lesson.goals() {
                places.push(network.place(row, goal));
                actions.push(lesson.action as u32);
                weights.push(weight);
            }
        }
        let hidden = network.hidden(pass, rows);
        let values = network.values(pass, hidden, places);
        let chosen = pass.pick(values, actions);
        let mut distances = pass.values(chosen).iter().zip(&*targets).map(|(q, y)| (q - y).abs());
        errors.clear();
        errors.extend(self.lessons.iter().map(|lesson| {
            let goals = lesson.goals().count();
            distances.by_ref().take(goals).sum::<f32>() / goals as f32
        }));
        targets.iter_mut().zip(&*weights).for_each(|(target, weight)| *target *= weight);
        let weights = pass.input(1, weights);
        let chosen = pass.multiply(chosen, weights);
        let share = 0.5 / self.lessons.len() as f32;
        Loss::of(pass, |pass| pass.squared_error(chosen, targets, share))
    }

    /// What was earned, and what the states behind are worth: the best action by the online network, its value by the
    /// target network.
    fn find_targets(self, network: &Network, shard: &mut Shard<'_, Memory>) {
        let Shard { spare, online, target, space, .. } = shard;
        let Memory { rows, places, actions, targets, .. } = &mut **space;
        rows.clear();
        places.clear();
        let followed = self.lessons.iter().filter_map(|lesson| Some((lesson, lesson.next?)));
        for (row, (lesson, next)) in followed.clone().enumerate() {
            self.shown.push(self.replay.steps.state(next.place), lesson.is_mirrored, rows);
            places.extend(lesson.goals().map(|(goal, _)| network.place(row, goal)));
        }
        let mut worth = Vec::new();
        // Convolutions are over one picture at least.
        if !places.is_empty() {
            let mut pass = spare.begin_forward(online);
            let hidden = network.hidden(&mut pass, rows);
            let values = network.values(&mut pass, hidden, places);
            let masks = followed.flat_map(|(lesson, next)| lesson.goals().map(move |_| next.mask));
            let values = pass.values(values).chunks_exact(network.heads.actions);
            actions.clear();
            actions.extend(values.zip(masks).map(|(values, mask)| best(values, mask) as u32));
            let mut pass = spare.begin_forward(target);
            let hidden = network.hidden(&mut pass, rows);
            let values = network.values(&mut pass, hidden, places);
            let chosen = pass.pick(values, actions);
            worth.extend_from_slice(pass.values(chosen));
        }
        let mut worth = worth.into_iter();
        targets.clear();
        for lesson in self.lessons {
            targets.extend(lesson.goals().map(|(_, earned)| {
                let value =
                    lesson.next.and_then(|next| Some(next.discount * self.bound(worth.next()?)));
                earned + value.unwrap_or(0.0)
            }));
        }
    }

    fn bound(self, value: f32) -> f32 {
        if self.bounded { value.clamp(0.0, 1.0) } else { value }
    }
}
