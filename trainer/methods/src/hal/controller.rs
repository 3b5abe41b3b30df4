//! The controller: how actions lead to each milestone (equation 6.1, double Q-learning).

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random};

use super::config::{ReplayConfig, ReturnsConfig};
use crate::options::{NONE, Place, Replay, Window, importance, window};
use crate::pictures::{Heads, Learner, Shown, Space, best, slopes};

/// A step that is learned from.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    place: Place,
    action: usize,
    is_mirrored: bool,
    window: Window,
    /// The goals whose values are corrected, and what they should be.
    goals: [(u8, f32); 2],
    /// What it counts in the loss, and how far off its values were.
    weight: f32,
    error: f32,
}

/// Memory of updates.
#[derive(Debug, Default)]
pub(super) struct Memory {
    drawn: Vec<Drawn>,
    priorities: Vec<f64>,
    space: Space,
    target_space: Space,
    slopes: Vec<f32>,
}

/// Adds the gradient of an update, and returns its loss; none where too little is kept.
pub(super) fn descend(
    learner: &mut Learner,
    heads: Heads,
    (returns, sizes, exponent): (&ReturnsConfig, &ReplayConfig, f32),
    (replay, shown, environment): (&mut Replay, &Shown, &dyn Environment),
    memory: &mut Memory,
    random: &mut Random,
) -> f64 {
    let Memory { drawn, priorities, space, target_space, slopes: by_head } = memory;
    let rules = returns.rules();
    drawn.clear();
    priorities.clear();
    while drawn.len() < sizes.batch {
        let (place, priority) = match replay.draw_step_by_priority(random) {
            Some(drawn) => drawn,
            None => {
                let reached = chance(random, sizes.reached.into());
                let place = reached.then(|| replay.draw_reached(random)).flatten();
                (place.unwrap_or_else(|| replay.draw_step(random)), 1.0)
            }
        };
        let Some(window) = window(replay, place, rules) else { continue };
        priorities.push(priority);
        let moment = replay.moment(place);
        let is_mirrored = returns.mirror && chance(random, 0.5);
        let action = environment.turned_action(is_mirrored.into(), moment.action.into());
        let other = if returns.relabel { moment.option_reached } else { NONE };
        let other = if other == moment.goal { NONE } else { other };
        let goals = [moment.goal, other].map(|goal| (goal, window.earned(goal, rules)));
        let action = action.into();
        drawn.push(Drawn { place, action, is_mirrored, window, goals, weight: 1.0, error: 0.0 });
    }
    let weights = importance(priorities, exponent.into());
    drawn.iter_mut().zip(weights).for_each(|(step, weight)| step.weight = weight);
    look_up(learner, (heads, returns), (replay, shown), drawn, space, target_space);
    space.rows.clear();
    for step in &*drawn {
        shown.push(replay.shown(step.place), step.is_mirrored, &mut space.rows);
    }
    let mut pass = space.tape.begin(&learner.online);
    let hidden = learner.network.hidden(&mut pass, &space.rows);
    let values = learner.network.head(&mut pass, hidden);
    let (outputs, share) = (heads.outputs(), 1.0 / drawn.len() as f32);
    by_head.clear();
    by_head.resize(drawn.len() * outputs, 0.0);
    let mut loss = 0.0;
    let rows = pass.values(values).chunks_exact(outputs).zip(by_head.chunks_exact_mut(outputs));
    for (step, (values, slopes)) in drawn.iter_mut().zip(rows) {
        let active = step.goals.into_iter().filter(|(goal, _)| *goal != NONE);
        let goals = active.clone().count() as f32;
        let share = share * step.weight * step.weight;
        for (goal, target) in active {
            let error = heads.value(values, goal.into(), step.action) - target;
            loss += 0.5 * f64::from(error * error * share);
            step.error += error.abs() / goals;
            heads.add_slope(slopes, goal.into(), step.action, error * share);
        }
    }
    let sum = slopes(&mut pass, values, by_head);
    pass.backward(sum, &mut learner.gradient);
    replay.correct_steps(drawn.iter().map(|step| (step.place, step.error)));
    loss
}

/// Adds to targets what the states behind the windows are worth: the best action by the online network, its value by
/// the target network.
fn look_up(
    learner: &Learner,
    (heads, returns): (Heads, &ReturnsConfig),
    (replay, shown): (&Replay, &Shown),
    drawn: &mut [Drawn],
    space: &mut Space,
    target_space: &mut Space,
) {
    let network = &learner.network;
    let next = |step: &Drawn| step.window.next.map(|place| (replay.shown(place), step.is_mirrored));
    let online = space.hidden(network, &learner.online, shown, drawn.iter().filter_map(next));
    let target =
        target_space.hidden(network, &learner.target, shown, drawn.iter().filter_map(next));
    let width = network.width();
    let hidden = online.chunks_exact(width).zip(target.chunks_exact(width));
    let (mut chosen, mut worth) = (Vec::new(), Vec::new());
    let followed = drawn.iter_mut().filter(|step| step.window.next.is_some());
    for (step, (online, target)) in followed.zip(hidden) {
        for (goal, sum) in step.goals.iter_mut().filter(|(goal, _)| *goal != NONE) {
            heads.values(network, &learner.online, online, (*goal).into(), &mut chosen);
            heads.values(network, &learner.target, target, (*goal).into(), &mut worth);
            *sum += step.window.discount * returns.bound(worth[best(&chosen, u32::MAX)]);
        }
    }
}
