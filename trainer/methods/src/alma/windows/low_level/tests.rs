use std::collections::BTreeMap;

use sortie_envs::random::{below, chance};
use sortie_learn::networks::Targets;
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::layers::SparseRows;
use sortie_nn::random::signed_unit;
use sortie_nn::tape::Tape;

use super::teams::{Look, Teams, View};
use super::*;
use crate::alma::agents::{Conditioning, UtilityLayers};
use crate::alma::records::config::ReturnsConfig;
use crate::alma::windows::{NO_ACTION, NO_TASK};
use sortie_learn::random::{Purpose, generator};

pub(super) const SIZES: WindowShape = WindowShape {
    windows: 6,
    steps: 9,
    agents: 3,
    entities: 6,
    tasks: 3,
    actions: 4,
    features: 5,
    targets: Targets::NONE,
};

pub(super) fn config(conditioning: Conditioning) -> LowLevelConfig {
    LowLevelConfig {
        conditioning,
        width: 8,
        heads: 2,
        base: 6,
        hypernetwork_width: 12,
        hypernetwork_heads: 3,
        mixing: 5,
        ..LowLevelConfig::default()
    }
}

fn learner(config: LowLevelConfig, sizes: WindowShape) -> LowLevel {
    let mut learner = LowLevel::new(config, sizes, &mut generator(1, Purpose::Weights, 0));
    // Target networks of their own, so that nothing passes for the other.
    let other = &mut generator(2, Purpose::Weights, 0);
    learner.target = LowLevel::new(learner.config.clone(), sizes, other).online.values;
    learner
}

/// The utilities `[W S, A, U]` in all states as the learner computes them, zeros for absent agents.
/// Memories are empty at the begin of a window.
pub(crate) fn agent_utilities(
    agents: Agents<'_>,
    windows: &Windows,
    conditioning: Conditioning,
    order: &TaskOrder,
) -> Vec<f32> {
    let parameters = agents.network.parameters;
    let network = UtilityLayers::of(agents.network.shape);
    let layers = AgentLayers { network, unit: agents.unit };
    let look = Look::new((windows, View::NOW), (conditioning, order), agents.network.shape.targets);
    let WindowShape { windows: count, steps, agents, actions, .. } = windows.shape;
    let mut utilities = vec![0.0; windows.shape.states() * agents * actions];
    let mut tape = Tape::default();
    for window in 0..count {
        let states = window * steps..(window + 1) * steps;
        let mut teams = teams(windows, states, Conditioning::None);
        let mut t = tape.begin(parameters);
        let rows = layers.utilities(&mut t, look, &mut teams, None);
        for (row, (state, agent)) in t.values(rows).chunks_exact(actions).zip(teams.agents()) {
            utilities[(state * agents + agent) * actions..][..actions].copy_from_slice(row);
        }
    }
    utilities
}

/// The teams of some states: of every subtask, whether it has agents or not; without subtasks, everybody.
fn teams(windows: &Windows, states: Range<usize>, conditioning: Conditioning) -> Teams {
    let mut teams = Teams::default();
    for state in states {
        let scene = View::NOW.of(windows, state);
        if conditioning.has_subtasks() {
            (0..windows.shape.tasks).for_each(|task| teams.push(scene, state, Some(task)));
        } else {
            teams.push(scene, state, None);
        }
    }
    teams
}

/// What a mixer sees of all teams of all states, and state and number of every agent in its order.
pub(crate) fn team_input(
    windows: &Windows,
    conditioning: Conditioning,
) -> (MixerInput, Vec<(usize, usize)>) {
    let mut teams = teams(windows, 0..windows.shape.states(), conditioning);
    let order = TaskOrder::identity(windows.shape.tasks);
    let mut input = MixerInput::default();
    let look = Look::new((windows, View::NOW), (conditioning, &order), windows.shape.targets);
    teams.write_mixer(look, &mut input);
    (input, teams.agents().collect())
}

