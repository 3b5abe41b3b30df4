//! What the agent without goals is paid and learns, beside naive lists.

use sortie_envs::Split;
use sortie_learn::play::Play;
use sortie_learn::run::EpisodeCounts;
use sortie_learn::session::Setup;

use super::super::DQN;
use super::*;
use crate::options::End;
use crate::options::naive::{greedy, values};

/// Short episodes of iron, drawn actions, and an agent that has seen so many steps of each of four instances.
fn played(steps: u64, assignments: &[&str]) -> (Dqn, Box<dyn Environment>) {
    let setup = Setup::of(4, Default::default(), &Config::default());
    let small = ["network.width=16", "replay.capacity=20000", "replay.batch=24"];
    let setup =
        small.iter().chain(assignments).fold(setup, |setup, it| DQN.set(&setup, it).unwrap());
    let settings = [("training_limit".to_owned(), 60_i64.into())].into();
    let world = sortie_envs::open("crafting/iron", Split::Train, 1, &settings).unwrap();
    let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
    let mut dqn = Dqn::new(setup.own().unwrap(), &opening).unwrap();
    let random = (0..4).map(|index| generator(7, Purpose::Rollout, index)).collect();
    let mut play = Play::new(&*world, &mut dqn, random);
    for step in 0..steps {
        let now = Now { env_steps: 4 * step, of: u64::MAX };
        play.round(&mut dqn, now, &mut EpisodeCounts::default()).unwrap();
    }
    (dqn, world)
}

#[test]
fn an_update_is_that_of_a_naive_list() {
    for assignments in [
        &["returns.mirror=true"][..],
        &["replay.priorities=0.5", "replay.importance=[0.7,0.7]", "returns.bounded=false"],
    ] {
        let (mut dqn, world) = played(300, assignments);
        let other = played(1, &["network.active_inputs=3"]).0.learner.online;
        // So large that values lie beyond what bounds them.
        dqn.learner.target = other.iter().map(|weight| 3.0 * weight).collect();
        let (mut random, mut drawn) = (dqn.random.clone(), Vec::new());
        while drawn.len() < 24 {
            drawn.extend(dqn.draw(&*world));
        }
        std::mem::swap(&mut dqn.random, &mut random);
        let kept = (&dqn.recorder.replay, &dqn.shown);
        let values = |weights: &[f32], place: Place, mirrored: bool| {
            values((&dqn.learner, weights, dqn.heads), kept, (place, mirrored, 0))
        };
        let least = drawn.iter().map(|it| it.priority).fold(f64::MAX, f64::min);
        let (mut loss, mut errors) = (0.0, Vec::new());
        for lesson in &drawn {
            let moment = kept.0.moment(lesson.state);
            let turned = world.turned_action(lesson.is_mirrored.into(), moment.action.into());
            let (earned, next) = returns(kept.0, lesson.state, dqn.rules).unwrap();
            let follows = next.map_or(0.0, |next| {
                let chosen = values(&dqn.learner.online, next.place, lesson.is_mirrored);
                let worth = values(&dqn.learner.target, next.place, lesson.is_mirrored);
                let worth = worth[greedy(&chosen)];
                next.discount * if assignments.len() == 1 { worth.clamp(0.0, 1.0) } else { worth }
            });
            let found = values(&dqn.learner.online, lesson.state, lesson.is_mirrored);
            let error = f64::from(found[usize::from(turned)] - earned - follows);
            let weight = (least / lesson.priority).powf(dqn.config.replay.importance[0].into());
            loss += 0.5 * (weight * error).powi(2) / 24.0;
            errors.push((lesson.state, error.abs()));
        }
        assert!(drawn.iter().any(|it| it.is_mirrored) || assignments.len() > 1);
        let mut reports = Reports::default();
        dqn.learn(&*world, Now { env_steps: 1, of: 2 }, &mut reports);
        let found = reports.agents[0].loss;
        assert!((found - loss).abs() < 1e-4 * loss, "{found} {loss}");
        // A step that was drawn now has the priority of its error.
        let exponent = dqn.config.replay.priorities;
        for _ in 0..200 {
            let (place, priority) = dqn.recorder.replay.draw(0.5, &mut random);
            for (_, error) in errors.iter().filter(|it| it.0 == place && exponent > 0.0) {
                assert!((priority - (error + 0.001).powf(exponent)).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn the_chance_of_a_drawn_action_changes_in_a_straight_line() {
    let dqn = played(1, &[]).0;
    let at = |env_steps| dqn.rates(Now { env_steps, of: 1_000_000 }).epsilon;
    assert_eq!([0, 6_399].map(at), [1.0; 2]);
    for (step, want) in [(400_000, 0.275), (800_000, 0.05), (1_000_000, 0.05)] {
        assert!((at(step) - want).abs() < 1e-5, "{step}");
    }
}

/// Episodes of 60 steps are stretches of up to 51, and the rest, behind which the time was over.
#[test]
fn stretches_say_how_they_left_their_episode() {
    let (dqn, _) = played(130, &[]);
    let mut steps = 0;
    let mut ends = Vec::new();
    while let Some(option) = dqn.recorder.replay.option((0, ends.len() as u32)) {
        steps += u32::from(option.steps);
        assert_eq!(option.end == End::TimedOut, steps.is_multiple_of(60), "{option:?}");
        ends.push(option.end);
    }
    assert_eq!(ends.iter().filter(|end| **end == End::TimedOut).count(), 2);
}
