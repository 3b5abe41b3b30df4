//! Values of actions learned from what is kept (double Q-learning, equation 6.1).

use super::priorities::importance;
use super::replay::{NONE, Place, Replay};
use crate::pictures::{Heads, Learner, Shown, Space, best, slopes};

/// What an action in a state should be worth, for one goal or two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lesson<P> {
    /// What was drawn, and its priority.
    pub(crate) drawn: P,
    pub(crate) priority: f64,
    pub(crate) state: Place,
    pub(crate) is_mirrored: bool,
    pub(crate) action: usize,
    /// The goals whose values are corrected, and what was earned for them.
    pub(crate) goals: [(u8, f32); 2],
    /// Where a value is looked up besides; nowhere where nothing can follow.
    pub(crate) next: Option<Next>,
}

/// A value that belongs to what was earned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Next {
    pub(crate) place: Place,
    /// What it counts.
    pub(crate) discount: f32,
    /// The actions that could be chosen there, as bits.
    pub(crate) mask: u32,
}

/// Memory of updates.
#[derive(Debug)]
pub(crate) struct Memory<P> {
    /// What is learned from: cleared and drawn before each update.
    pub(crate) lessons: Vec<Lesson<P>>,
    /// How far off the values of each were, in the mean over its goals.
    errors: Vec<f32>,
    space: Space,
    target_space: Space,
    slopes: Vec<f32>,
}

impl<P> Default for Memory<P> {
    fn default() -> Self {
        let (space, target_space) = Default::default();
        Self { lessons: Vec::new(), errors: Vec::new(), space, target_space, slopes: Vec::new() }
    }
}

impl<P: Copy> Memory<P> {
    /// What was drawn, and how far off its values were.
    pub(crate) fn corrections(&self) -> impl Iterator<Item = (P, f32)> {
        self.lessons.iter().map(|lesson| lesson.drawn).zip(self.errors.iter().copied())
    }
}

/// Adds the gradient of the lessons that were drawn, and returns their loss. `exponent` is how far it makes up for
/// priorities, `bounded` whether values that are looked up are held between 0 and 1.
pub(crate) fn descend<P>(
    learner: &mut Learner,
    heads: Heads,
    (exponent, bounded): (f32, bool),
    (replay, shown): (&Replay, &Shown),
    memory: &mut Memory<P>,
) -> f64 {
    let Memory { lessons, errors, space, target_space, slopes: by_head } = memory;
    let priorities = lessons.iter().map(|lesson| lesson.priority);
    let weights: Vec<f32> = importance(priorities, exponent.into()).collect();
    look_up(learner, (heads, bounded), (replay, shown), lessons, space, target_space);
    space.rows.clear();
    for lesson in &*lessons {
        shown.push(replay.shown(lesson.state), lesson.is_mirrored, &mut space.rows);
    }
    let mut pass = space.tape.begin(&learner.online);
    let hidden = learner.network.hidden(&mut pass, &space.rows);
    let values = learner.network.head(&mut pass, hidden);
    let (outputs, share) = (heads.outputs(), 1.0 / lessons.len() as f32);
    by_head.clear();
    by_head.resize(lessons.len() * outputs, 0.0);
    errors.clear();
    let mut loss = 0.0;
    let rows = pass.values(values).chunks_exact(outputs).zip(by_head.chunks_exact_mut(outputs));
    for ((lesson, weight), (values, slopes)) in lessons.iter().zip(weights).zip(rows) {
        let active = lesson.goals.into_iter().filter(|(goal, _)| *goal != NONE);
        let goals = active.clone().count() as f32;
        let share = share * weight * weight;
        let mut mean = 0.0;
        for (goal, target) in active {
            let error = heads.value(values, goal.into(), lesson.action) - target;
            loss += 0.5 * f64::from(error * error * share);
            mean += error.abs() / goals;
            heads.add_slope(slopes, goal.into(), lesson.action, error * share);
        }
        errors.push(mean);
    }
    let sum = slopes(&mut pass, values, by_head);
    pass.backward(sum, &mut learner.gradient);
    loss
}

/// Adds to what was earned what the states behind are worth: the best action by the online network, its value by the
/// target network.
fn look_up<P>(
    learner: &Learner,
    (heads, bounded): (Heads, bool),
    (replay, shown): (&Replay, &Shown),
    lessons: &mut [Lesson<P>],
    space: &mut Space,
    target_space: &mut Space,
) {
    let network = &learner.network;
    let state =
        |lesson: &Lesson<P>| lesson.next.map(|next| (replay.shown(next.place), lesson.is_mirrored));
    let online = space.hidden(network, &learner.online, shown, lessons.iter().filter_map(state));
    let target =
        target_space.hidden(network, &learner.target, shown, lessons.iter().filter_map(state));
    let width = network.width();
    let hidden = online.chunks_exact(width).zip(target.chunks_exact(width));
    let (mut chosen, mut worth) = (Vec::new(), Vec::new());
    let followed = lessons.iter_mut().filter_map(|lesson| Some((lesson.next?, lesson)));
    for ((next, lesson), (online, target)) in followed.zip(hidden) {
        for (goal, sum) in lesson.goals.iter_mut().filter(|(goal, _)| *goal != NONE) {
            heads.values(network, &learner.online, online, (*goal).into(), &mut chosen);
            heads.values(network, &learner.target, target, (*goal).into(), &mut worth);
            let value = worth[best(&chosen, next.mask)];
            *sum += next.discount * if bounded { value.clamp(0.0, 1.0) } else { value };
        }
    }
}
