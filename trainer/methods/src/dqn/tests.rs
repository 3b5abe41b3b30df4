//! What the agent without goals is paid and learns, beside naive lists.

use sortie_envs::Split;
use sortie_learn::Learner;
use sortie_learn::play::Play;
use sortie_learn::run::EpisodeCounts;
use sortie_learn::session::Setup;

use super::*;
use crate::options::tests::{Moment, at, greedy, kept, values};

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
        let other = played(1, &["network.active_inputs=3"]).0.agent.learner.target;
        // So large that values lie beyond what bounds them.
        dqn.agent.learner.target = other.iter().map(|weight| 3.0 * weight).collect();
        let (mut random, mut drawn) = (dqn.random.clone(), Vec::new());
        while drawn.len() < 24 {
            drawn.extend(dqn.draw(&*world));
        }
        std::mem::swap(&mut dqn.random, &mut random);
        let kept = (&dqn.recorder.replay, &dqn.shown);
        let QNetwork { network, learner } = &dqn.agent;
        let values = |weights: &[f32], place: Place, mirrored: bool| {
            values((network, weights), kept, (place, mirrored, 0))
        };
        let least = drawn.iter().map(|it| it.priority).fold(f64::MAX, f64::min);
        let (mut loss, mut errors) = (0.0, Vec::new());
        for lesson in &drawn {
            let action = kept.0.steps.actions(lesson.state)[0];
            let turned = world.turned_action(lesson.is_mirrored.into(), action);
            let (earned, next) = dqn.returns(lesson.state).unwrap();
            let follows = next.map_or(0.0, |next| {
                let chosen = values(&learner.online.values, next.place, lesson.is_mirrored);
                let worth = values(&learner.target, next.place, lesson.is_mirrored);
                let worth = worth[greedy(&chosen)];
                next.discount * if assignments.len() == 1 { worth.clamp(0.0, 1.0) } else { worth }
            });
            let found = values(&learner.online.values, lesson.state, lesson.is_mirrored);
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
fn targets_are_copied_every_so_many_updates_or_move_in_every_one() {
    for (every, copied) in [(2, [false, true, false]), (0, [false; 3])] {
        let keys = [&*format!("returns.target_every={every}"), "optimiser.target_rate=0.5"];
        let (mut dqn, world) = played(300, &keys);
        for copied in copied {
            let before = dqn.agent.learner.target.clone();
            dqn.learn(&*world, Now { env_steps: 1, of: 2 }, &mut Reports::default());
            let Learner { online, target, .. } = &dqn.agent.learner;
            assert_eq!(*target == online.values, copied, "{every}");
            assert_eq!(*target == before, every > 0 && !copied, "{every}");
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

/// Two episodes, one that is solved and one that ends by its time, and the first steps of a third.
fn episodes() -> (Vec<Moment>, Replay) {
    let step = Moment::default();
    let mut moments = vec![step; 40];
    for (at, reached) in [(3, 0), (5, 0), (8, 1), (13, 2), (17, 1), (35, 0), (37, 1), (38, 1)] {
        moments[at] = Moment { reached, ends_option: true, ..step };
    }
    moments[13].terminated = true;
    moments[14].is_last = true;
    moments[20].changed_nothing = true;
    moments[29].ends_option = true;
    moments[30].is_last = true;
    // Nothing can be reached any more.
    moments[35].terminated = true;
    moments[36].is_last = true;
    let replay = kept(&moments);
    (moments, replay)
}

/// Rewards summed up from the front, and what a value behind them counts, where it is looked up.
fn naive(
    moments: &[Moment],
    start: usize,
    rules: &ReturnsConfig,
) -> Option<(f32, f32, Option<usize>)> {
    let end = (start..moments.len()).find(|at| moments[*at].is_last).unwrap_or(moments.len());
    let solved = end > 0 && moments[end - 1].reached == 2;
    // The last step of an episode that was not solved may not count.
    let unknown = end < moments.len() && !solved && !rules.time_outs;
    let known = if unknown { end - 1 } else { end };
    let idle = (start..known).find(|at| rules.no_operations && moments[*at].changed_nothing);
    let last = (start + usize::from(rules.steps)).min(known).min(idle.unwrap_or(known));
    if idle == Some(start) {
        return Some((0.0, 0.0, None));
    }
    if start >= known || last == moments.len() {
        return None;
    }
    let begin = (0..start).rfind(|at| moments[*at].is_last).map_or(0, |last| last + 1);
    let met = |at: usize| (begin..at).any(|it| moments[it].reached == moments[at].reached);
    let is_paid = |at: usize| match moments[at].reached {
        NONE => false,
        reached if !rules.milestones => reached == 2,
        _ => !met(at),
    };
    let paid = if rules.milestones { 1.0 / 3.0 } else { 1.0 };
    let pay = |at: usize| if is_paid(at) { paid - rules.cost } else { -rules.cost };
    let sum = (start..last).map(|at| rules.discount.powi((at - start) as i32) * pay(at)).sum();
    if moments[last - 1].terminated {
        return Some((sum, 0.0, None));
    }
    Some((sum, rules.discount.powi((last - start) as i32), Some(last)))
}

#[test]
fn returns_are_those_of_a_naive_list() {
    let (moments, replay) = episodes();
    for number in 0..24 {
        let is = |bit: u32| number >> bit & 1 == 1;
        let rules = ReturnsConfig {
            steps: [1, 3, 10][number / 8],
            discount: 0.9,
            no_operations: is(0),
            time_outs: is(1),
            milestones: !is(2),
            cost: 0.25,
            ..ReturnsConfig::default()
        };
        for (start, _) in moments.iter().enumerate().filter(|(_, moment)| !moment.is_last) {
            let found = returns(&replay, at(start), rules.rules(), rules.paid(3));
            let found = found.map(|(earned, next)| {
                let place = next.map(|it| it.place.since(at(0)));
                (earned, next.map_or(0.0, |it| it.discount), place)
            });
            let want = naive(&moments, start, &rules);
            let close = match (found, want) {
                (Some(found), Some(want)) => {
                    let differences = [found.0 - want.0, found.1 - want.1];
                    found.2 == want.2 && differences.iter().all(|it| it.abs() < 1e-5)
                }
                (found, want) => found == want,
            };
            assert!(close, "{start} {rules:?}: {found:?} {want:?}");
        }
    }
}

#[test]
fn milestones_are_paid_for_where_an_episode_first_reaches_them() {
    let (dqn, _) = played(1_000, &[]);
    let steps = &dqn.recorder.replay.steps;
    let (mut met, mut counts) = (Vec::new(), [0; 2]);
    for place in (0..).map(at).take_while(|place| steps.has(*place)) {
        let (note, end) = (steps.note(place), steps.end(place));
        if end == End::Nothing {
            met.clear();
        } else if note.reached != NONE {
            let is_first = !met.contains(&note.reached);
            assert_eq!(note.is_first, is_first);
            met.push(note.reached);
            counts[usize::from(is_first)] += 1;
        } else {
            assert!(!note.is_first);
        }
    }
    assert!(counts.iter().all(|count| *count > 3), "{counts:?}");
}

#[test]
fn what_is_paid_is_shared_by_all_milestones_or_the_task_has_it() {
    assert_eq!(Config::default().returns.rewards(11), [1.0 / 11.0, 0.0]);
    let paper = Config::paper().returns;
    let [paid, other] = paper.rewards(11);
    assert!((paid - (1.0 + 1.0 / 11.0 - 0.01_f32).log2()).abs() < 1e-6);
    assert!((other + 0.014355).abs() < 1e-6);
    let [alone, _] = ReturnsConfig { milestones: false, ..paper }.rewards(11);
    assert!((alone - 0.99277).abs() < 1e-5);
}
