//! The meta-controller: how goals lead to the task.

use sortie_envs::Random;
use sortie_envs::random::chance;

use super::config::{MetaConfig, ReturnsConfig};
use crate::options::{Course, OptionPlace, Replay, course, importance};
use crate::pictures::{Heads, Learner, Shown, Space, best, slopes};

/// An option that is learned from.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    place: OptionPlace,
    course: Course,
    is_mirrored: bool,
    /// What it counts in the loss, what its value should be, and how far off it was.
    weight: f32,
    target: f32,
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
    let Memory { drawn, priorities, space, target_space, slopes: by_goal } = memory;
    let rules = returns.course_rules(config, heads.actions);
    drawn.clear();
    priorities.clear();
    for _ in 0..TRIES {
        let option = replay.draw_option_by_priority(random).or_else(|| {
            let is_solved = chance(random, config.solved.into());
            let place = replay.draw_option(is_solved, random);
            place.or_else(|| replay.draw_option(false, random)).map(|place| (place, 1.0))
        });
        let Some((place, priority)) = option else { continue };
        let Some(course) = course(replay, place, rules) else { continue };
        let is_mirrored = returns.mirror && chance(random, 0.5);
        let target = course.reward;
        drawn.push(Drawn { place, course, is_mirrored, weight: 1.0, target, error: 0.0 });
        priorities.push(priority);
        if drawn.len() == config.batch {
            break;
        }
    }
    if drawn.len() < config.batch {
        return None;
    }
    let weights = importance(priorities, exponent.into());
    drawn.iter_mut().zip(weights).for_each(|(option, weight)| option.weight = weight);
    let kept = (&*replay, shown);
    look_up(learner, heads, (config, returns), kept, drawn, space, target_space);
    space.rows.clear();
    for option in &*drawn {
        shown.push(replay.shown(option.course.start), option.is_mirrored, &mut space.rows);
    }
    let mut pass = space.tape.begin(&learner.online);
    let hidden = learner.network.hidden(&mut pass, &space.rows);
    let values = learner.network.head(&mut pass, hidden);
    let (outputs, share) = (heads.outputs(), 1.0 / drawn.len() as f32);
    by_goal.clear();
    by_goal.resize(drawn.len() * outputs, 0.0);
    let mut loss = 0.0;
    let rows = pass.values(values).chunks_exact(outputs).zip(by_goal.chunks_exact_mut(outputs));
    for (option, (values, slopes)) in drawn.iter_mut().zip(rows) {
        let goal = usize::from(option.course.goal);
        let share = share * option.weight * option.weight;
        option.error = heads.value(values, 0, goal) - option.target;
        loss += 0.5 * f64::from(option.error * option.error * share);
        heads.add_slope(slopes, 0, goal, option.error * share);
    }
    let sum = slopes(&mut pass, values, by_goal);
    pass.backward(sum, &mut learner.gradient);
    replay.correct_options(drawn.iter().map(|option| (option.place, option.error)));
    Some(loss)
}

/// Adds to targets what follows the options: the best goal by the online network, its value by the target network.
fn look_up(
    learner: &Learner,
    heads: Heads,
    (config, returns): (&MetaConfig, &ReturnsConfig),
    (replay, shown): (&Replay, &Shown),
    drawn: &mut [Drawn],
    space: &mut Space,
    target_space: &mut Space,
) {
    let network = &learner.network;
    let next = |option: &Drawn| {
        option.course.next.map(|(place, _)| (replay.shown(place), option.is_mirrored))
    };
    let online = space.hidden(network, &learner.online, shown, drawn.iter().filter_map(next));
    let target =
        target_space.hidden(network, &learner.target, shown, drawn.iter().filter_map(next));
    let width = network.width();
    let hidden = online.chunks_exact(width).zip(target.chunks_exact(width));
    let (mut chosen, mut worth) = (Vec::new(), Vec::new());
    let followed = drawn.iter_mut().filter_map(|option| Some((option.course.next?.1, option)));
    for ((mask, option), (online, target)) in followed.zip(hidden) {
        heads.values(network, &learner.online, online, 0, &mut chosen);
        heads.values(network, &learner.target, target, 0, &mut worth);
        let goal = best(&chosen, if config.masked { mask } else { u32::MAX });
        option.target += option.course.discount * returns.bound(worth[goal]);
    }
}
