use std::collections::BTreeSet;

use sortie_envs::random::generator;
use sortie_envs::registry::Setting;
use sortie_envs::{EntitySet, Environment, Observation, Split};
use sortie_learn::Now;
use sortie_learn::learner::Loss;
use sortie_learn::play::Play;
use sortie_learn::trajectory::End;
use sortie_nn::gradient_check::{assert_gradient, random};
use sortie_nn::tape::{Parameters, Pass, Tape};

use super::lesson::{Lesson, Rules, advantages};
use super::networks::Shown;
use super::*;

const FORMS: [(bool, Sees); 4] =
    [(false, Sees::State), (false, Sees::Own), (true, Sees::State), (true, Sees::Own)];
const INSTANCES: usize = 2;

fn battles(vectors: bool) -> Box<dyn Environment> {
    let settings = [("vectors".to_owned(), Setting::Flag(vectors))].into();
    sortie_envs::open("smax/2s3z", Split::Train, 1, &settings).unwrap()
}

/// A method that has played so many steps of two battles, which go on behind the end of the rollout or do not.
fn played(
    world: &dyn Environment,
    (critic, width): (Sees, usize),
    steps: usize,
    rollout: usize,
) -> Mappo {
    let mut setup = MAPPO.preset("fast").unwrap();
    setup.environment.instances = INSTANCES;
    let mut config: Config = setup.own().unwrap();
    config.network = NetworkConfig { critic, width, ..config.network };
    config.rollout.steps = rollout;
    let opening = Opening { setup: &setup, environment: world, seed: 1, threads: 2 };
    let mut method = Mappo::new(config, &opening);
    let mut play = Play::new(world, &mut method, (1..).map(generator).take(INSTANCES).collect());
    for _ in 0..steps {
        play.round(&mut method, Now::default(), &mut Default::default()).unwrap();
    }
    method
}

/// The states of a method's rollout, as all of them are to be seen, and how they were left.
fn states(world: &dyn Environment, method: &Mappo) -> Vec<(Observation, End)> {
    let rollout = &method.rollout;
    let places = (0..INSTANCES).flat_map(|instance| rollout.places(instance));
    let seen = |place| {
        let mut seen = Observation::default();
        world.observe(rollout.state(place), 0, EntitySet::MAX, &mut seen);
        (seen, rollout.end(place))
    };
    places.map(seen).collect()
}

