//! The meta-controller: how goals lead to the task.

use sortie_envs::Random;
use sortie_envs::random::chance;

use super::config::{MetaConfig, ReturnsConfig};
use crate::options::{self, Lesson, NONE, Next, OptionPlace, Replay, course};
use crate::pictures::{Heads, Learner, Shown};

/// Memory of updates.
pub(super) type Memory = options::Memory<OptionPlace>;

/// Draws of an option before an update is given up: nothing is kept yet.
const TRIES: usize = 10_000;

/// Adds the gradient of an update, and returns its loss; none where too little is kept.
pub(super) fn descend(
    learner: &mut Learner,
    heads: Heads,
    (config, returns, exponent): (&MetaConfig, &ReturnsConfig, f32),
    (replay, shown): (&mut Replay, &Shown),
    memory: &mut Memory,
    random: &mut Random,
) -> Option<f64> {
    memory.lessons.clear();
    for _ in 0..TRIES {
        memory.lessons.extend(draw(replay, heads.actions, (config, returns), random));
        if memory.lessons.len() == config.batch {
            break;
        }
    }
    if memory.lessons.len() < config.batch {
        return None;
    }
    let settings = (exponent, returns.bounded);
    let loss = options::descend(learner, heads, settings, (replay, shown), memory);
    replay.correct_options(memory.corrections());
    Some(loss)
}

/// An option to learn from; none where it is none to begin with.
fn draw(
    replay: &mut Replay,
    milestones: usize,
    (config, returns): (&MetaConfig, &ReturnsConfig),
    random: &mut Random,
) -> Option<Lesson<OptionPlace>> {
    let option = replay.draw_option_by_priority(random).or_else(|| {
        let is_solved = chance(random, config.solved.into());
        let place = replay.draw_option(is_solved, random);
        place.or_else(|| replay.draw_option(false, random)).map(|place| (place, 1.0))
    });
    let (drawn, priority) = option?;
    let course = course(replay, drawn, returns.course_rules(config, milestones))?;
    let is_mirrored = returns.mirror && chance(random, 0.5);
    let next = course.next.map(|(place, mask)| Next {
        place,
        discount: course.discount,
        mask: if config.masked { mask } else { u32::MAX },
    });
    let (action, goals) = (course.goal.into(), [(0, course.reward), (NONE, 0.0)]);
    Some(Lesson { drawn, priority, state: course.start, is_mirrored, action, goals, next })
}
