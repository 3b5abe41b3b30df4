use sortie_envs::random::chance;
use sortie_envs::{EntitySet, Observation, Shape, Split, Step};
use sortie_learn::Transition;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::random::Generator;

use super::*;
use crate::alma::agents::{Conditioning, TaskOrder, UtilityInput};
use crate::alma::coach::{Advice, Coach, seen_input};
use crate::alma::windows::low_level::tests::{SIZES, config, draws, random_windows};
use crate::alma::windows::low_level::{LowLevel, LowLevelConfig};
use crate::alma::windows::{NO_TASK, Note, Replay, SampleShape, WindowShape, Windows, cut_windows};

const SHAPE: CoachShape = CoachShape { features: 5, marks: 3, width: 8, heads: 2, strategy: 6 };

fn weights() -> Generator {
    generator(4, Purpose::Weights, 0)
}

/// Windows with decisions now and then, and one action left to each agent: targets jump where the best
/// action changes.
fn decided(sizes: WindowShape) -> Windows {
    let mut windows = random_windows(sizes, 1);
    windows.available.fill(1);
    let draw = &mut generator(5, Purpose::Rollout, 0);
    windows.decision.iter_mut().for_each(|decision| *decision = chance(draw, 0.3));
    windows
}

/// A learner without a coach, whose agents' own embeddings skip the attention.
fn alone(sizes: WindowShape) -> LowLevel {
    let config = LowLevelConfig { skip: true, ..config(Conditioning::None) };
    let mut learner = LowLevel::new(config, sizes, &mut weights());
    // Utilities of some size, so that slopes are more than rounding.
    let head = learner.shape().tensors()[7].range.clone();
    learner.online.values[head].iter_mut().for_each(|weight| *weight *= 60.0);
    learner.target.clone_from(&learner.online.values);
    learner
}

/// The same with a coach whose terms weigh enough to be seen, and a target of its own.
fn coached(sizes: WindowShape) -> LowLevel {
    let mut learner = alone(sizes);
    learner.add_coach(&CoachConfig { enabled: true, beta: 0.05 }, &mut weights());
    let (other, place) = (coach(SHAPE, 6).1, learner.part("coach"));
    learner.target[place].copy_from_slice(&other.values);
    learner
}

/// A coach of its own.
fn coach(shape: CoachShape, seed: u64) -> (CoachLayers, Parameters) {
    let mut parameters = Parameters::default();
    let random = &mut generator(seed, Purpose::Weights, 0);
    (CoachLayers::new(shape, &mut parameters, random), parameters)
}

