//! The controller: how actions lead to each milestone (equation 6.1, double Q-learning).

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random};

use super::config::ReturnsConfig;
use crate::options::{self, Lesson, NONE, Next, Place, Replay, ReplayConfig, window};
use crate::pictures::{Heads, Learner, Shown};

/// Memory of updates.
pub(super) type Memory = options::Memory<Place>;

/// Adds the gradient of an update, and returns its loss.
pub(super) fn descend(
    learner: &mut Learner,
    heads: Heads,
    (returns, sizes, exponent): (&ReturnsConfig, &ReplayConfig, f32),
    (replay, shown, environment): (&mut Replay, &Shown, &dyn Environment),
    memory: &mut Memory,
    random: &mut Random,
) -> f64 {
    memory.lessons.clear();
    while memory.lessons.len() < sizes.batch {
        memory.lessons.extend(draw(replay, (returns, sizes), environment, random));
    }
    let settings = (exponent, returns.bounded);
    let loss = options::descend(learner, heads, settings, (replay, shown), memory);
    replay.correct_steps(memory.corrections());
    loss
}

/// A step to learn from; none where it is none to begin with.
fn draw(
    replay: &Replay,
    (returns, sizes): (&ReturnsConfig, &ReplayConfig),
    environment: &dyn Environment,
    random: &mut Random,
) -> Option<Lesson<Place>> {
    let rules = returns.rules();
    let (place, priority) = replay.draw(sizes.reached, random);
    let window = window(replay, place, rules)?;
    let moment = replay.moment(place);
    let is_mirrored = returns.mirror && chance(random, 0.5);
    let action = environment.turned_action(is_mirrored.into(), moment.action.into());
    let other = if returns.relabel { moment.option_reached } else { NONE };
    let other = if other == moment.goal { NONE } else { other };
    let goals = [moment.goal, other].map(|goal| (goal, window.earned(goal, rules)));
    let next = window.next.map(|place| Next { place, discount: window.discount, mask: u32::MAX });
    let action = action.into();
    Some(Lesson { drawn: place, priority, state: place, is_mirrored, action, goals, next })
}