/// The values `[W S, T]` of all teams in normalised units, without subtasks `[W S]`, from the utilities
/// `[W S, A]` of what the agents do; `parameters` are those among which the mixer's are.
pub(crate) fn team_values(
    mixer: Mixer,
    parameters: &[f32],
    windows: &Windows,
    conditioning: Conditioning,
    utilities: &[f32],
) -> Vec<f32> {
    let (input, agents) = team_input(windows, conditioning);
    let own = agents.iter().map(|(state, agent)| utilities[state * windows.shape.agents + agent]);
    let own: Vec<f32> = own.collect();
    let (mut tape, mut all) = (Tape::default(), parameters.to_vec());
    mixer.append_merged(&mut tape, &mut all);
    let mut t = tape.begin(&all);
    let utilities = t.input(1, &own);
    let values = mixer.mix(&mut t, parameters.len(), &input, utilities);
    let outputs = (0..mixer.shape.outputs as u32).cycle().take(input.teams.teams());
    let values = mixer.head(&mut t, values, &outputs.collect::<Vec<_>>());
    t.values(values).to_vec()
}

/// Entities come and go, agents are allocated anew now and then, nobody sees everything.
pub(super) fn random_windows(sizes: WindowShape, seed: u64) -> Windows {
    let draw = &mut generator(seed, Purpose::Rollout, 0);
    let mut windows = Windows::new(sizes);
    windows.features.clear();
    for state in 0..sizes.states() {
        for entity in 0..sizes.entities {
            let at = state * sizes.entities + entity;
            windows.present[at] = chance(draw, 0.8);
            if windows.present[at] {
                (0..sizes.features)
                    .for_each(|column| windows.features.push(column, signed_unit(draw)));
                windows.entity_task[at] = below(draw, sizes.tasks) as u8;
            }
            windows.features.end_row();
        }
        for agent in 0..sizes.agents {
            let at = state * sizes.agents + agent;
            windows.actions[at] = below(draw, sizes.actions) as u8;
            windows.last_actions[at] = below(draw, sizes.actions) as u8;
            for entity in 0..sizes.entities {
                let sees = entity == agent || chance(draw, 0.8);
                windows.observable[at * sizes.entities + entity] = sees;
            }
        }
        windows.reward[state] = signed_unit(draw);
        windows.has_transition[state] = chance(draw, 0.9);
        windows.terminated[state] = chance(draw, 0.1);
        windows.reset[state] = chance(draw, 0.1);
        for task in 0..sizes.tasks {
            let at = state * sizes.tasks + task;
            windows.task_reward[at] = signed_unit(draw);
            windows.task_unfinished[at] = chance(draw, 0.8);
            windows.task_terminated[at] = chance(draw, 0.1);
        }
    }
    windows.available.fill((1 << sizes.actions) - 1);
    windows
}

pub(super) fn draws() -> Generator {
    generator(3, Purpose::Replay, 0)
}

#[test]
fn rewards_of_more_steps_count_until_the_team_changes() {
    let mut windows = random_windows(SIZES, 7);
    // Everybody is there and holds on to an unfinished subtask for four steps.
    windows.present.fill(true);
    windows.task_unfinished.fill(true);
    for state in 0..SIZES.states() {
        let own = &mut windows.entity_task[state * SIZES.entities..][..SIZES.agents];
        own.fill((state / 4 % SIZES.tasks) as u8);
    }
    windows.features = SparseRows::default();
    (0..SIZES.states() * SIZES.entities).for_each(|_| windows.features.end_row());
    for conditioning in [Conditioning::Mask, Conditioning::None] {
        let run = |steps: u32| {
            let returns = ReturnsConfig { steps, discount: 0.5, shaping: 0.0 };
            let mut learner = learner(LowLevelConfig { returns, ..config(conditioning) }, SIZES);
            learner.descend(&windows, 1, &mut draws());
            learner.terms().map(|term| ((term.state, term.task), term.target)).collect()
        };
        let outcome = |(state, task): (usize, usize)| match conditioning {
            Conditioning::None => (windows.reward[state], windows.terminated[state]),
            _ => {
                let at = state * SIZES.tasks + task;
                (windows.task_reward[at], windows.task_terminated[at])
            }
        };
        let (one, three): (BTreeMap<_, f64>, BTreeMap<_, f64>) = (run(1), run(3));
        assert_eq!(one.len(), three.len());
        let mut longer = 0;
        for ((state, task), found) in three {
            // The last step that counts has its own target of one step.
            let (mut expected, mut weight) = (0.0, 1.0);
            for step in 0..3 {
                let at = (state + step, task);
                let changes = conditioning == Conditioning::Mask
                    && windows.allocation(at.0) != windows.allocation(at.0 + 1);
                let next_counts =
                    (at.0 + 1) % SIZES.steps + 1 < SIZES.steps && windows.has_transition[at.0 + 1];
                if step == 2 || outcome(at).1 || changes || !next_counts {
                    expected += weight * one[&at];
                    break;
                }
                expected += weight * f64::from(outcome(at).0);
                weight *= 0.5;
                longer += 1;
            }
            assert!(
                (found - expected).abs() < 1e-6,
                "{conditioning:?} {state}: {found} {expected}"
            );
        }
        assert!(longer > 20, "{longer}");
    }
}