/// What is computed by these weights.
fn values(weights: &[f32], of: impl Fn(&mut Pass<'_>) -> sortie_nn::tape::Var) -> Vec<f32> {
    let mut tape = Tape::default();
    let mut pass = tape.begin(weights);
    let found = of(&mut pass);
    pass.values(found).to_vec()
}

/// What is descended has the slopes of this loss.
fn check(
    name: &str,
    parameters: &Parameters,
    descended: impl Fn(&mut Pass<'_>) -> Loss,
    loss: impl Fn(&[f32]) -> f64,
) {
    let mut gradient = vec![0.0; parameters.values.len()];
    let mut tape = Tape::default();
    let mut pass = tape.begin(&parameters.values);
    let found = descended(&mut pass);
    pass.backward(found.total, &mut gradient);
    for tensor in parameters.tensors() {
        let place = tensor.range.clone();
        let (at, slopes) = (&parameters.values[place.clone()], &gradient[place.clone()]);
        assert_gradient(&format!("{} of {name}", tensor.name), at, slopes, |moved| {
            let mut weights = parameters.values.clone();
            weights[place.clone()].copy_from_slice(moved);
            loss(&weights)
        });
    }
}

/// The loss of an actor as it is written: the lesser of two products, and entropy, over what is available.
fn actor_loss(lesson: &Lesson, scores: &[f32], rules: Rules) -> f64 {
    let columns = scores.len() / lesson.places.len();
    let mut loss = 0.0;
    let rows = scores.chunks_exact(columns).zip(lesson.shown.available()).enumerate();
    for (row, (scores, open)) in rows {
        let open = |action: &usize| open >> action & 1 == 1;
        let power = |action: usize| f64::from(scores[action]).exp();
        let all: f64 = (0..columns).filter(open).map(power).sum();
        let chance = |action: usize| power(action) / all;
        let action = lesson.actions[row] as usize;
        assert!(open(&action), "{action} was taken");
        let ratio = chance(action) / f64::from(lesson.logarithms[row]).exp();
        let (advantage, clip) = (f64::from(lesson.advantages[row]), f64::from(rules.clip));
        let [free, held] = [ratio, ratio.clamp(1.0 - clip, 1.0 + clip)].map(|it| it * advantage);
        let entropy: f64 =
            (0..columns).filter(open).map(|action| -chance(action) * chance(action).ln()).sum();
        loss -= free.min(held) + f64::from(rules.entropy) * entropy;
    }
    loss / rules.decisions as f64
}

/// Some decisions in the midst of a battle, and what came of them by chance.
fn decisions(world: &dyn Environment, method: &Mappo) -> Lesson {
    let places: Vec<_> = method.rollout.places(0).enumerate().skip(8).take(4).collect();
    let mut lesson = Lesson::of(world, &method.rollout, &places);
    lesson.advantages = random(3, lesson.places.len());
    lesson.targets = random(4, lesson.places.len());
    lesson
}

/// Of chances that have moved both ways, within bounds and beyond them, of decisions good and bad.
#[test]
fn gradients_of_actors_agree_with_finite_differences() {
    for vectors in [false, true] {
        let world = battles(vectors);
        let method = played(&*world, (Sees::State, 4), 12, 12);
        let (mut lesson, rules) =
            (decisions(&*world, &method), Rules { decisions: 9, clip: 0.1, entropy: 0.3 });
        let (actor, weights) = (&method.actor, &method.policy.online);
        lesson.logarithms = values(&weights.values, |pass| lesson.chances(pass, actor));
        let ratios = [0.7_f32, 0.95, 1.05, 1.4].into_iter().cycle();
        lesson.logarithms.iter_mut().zip(ratios).for_each(|(log, ratio)| *log -= ratio.ln());
        let descended = |pass: &mut Pass<'_>| lesson.actor_loss(pass, actor, rules);
        check(&format!("the actor, vectors {vectors}"), weights, descended, |weights| {
            let scores = values(weights, |pass| actor.numbers(pass, &lesson.shown));
            actor_loss(&lesson, &scores, rules)
        });
    }
}

#[test]
fn gradients_of_critics_agree_with_finite_differences() {
    for (vectors, critic) in FORMS {
        let world = battles(vectors);
        let method = played(&*world, (critic, 16), 12, 12);
        let (lesson, rules) =
            (decisions(&*world, &method), Rules { decisions: 9, clip: 0.1, entropy: 0.3 });
        let (network, weights) = (&method.critic, &method.values.online);
        let name = format!("the critic, vectors {vectors}, {critic:?}");
        let descended = |pass: &mut Pass<'_>| lesson.critic_loss(pass, network, rules);
        check(&name, weights, descended, |weights| {
            let values = values(weights, |pass| network.numbers(pass, &lesson.shown));
            let errors = values.iter().zip(&lesson.targets);
            errors.map(|(value, target)| f64::from(value - target).powi(2)).sum::<f64>() / 9.0
        });
    }
}

/// Two episodes of three and two steps, the first of which ends, and one that time ran out in; each with two agents.
#[test]
fn advantages_are_sums_of_errors() {
    use End::{Nothing, Open, Over, TimedOut};
    let ends = [Open, Open, Over, Nothing, Open, TimedOut, Nothing];
    let rewards = random(1, ends.len());
    let states: Vec<_> = rewards.iter().copied().zip(ends).collect();
    let values = random(2, 2 * ends.len());
    let (discount, lambda) = (0.9_f32, 0.7_f32);
    let found = advantages(&states, &values, [discount, lambda]);
    for (first, last) in [(0, 2), (4, 5)] {
        for (start, agent) in (first..=last).flat_map(|start| [(start, 0), (start, 1)]) {
            let value = |state: usize| values[2 * state + agent];
            let next = |state| if ends[state] == Over { 0.0 } else { discount * value(state + 1) };
            let error = |state: usize| rewards[state] + next(state) - value(state);
            let of = |state: usize| (discount * lambda).powi((state - start) as i32) * error(state);
            let want: f32 = (start..=last).map(of).sum();
            let found = found[2 * start + agent];
            assert!((found - want).abs() < 1e-6, "{start} {agent}: {found} {want}");
        }
    }
    assert!([6, 7, 12, 13].iter().all(|nothing| found[*nothing] == 0.0), "{found:?}");
}

#[test]
fn every_decision_of_whoever_acts_is_learned_from_once() {
    for (vectors, critic) in FORMS {
        let world = battles(vectors);
        let mut method = played(&*world, (critic, 16), 60, 60);
        let states = states(&*world, &method);
        assert!(states.iter().any(|(seen, _)| seen.absent != 0), "nobody died");
        let acting = |(number, (seen, end)): (usize, &(Observation, End))| {
            let agents = (0..5).filter(|agent| seen.acting() >> agent & 1 == 1);
            let decided = if *end == End::Nothing { 0 } else { 5 };
            agents.take(decided).map(move |agent| number * 5 + agent).collect::<Vec<_>>()
        };
        let want: BTreeSet<usize> = states.iter().enumerate().flat_map(acting).collect();
        let lessons = method.lessons(&*world);
        let places: Vec<usize> =
            lessons.iter().flat_map(|lesson| &lesson.places).copied().collect();
        assert!(!places.is_sorted(), "states are learned from as they came");
        assert_eq!((places.len(), places.into_iter().collect::<BTreeSet<_>>()), (want.len(), want));
        let advantages = lessons.iter().flat_map(|lesson| &lesson.advantages);
        let (mean, square) = advantages.clone().fold((0.0, 0.0), |(mean, square), advantage| {
            (mean + f64::from(*advantage), square + f64::from(advantage * advantage))
        });
        let count = advantages.count() as f64;
        assert!((mean / count).abs() < 1e-5 && (square / count - 1.0).abs() < 0.05);
    }
}

/// As if time ran out there; who is over stays so.
#[test]
fn a_rollout_ends_with_the_states_that_its_last_steps_led_to() {
    let world = battles(false);
    for steps in 20..60 {
        let whole = states(&*world, &played(&*world, (Sees::State, 4), steps, 1_000));
        let cut = states(&*world, &played(&*world, (Sees::State, 4), steps, steps));
        let ends = |states: &[(Observation, End)], kind| {
            states.iter().filter(|(_, end)| *end == kind).count()
        };
        let over = ends(&whole, End::Over);
        let running = INSTANCES - last_over(&whole, steps);
        assert_eq!(ends(&cut, End::Over), over, "{steps}");
        assert_eq!(ends(&cut, End::TimedOut), running, "{steps}");
        assert_eq!(ends(&cut, End::Nothing), over + running, "{steps}");
    }
}

/// How many of the instances ended an episode in their last step.
fn last_over(states: &[(Observation, End)], steps: usize) -> usize {
    let mut taken = 0;
    let mut over = 0;
    for (_, end) in states.iter().filter(|(_, end)| *end != End::Nothing) {
        taken += 1;
        over += usize::from(taken % steps == 0 && *end == End::Over);
    }
    over
}

#[test]
fn who_is_dead_has_the_value_of_the_others() {
    for (vectors, critic) in FORMS {
        let world = battles(vectors);
        let mut method = played(&*world, (critic, 16), 60, 60);
        method.config.returns = ReturnsConfig { discount: 1.0, lambda: 0.0, scale: 0.0 };
        let states = states(&*world, &method);
        let lessons = method.lessons(&*world);
        // Without rewards an advantage is by how much the next value is greater, a target that value.
        let targets = lessons.iter().flat_map(|lesson| lesson.places.iter().zip(&lesson.targets));
        let targets: std::collections::BTreeMap<usize, f32> =
            targets.map(|(place, target)| (*place, *target)).collect();
        let mut differ = 0;
        for (number, window) in states.windows(2).enumerate() {
            let [(before, end), (after, _)] = window else { panic!("two") };
            if *end != End::Open && *end != End::TimedOut {
                continue;
            }
            let team = |set: u64| (0..5).filter(move |agent| set >> agent & 1 == 1);
            let target = |agent: usize| targets[&(number * 5 + agent)];
            // What follows a rollout is worth something.
            assert!(team(before.acting()).all(|agent| target(agent) != 0.0), "{end:?}");
            let mean = team(after.acting()).map(target).sum::<f32>();
            let mean = mean / after.acting().count_ones() as f32;
            for agent in team(before.acting() & !after.acting()) {
                assert!((target(agent) - mean).abs() < 1e-5, "{} {mean}", target(agent));
            }
            differ += team(after.acting()).filter(|it| (target(*it) - mean).abs() > 1e-4).count();
        }
        // A critic of the state values it alike for all.
        assert_eq!(differ > 0, critic == Sees::Own, "{differ} {critic:?}");
    }
}

/// Allies stand still; enemies do not, who are too far away to be seen.
#[test]
fn a_critic_of_the_state_knows_what_agents_do_not_see() {
    for (vectors, critic) in FORMS {
        let mut world = battles(vectors);
        let method = played(&*world, (critic, 16), 1, 1);
        let random = &mut generator(1);
        world.reset(0, random);
        let [before, after] = [0, 1].map(|_| {
            let (mut state, mut shown) = (Vec::new(), Shown::default());
            world.save(0, &mut state);
            world.step(0, &[4; 5], random).unwrap();
            shown.push(&*world, &state);
            shown.finish(world.spec());
            let weights = &method.values.online.values;
            values(weights, |pass| method.critic.numbers(pass, &shown))
        });
        assert_eq!(
            before != after,
            critic == Sees::State,
            "vectors {vectors}: {before:?} {after:?}"
        );
        assert!(before.len() == 5 && before[0] != 0.0, "{before:?}");
    }
}
