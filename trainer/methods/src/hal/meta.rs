//! The meta-controller: how goals lead to the task.

use sortie_envs::Random;
use sortie_envs::random::chance;

use super::config::MetaConfig;
use crate::options::{Course, CourseRules, Replay, course};
use crate::pictures::{Learner, Shown, Space, best, slopes};

/// Memory of updates.
#[derive(Debug, Default)]
pub(super) struct Memory {
    drawn: Vec<(Course, bool)>,
    targets: Vec<f32>,
    space: Space,
    target_space: Space,
    slopes: Vec<f32>,
}

/// Draws of an option before an update is given up: nothing is kept yet.
const TRIES: usize = 10_000;

/// Adds the gradient of an update, and returns its loss; none where too little is kept.
pub(super) fn descend(
    learner: &mut Learner,
    config: &MetaConfig,
    [relabel, mirror]: [bool; 2],
    (replay, shown): (&Replay, &Shown),
    memory: &mut Memory,
    random: &mut Random,
) -> Option<f64> {
    let Memory { drawn, targets, space, target_space, slopes: by_goal } = memory;
    let network = &learner.network;
    let milestones = network.outputs();
    let MetaConfig { options, discount, step_discount, .. } = *config;
    let rules = CourseRules { options, discount, step_discount, relabel, milestones };
    drawn.clear();
    for _ in 0..TRIES {
        let is_solved = chance(random, config.solved.into());
        let place = replay.draw_option(is_solved, random);
        let place = place.or_else(|| replay.draw_option(false, random));
        let course = place.and_then(|place| course(replay, place, rules));
        drawn.extend(course.map(|course| (course, mirror && chance(random, 0.5))));
        if drawn.len() == config.batch {
            break;
        }
    }
    if drawn.len() < config.batch {
        return None;
    }
    let next = |(course, is_mirrored): &(Course, bool)| {
        course.next.map(|(place, _)| (replay.shown(place), *is_mirrored))
    };
    let online = space.hidden(network, &learner.online, shown, drawn.iter().filter_map(next));
    let target =
        target_space.hidden(network, &learner.target, shown, drawn.iter().filter_map(next));
    let width = network.width();
    let mut hidden = online.chunks_exact(width).zip(target.chunks_exact(width));
    let (mut chosen, mut worth) = (vec![0.0; milestones], [0.0]);
    targets.clear();
    targets.extend(drawn.iter().map(|(course, _)| {
        let Some((_, mask)) = course.next else { return course.reward };
        let (online, target) = hidden.next().expect("every state that is looked up has a row");
        network.read(&learner.online, online, 0..milestones, &mut chosen);
        let goal = best(&chosen, mask);
        network.read(&learner.target, target, goal..=goal, &mut worth);
        course.discount * worth[0].clamp(0.0, 1.0)
    }));
    space.rows.clear();
    for (course, is_mirrored) in &*drawn {
        shown.push(replay.shown(course.start), *is_mirrored, &mut space.rows);
    }
    let mut pass = space.tape.begin(&learner.online);
    let hidden = network.hidden(&mut pass, &space.rows);
    let values = network.head(&mut pass, hidden);
    let share = 1.0 / drawn.len() as f32;
    by_goal.clear();
    by_goal.resize(drawn.len() * milestones, 0.0);
    let mut loss = 0.0;
    let rows =
        pass.values(values).chunks_exact(milestones).zip(by_goal.chunks_exact_mut(milestones));
    for (((course, _), target), (values, slopes)) in drawn.iter().zip(&*targets).zip(rows) {
        let goal = usize::from(course.goal);
        let error = values[goal] - target;
        loss += 0.5 * f64::from(error * error * share);
        slopes[goal] = error * share;
    }
    let sum = slopes(&mut pass, values, by_goal);
    pass.backward(sum, &mut learner.gradient);
    Some(loss)
}