#[test]
fn gradients_agree_with_finite_differences() {
    let mut windows = random_windows(SIZES, 1);
    // One action is left to each agent: targets jump where the best action changes.
    windows.available.fill(1);
    for (conditioning, recurrent, skip) in [
        (Conditioning::Mask, false, false),
        (Conditioning::Input, false, false),
        (Conditioning::None, false, false),
        (Conditioning::Mask, true, false),
        (Conditioning::Input, true, false),
        (Conditioning::Mask, false, true),
        (Conditioning::None, false, true),
        (Conditioning::Input, true, true),
    ] {
        let extra_tasks = usize::from(conditioning == Conditioning::Input);
        let config = LowLevelConfig { extra_tasks, recurrent, skip, ..config(conditioning) };
        let mut fresh = learner(config, SIZES);
        // Utilities of some size, so that the slope by their weights is more than rounding.
        let tensors = fresh.shape().tensors();
        let head = tensors[7].range.clone();
        fresh.online.values[head].iter_mut().for_each(|weight| *weight *= 60.0);
        let mut learner = fresh.clone();
        learner.descend(&windows, 1, &mut draws());
        let parts = ["memory", "mixer.w1", "mixer.b1", "mixer.w2", "mixer.v", "mixer.head"];
        let parts = parts.map(|name| (name, fresh.part(name)));
        assert_eq!(parts[0].1.is_empty(), !recurrent);
        let agents = tensors.iter().map(|tensor| (&*tensor.name, tensor.range.clone()));
        for (name, range) in agents.chain(parts).filter(|(_, range)| !range.is_empty()) {
            let parameters = &fresh.online.values[range.clone()];
            let gradient = &learner.gradient[range.clone()];
            assert_gradient(name, parameters, gradient, |parameters| {
                let mut moved = fresh.clone();
                moved.online.values[range.clone()].copy_from_slice(parameters);
                moved.descend(&windows, 1, &mut draws()).loss
            });
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let sizes = WindowShape { windows: 12, steps: 25, ..SIZES };
    let windows = random_windows(sizes, 2);
    for (conditioning, recurrent) in
        [(Conditioning::Mask, false), (Conditioning::Input, true), (Conditioning::None, false)]
    {
        let learned = [1, 2, 3].map(|threads| {
            let config = LowLevelConfig { recurrent, ..config(conditioning) };
            let mut learner = learner(config, sizes);
            let reports = [0, 1].map(|_| learner.learn(&windows, threads, &mut draws()));
            assert!(reports[0].terms > 100);
            (reports, learner.online, learner.optimiser)
        });
        assert_eq!(learned[0], learned[1]);
        assert_eq!(learned[0], learned[2]);
    }
}

#[test]
fn a_batch_without_terms_changes_nothing() {
    let mut learner = learner(config(Conditioning::Mask), SIZES);
    let before = (learner.online.clone(), learner.optimiser.clone());
    let report = learner.learn(&Windows::new(SIZES), 1, &mut draws());
    assert_eq!(report, LowLevelReport::default());
    assert_eq!(before, (learner.online, learner.optimiser));
}

/// One window of four states in which nothing but features and rewards changes.
fn steady(ends_truly: bool) -> Windows {
    let sizes = WindowShape { windows: 1, steps: 5, ..SIZES };
    let mut windows = random_windows(sizes, 5);
    windows.features.clear();
    let draw = &mut generator(6, Purpose::Rollout, 0);
    for _ in 0..sizes.states() * sizes.entities {
        windows.features.push(below(draw, sizes.features), signed_unit(draw));
        windows.features.end_row();
    }
    windows.present.fill(true);
    windows.observable.fill(true);
    for tasks in windows.entity_task.chunks_exact_mut(sizes.entities) {
        tasks.copy_from_slice(&[0, 0, 1, 0, 1, NO_TASK]);
    }
    windows.last_actions.fill(NO_ACTION);
    windows.task_unfinished.fill(true);
    windows.task_terminated.fill(false);
    windows.terminated.fill(false);
    // The second step ends the episode: the state behind it is its last, then another begins.
    windows.reset[1] = true;
    windows.terminated[1] = ends_truly;
    windows.task_terminated[sizes.tasks..2 * sizes.tasks].fill(ends_truly);
    windows.has_transition = vec![true, true, false, true, true];
    windows
}

/// The discounted value of every team in every state by the target networks, at the actions that the
/// online networks find best.
fn discounted_values(learner: &LowLevel, windows: &Windows) -> Vec<f64> {
    let order = learner.draw_order(&mut draws());
    let actions = windows.shape.actions;
    let conditioning = learner.config.conditioning;
    let shape = learner.shape();
    let utilities = |parameters: &[f32]| {
        let agents = Agents::new(UtilityView { shape, parameters });
        agent_utilities(agents, windows, conditioning, &order)
    };
    let (online, target) = (utilities(&learner.online.values), utilities(&learner.target));
    let best = |row: &[f32]| (0..actions).max_by(|a, b| row[*a].total_cmp(&row[*b]));
    let utilities = online.chunks_exact(actions).zip(target.chunks_exact(actions));
    let utilities = utilities.map(|(online, target)| target[best(online).expect("an action")]);
    let utilities: Vec<f32> = utilities.collect();
    let (mixer, parameters) = (learner.layers.mixer, &learner.target);
    let values = team_values(mixer, parameters, windows, conditioning, &utilities);
    let real = |value: f32| learner.target_popart.denormalise(f64::from(value));
    values.into_iter().map(|value| 0.99 * real(value)).collect()
}

#[test]
fn a_timeout_bootstraps_and_a_true_end_does_not() {
    for conditioning in [Conditioning::Mask, Conditioning::None] {
        for ends_truly in [false, true] {
            let windows = steady(ends_truly);
            let mut learner = learner(config(conditioning), windows.shape);
            learner.target_popart = PopArt { mean: 2.0, variance: 9.0, started: true };
            learner.descend(&windows, 1, &mut draws());
            let next = discounted_values(&learner, &windows);

            let tasks = windows.shape.tasks;
            let subtasks = conditioning.has_subtasks();
            let states: Vec<usize> = learner.terms().map(|term| term.state).collect();
            // The last state of an episode and that of the window carry no loss.
            assert_eq!(states, if subtasks { vec![0, 0, 1, 1, 3, 3] } else { vec![0, 1, 3] });
            for term in learner.terms() {
                let (reward, next) = if subtasks {
                    let at = term.state * tasks + term.task;
                    (windows.task_reward[at], next[at + tasks])
                } else {
                    (windows.reward[term.state], next[term.state + 1])
                };
                let ends = ends_truly && term.state == 1;
                let want = f64::from(reward) + if ends { 0.0 } else { next };
                assert!((term.target - want).abs() < 1e-5, "{} against {want}", term.target);
            }
        }
    }
}

#[test]
fn one_subtask_of_everybody_is_as_none() {
    let sizes = WindowShape { tasks: 1, ..SIZES };
    let mut windows = random_windows(sizes, 7);
    windows.task_reward.clone_from(&windows.reward);
    windows.task_terminated.clone_from(&windows.terminated);
    windows.task_unfinished.fill(true);
    for (task, present) in windows.entity_task.iter_mut().zip(&mut windows.present) {
        (*task, *present) = (0, true);
    }
    let [masked, flat] = [Conditioning::Mask, Conditioning::None].map(|conditioning| {
        let mut learner = learner(config(conditioning), sizes);
        let report = learner.learn(&windows, 1, &mut draws());
        (report, learner.online)
    });
    assert!(masked.0.terms > 10);
    assert_eq!(masked, flat);
}

#[test]
fn orders_of_marks_are_permutations_and_differ() {
    let mut draws = draws();
    let orders: Vec<TaskOrder> = (0..20).map(|_| TaskOrder::shuffled(5, &mut draws)).collect();
    for order in &orders {
        let mut columns = order.0.clone();
        columns.sort_unstable();
        assert_eq!(columns, [0, 1, 2, 3, 4]);
    }
    assert!(orders.iter().any(|order| *order != orders[0]));
}