#[test]
fn gradients_of_a_step_agree_with_finite_differences() {
    let windows = decided(SIZES);
    let fresh = coached(SIZES);
    let mut learner = fresh.clone();
    let report = learner.descend(&windows, 1, &mut draws());
    assert!(report.coach_loss > 0.1, "{report:?}");
    let agents = 0..fresh.shape().parameters();
    let recognition = fresh.part("recognition");
    assert_eq!(learner.gradient.len(), recognition.end);
    let parts = [("agents", agents), ("coach", fresh.part("coach")), ("recognition", recognition)];
    for (name, range) in parts {
        let parameters = &fresh.online.values[range.clone()];
        let gradient = &learner.gradient[range.clone()];
        assert_gradient(name, parameters, gradient, |parameters| {
            let mut moved = fresh.clone();
            moved.online.values[range.clone()].copy_from_slice(parameters);
            let report = moved.descend(&windows, 1, &mut draws());
            report.loss + report.coach_loss
        });
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let sizes = WindowShape { windows: 12, steps: 25, ..SIZES };
    let windows = decided(sizes);
    let learned = [1, 2, 3].map(|threads| {
        let mut learner = coached(sizes);
        let reports = [0, 1].map(|_| learner.learn(&windows, threads, &mut draws()));
        assert!(reports[0].terms > 100);
        (reports, learner.online)
    });
    assert_eq!(learned[0], learned[1]);
    assert_eq!(learned[0], learned[2]);
    let (before, place) = (coached(sizes), coached(sizes).part("coach"));
    assert_ne!(learned[0].1.values[place.clone()], before.online.values[place]);
}

#[test]
fn players_that_are_told_nothing_learn_as_flat_agents() {
    let windows = random_windows(SIZES, 1);
    let (mut told_nothing, mut flat) = (coached(SIZES), alone(SIZES));
    let [coached, alone] =
        [&mut told_nothing, &mut flat].map(|learner| learner.descend(&windows, 1, &mut draws()));
    assert_eq!((coached.loss, coached.target), (alone.loss, alone.target));
    assert_eq!(told_nothing.gradient[..flat.gradient.len()], flat.gradient);
}

#[test]
fn strategies_are_held_until_the_next_decision() {
    let sizes = WindowShape { windows: 2, steps: 4, ..SIZES };
    let mut windows = random_windows(sizes, 2);
    windows.present.fill(true);
    windows.present[2 * sizes.entities + 1] = false;
    windows.decision = [false, true, false, true, false, false, true, false].into();
    windows.decision[3] = false;
    let [first, second] = [0, 1].map(|window| Decisions::of(&windows, window));
    assert_eq!((&*first.states, first.count), (&[1][..], 3));
    assert_eq!((&*second.states, second.count), (&[6][..], 3));
    let held = |decisions: &Decisions, state| [0, 1, 2].map(|agent| decisions.held(state, agent));
    let (nothing, told) = ([0; 3], [1, 2, 3]);
    assert_eq!([0, 1, 2, 3].map(|state| held(&first, state)), [nothing, told, told, told]);
    assert_eq!([4, 5, 6, 7].map(|state| held(&second, state)), [nothing, nothing, told, told]);
}

#[test]
fn a_coach_sees_the_same_where_agents_play_and_where_they_learn() {
    let world = sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, &Default::default());
    let mut world = world.unwrap();
    world.reset(0, &mut sortie_envs::random::generator(3));
    let Shape { agents, tasks, features, .. } = world.spec().shape;
    let mut state = Vec::new();
    world.save(0, &mut state);
    let mut seen = Observation::default();
    world.observe(&state, 0, EntitySet::MAX, &mut seen);
    let mut replay = Replay::new(1, 1, &world.spec().shape);
    let transition = Transition {
        environment: &*world,
        instance: 0,
        state: &state,
        actions: &vec![0; agents],
        step: Step { timed_out: true, ..Step::default() },
        task_rewards: &[],
        agent_rewards: &[],
        next: &state,
    };
    replay.push(&transition, &vec![NO_TASK; agents], Note { decision: true, added: 0 });
    let sample = SampleShape { windows: 1, steps: 2, ..SampleShape::default() };
    let windows = cut_windows(&*world, &replay, &replay.episodes(), sample, &mut draws());

    let shape = CoachShape { features, marks: tasks, ..SHAPE };
    let order = TaskOrder::shuffled(tasks, &mut draws());
    let [mut playing, mut learning] = [UtilityInput::default(), UtilityInput::default()];
    seen_input(shape, &seen, &order, &mut playing);
    state_input(shape, &windows, &[0], &order, false, &mut learning);
    assert_eq!(playing, learning);

    let (layers, parameters) = coach(shape, 4);
    let [mut told, mut drawn] = [Vec::new(), Vec::new()];
    let mut advice = Advice::new(Coach { layers, parameters: &parameters.values });
    advice.mean(&seen, &mut told).unwrap();
    advice.draw(&seen, &mut draws(), &mut drawn);
    assert_eq!((told.len(), drawn.len()), (seen.agents() * 6, seen.agents() * 6));
    assert_ne!(told, drawn);
    let (layers, parameters) = coach(CoachShape { marks: 1, ..shape }, 4);
    let few = Coach { layers, parameters: &parameters.values };
    let refused = Advice::new(few).mean(&seen, &mut told).unwrap_err();
    assert!(refused.to_string().contains("knows 1 subtasks"), "{refused}");
}
