//! Laws of the allocation networks: probabilities, gradients, and that they learn.

use std::ops::Range;

use rand_core::Rng;
use sortie_envs::random::{below, chance};
use sortie_learn::networks::Targets;
use sortie_nn::gradient_check::{assert_gradient, random};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Parameters, Tape, Tensor};

use super::decide::blocks;
use super::networks::{AllocationCritic, AllocationPolicy, CriticInput};
use super::proposals::{Noise, Proposals, entropy};
use super::rows::Shown;
use super::{
    AllocationLearning, AllocationLevel, AllocationNetworks, AllocationShape, Decider, States,
    StepDraws, TaskColumns,
};
use crate::alma::windows::config::AllocationConfig;
use crate::alma::windows::{Config, NO_TASK, WindowShape, Windows};
use sortie_learn::random::{Purpose, generator};

/// The proposals for some states, P each.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Proposed {
    /// `[states, P, A]`: the subtask of every agent; absent agents have none.
    pub(crate) allocations: Vec<u8>,
    /// `[states, P]`: `log f(b | s)`
    pub(crate) log_probabilities: Vec<f32>,
    /// `[states, P]`: the entropy of the choices that led there, summed over the agents.
    pub(crate) entropies: Vec<f32>,
}

impl Decider {
    /// Proposes P allocations for every state.
    pub(crate) fn propose(
        &mut self,
        policy: &AllocationPolicy,
        states: &States,
        columns: &TaskColumns,
        (count, noise): (usize, Noise<'_>),
    ) -> Proposed {
        let mut proposed = Proposed::default();
        for block in blocks(0..states.len()) {
            let (tape, length) = (&mut self.policy_tape, block.len());
            let sampling = (count, noise);
            let own = Proposals::draw(tape, policy, (states, block), &columns.policy, sampling);
            for index in 0..length * count {
                let whole = own.of_proposal(index / count, index % count);
                own.write(whole, &mut proposed.allocations);
                proposed.log_probabilities.push(own.log_probability(whole));
                proposed.entropies.push(entropy_of(&own, whole));
            }
        }
        proposed
    }

    /// The values of `allocations [states, K, A]`, before PopArt's head.
    pub(crate) fn value(
        &mut self,
        critic: &AllocationCritic,
        states: &States,
        columns: &TaskColumns,
        allocations: &[u8],
    ) -> Vec<f32> {
        let Self { critic_tape, input, .. } = self;
        let per_state = allocations.len() / states.len().max(1);
        let mut values = Vec::new();
        for block in blocks(0..states.len()) {
            let own = block.map(|state| (state, &allocations[state * per_state..][..per_state]));
            let columns = (states, &*columns.critic);
            let (t, own) = critic.value(critic_tape, input, columns, own);
            values.extend_from_slice(t.values(own));
        }
        values
    }
}

/// The entropy of one allocation's choices, summed over its agents.
fn entropy_of(proposals: &Proposals<'_>, whole: u32) -> f32 {
    let parents = proposals.tree.way_back(whole).map(|prefix| prefix.parent as usize);
    let prefix = |parent: usize| &proposals.tree.prefixes[parent];
    parents.map(|parent| entropy(proposals.log_probabilities(prefix(parent)))).sum()
}

const AGENTS: usize = 3;
const ENTITIES: usize = 8;
const TASKS: usize = 3;
/// With one spare task column.
const SHAPE: AllocationShape = AllocationShape { features: 4, columns: 4, width: 12, heads: 3 };
const STATES: usize = 13;

/// States with absent entities, closed subtasks, and subtasks of none, one and several entities.
fn some_windows() -> Windows {
    let mut random = generator(5, Purpose::Rollout, 0);
    let mut windows = Windows::new(WindowShape {
        windows: STATES,
        steps: 1,
        agents: AGENTS,
        entities: ENTITIES,
        tasks: TASKS,
        actions: 1,
        features: SHAPE.features,
        targets: Targets::NONE,
    });
    windows.features.clear();
    for index in 0..STATES {
        for row in self::random(index as u64, ENTITIES * SHAPE.features).chunks(SHAPE.features) {
            windows.features.push_dense(row);
        }
        let task = |random: &mut Generator| match below(random, TASKS + 1) {
            TASKS => NO_TASK,
            task => task as u8,
        };
        let present = &mut windows.present[index * ENTITIES..][..ENTITIES];
        present.fill_with(|| chance(&mut random, 0.8));
        windows.entity_task[index * ENTITIES..][..ENTITIES].fill_with(|| task(&mut random));
        windows.last_allocation[index * AGENTS..][..AGENTS].fill_with(|| task(&mut random));
        // In one state nobody can be allocated at all.
        let open = &mut windows.open[index * TASKS..][..TASKS];
        open.fill_with(|| chance(&mut random, 0.8) && index != 3);
    }
    windows
}

/// Some of these states.
fn states_of(range: Range<usize>) -> States {
    let (windows, mut states) = (some_windows(), States::new(AGENTS, ENTITIES, TASKS));
    for state in range {
        states.push(&windows, state, &windows.last_allocation[state * AGENTS..][..AGENTS]);
    }
    states
}

fn some_states() -> States {
    states_of(0..STATES)
}

fn one_state(state: usize) -> States {
    states_of(state..state + 1)
}

/// Every allocation of present agents to open subtasks.
fn all_allocations(states: &States, state: usize) -> Vec<u8> {
    let open: Vec<u8> = (0..TASKS as u8).filter(|t| states.open(state)[usize::from(*t)]).collect();
    let mut all = vec![vec![]];
    for agent in 0..AGENTS {
        let possible = if states.present(state)[agent] { open.as_slice() } else { &[NO_TASK] };
        let longer = |allocation: &Vec<u8>| {
            possible
                .iter()
                .map(|task| [allocation.as_slice(), &[*task]].concat())
                .collect::<Vec<_>>()
        };
        all = all.iter().flat_map(longer).collect();
    }
    all.concat()
}

fn columns() -> TaskColumns {
    TaskColumns { policy: vec![3, 0, 1], critic: vec![2, 3, 0] }
}

#[test]
fn probabilities_of_all_allocations_sum_to_one() {
    let states = some_states();
    let policy = AllocationPolicy::initialise(SHAPE, &mut generator(1, Purpose::Weights, 0));
    let mut decider = Decider::default();
    for state in (0..STATES).filter(|state| states.open(*state).contains(&true)) {
        let all = all_allocations(&states, state);
        let one = one_state(state);
        let sampling = (all.len() / AGENTS, Noise::Given(&all));
        let proposed = decider.propose(&policy, &one, &columns(), sampling);
        assert_eq!(proposed.allocations, all);
        let sum: f64 = proposed.log_probabilities.iter().map(|log| f64::from(*log).exp()).sum();
        assert!((sum - 1.0).abs() < 1e-5, "state {state}: {sum}");
    }
}

#[test]
fn the_best_proposal_has_the_highest_value_behind_the_head() {
    let states = some_states();
    let policy = AllocationPolicy::initialise(SHAPE, &mut generator(1, Purpose::Weights, 0));
    let start = AllocationCritic::initialise(SHAPE, &mut generator(2, Purpose::Weights, 0));
    let critic = |head: f32| {
        let mut critic = start.clone();
        critic.parameters.values[critic.layers.head_range()].copy_from_slice(&[head, 0.3]);
        critic.popart.variance = 4.0;
        critic
    };
    let mut chosen = Vec::new();
    for head in [1.5, -1.5, 0.0] {
        let critic = critic(head);
        let networks = AllocationNetworks { policy: &policy, critic: &critic };
        let sampling = (16, Noise::Seeded { seed: 3, greedy_first: true });
        let mut decider = Decider::default();
        let proposed = decider.propose(&policy, &states, &columns(), sampling).allocations;
        let raw = decider.value(&critic, &states, &columns(), &proposed);
        let best = decider.decide(networks, &states, &columns(), sampling).best;
        for ((best, proposed), raw) in
            best.chunks(AGENTS).zip(proposed.chunks(16 * AGENTS)).zip(raw.chunks(16))
        {
            let values: Vec<f64> = raw.iter().map(|raw| critic.real(*raw)).collect();
            let highest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let first = values.iter().position(|value| highest - value < 1e-6).unwrap();
            assert_eq!(best, &proposed[first * AGENTS..][..AGENTS], "head {head}: {values:?}");
        }
        chosen.push(best);
    }
    assert_ne!(chosen[0], chosen[1]);
}

#[test]
fn choices_are_drawn_as_often_as_they_are_likely() {
    let one = one_state(1);
    let policy = AllocationPolicy::initialise(SHAPE, &mut generator(1, Purpose::Weights, 0));
    let mut decider = Decider::default();
    const DRAWS: usize = 20_000;
    let noise = Noise::Seeded { seed: 3, greedy_first: true };
    let drawn = decider.propose(&policy, &one, &columns(), (DRAWS, noise));
    let mut seen = std::collections::BTreeMap::new();
    let each = drawn.allocations.chunks(AGENTS).zip(&drawn.log_probabilities);
    for (allocation, log) in each.clone() {
        seen.entry(allocation).or_insert((0, *log)).0 += 1;
    }
    assert!(seen.len() > 3, "one possible choice proves nothing");
    for (allocation, (count, log)) in &seen {
        let (share, want) = (f64::from(*count) / DRAWS as f64, f64::from(*log).exp());
        assert!((share - want).abs() < 0.02, "{allocation:?}: {share} against {want}");
    }
    // Without noise the first proposal takes what is likeliest for the first agent.
    let first = drawn.allocations[0];
    let likely =
        |task: u8| seen.iter().filter(|(a, _)| a[0] == task).map(|(_, s)| s.0).sum::<i32>();
    assert!((0..TASKS as u8).all(|task| likely(task) <= likely(first)), "{seen:?}");
}

#[test]
fn states_do_not_see_each_other() {
    let states = some_states();
    let mut level = generator(1, Purpose::Weights, 0);
    let policy = AllocationPolicy::initialise(SHAPE, &mut level);
    let critic = AllocationCritic::initialise(SHAPE, &mut level);
    let mut decider = Decider::default();
    let noise = random(9, STATES * 4 * AGENTS * TASKS);
    let together = decider.propose(&policy, &states, &columns(), (4, Noise::Gumbel(&noise)));
    let values = decider.value(&critic, &states, &columns(), &together.allocations);
    for state in 0..STATES {
        let one = one_state(state);
        let own = Noise::Gumbel(&noise[state * 4 * AGENTS * TASKS..][..4 * AGENTS * TASKS]);
        let alone = decider.propose(&policy, &one, &columns(), (4, own));
        assert_eq!(alone.allocations, together.allocations[state * 4 * AGENTS..][..4 * AGENTS]);
        let alone = decider.value(&critic, &one, &columns(), &alone.allocations);
        for (alone, together) in alone.iter().zip(&values[state * 4..]) {
            assert!((alone - together).abs() < 1e-5, "{alone} against {together}");
        }
    }
}

/// Checks the gradient of every tensor on its own.
fn assert_gradients(
    tensors: &[Tensor],
    parameters: &[f32],
    gradient: &[f32],
    loss: impl Fn(&[f32]) -> f64,
) {
    for Tensor { name, range, .. } in tensors {
        assert_gradient(name, &parameters[range.clone()], &gradient[range.clone()], |part| {
            let mut moved = parameters.to_vec();
            moved[range.clone()].copy_from_slice(part);
            loss(&moved)
        });
    }
}

#[test]
fn the_policy_s_gradient_agrees_with_finite_differences() {
    let states = some_states();
    let mut policy = AllocationPolicy::initialise(SHAPE, &mut generator(2, Purpose::Weights, 0));
    // Larger weights than usual: slopes well above the rounding of the loss.
    policy.parameters.values.iter_mut().for_each(|weight| *weight *= 2.0);
    const PROPOSALS: usize = 6;
    let mut decider = Decider::default();
    let noise = Noise::Seeded { seed: 1, greedy_first: false };
    let drawn = decider.propose(&policy, &states, &columns(), (PROPOSALS, noise));
    let fixed = (PROPOSALS, Noise::Given(&drawn.allocations));
    let weights = random(4, STATES);
    const ENTROPY: f32 = 0.3;
    let loss = |parameters: &[f32]| {
        let mut policy = policy.clone();
        policy.parameters.values.copy_from_slice(parameters);
        let got = Decider::default().propose(&policy, &states, &columns(), fixed);
        let surprise = got.log_probabilities.chunks(PROPOSALS).zip(&weights);
        let surprise = surprise.map(|(logs, weight)| -f64::from(weight * logs[1])).sum::<f64>();
        let entropy = got.entropies.iter().map(|entropy| f64::from(*entropy)).sum::<f64>();
        surprise - f64::from(ENTROPY) * entropy
    };
    let (mut tape, block) = (Tape::default(), (&states, 0..STATES));
    let mut pass = Proposals::draw(&mut tape, &policy, block, &columns().policy, fixed);
    let best: Vec<(u32, f32)> = (0..STATES).map(|s| (pass.of_proposal(s, 1), weights[s])).collect();
    let mut gradient = vec![0.0; policy.parameters.values.len()];
    pass.descend(&best, ENTROPY, &mut gradient);

    let mut tensors = policy.parameters.tensors().to_vec();
    // What is the same for all choices of an agent changes none: the bias of the counts has no slope of its own.
    let bias = tensors.iter().position(|tensor| tensor.name == "count.bias").unwrap();
    tensors[bias - 1].range.end = tensors.remove(bias).range.end;
    assert_gradients(&tensors, &policy.parameters.values, &gradient, loss);
}

#[test]
fn the_critic_s_gradient_agrees_with_finite_differences() {
    let states = some_states();
    let critic = AllocationCritic::initialise(SHAPE, &mut generator(3, Purpose::Weights, 0));
    let mut input = CriticInput::default();
    for state in 0..STATES {
        input.begin_state(&states);
        let columns = columns().critic;
        let shown = Shown { shape: SHAPE, states: &states, columns: &columns };
        // Two allocations of a state share rows.
        for allocation in [states.allocation(state), states.last_allocation(state)] {
            input.push(shown, state, allocation);
        }
    }
    let slopes = random(7, 2 * STATES);
    let loss = |parameters: &[f32]| {
        let mut tape = Tape::default();
        let mut t = tape.begin(parameters);
        let values = critic.layers.values(&mut t, &input);
        let values = critic.layers.head(&mut t, values);
        let terms = t.values(values).iter().zip(&slopes);
        terms.map(|(value, d)| f64::from(*value) * f64::from(*d)).sum()
    };
    let mut tape = Tape::default();
    let mut t = tape.begin(&critic.parameters.values);
    let values = critic.layers.values(&mut t, &input);
    let values = critic.layers.head(&mut t, values);
    let sum = t.weighted_sum(values, &slopes);
    let mut gradient = vec![0.0; critic.parameters.values.len()];
    t.backward(sum, &mut gradient);

    let Parameters { values, .. } = &critic.parameters;
    assert_gradients(critic.parameters.tensors(), values, &gradient, loss);
}

/// Windows of episodes of one decision, allocated at random: an agent is worth 1 at the subtask of its kind.
fn matching(random: &mut Generator, episodes: usize) -> Windows {
    let mut windows = Windows::new(WindowShape {
        windows: 1,
        steps: 2 * episodes,
        agents: 2,
        entities: 5,
        tasks: 3,
        actions: 1,
        features: 4,
        targets: Targets::NONE,
    });
    windows.features.clear();
    windows.present.fill(true);
    windows.open.fill(true);
    for episode in 0..episodes {
        // Each episode is its decision and the final observation.
        for state in [2 * episode, 2 * episode + 1] {
            let tasks = [below(random, 3) as u8, below(random, 3) as u8, 0, 1, 2];
            let agents = [below(random, 3) as u8, below(random, 3) as u8];
            for (entity, kind) in agents.into_iter().chain(0..3).enumerate() {
                windows.features.push(usize::from(kind), 1.0);
                windows.features.push(3, if entity < 2 { 1.0 } else { -1.0 });
                windows.features.end_row();
            }
            windows.entity_task[state * 5..][..5].copy_from_slice(&tasks);
            let matched = (0..2).filter(|a| tasks[*a] == agents[*a]).count();
            let decision = state % 2 == 0;
            windows.decision[state] = decision;
            windows.has_transition[state] = decision;
            windows.terminated[state] = decision;
            windows.reset[state] = decision;
            windows.reward[state] = if decision { matched as f32 } else { 0.0 };
        }
    }
    windows
}

#[test]
fn agents_learn_to_go_where_they_belong() {
    let shape = AllocationShape { features: 4, columns: 3, width: 16, heads: 2 };
    let sizes = matching(&mut generator(2, Purpose::Rollout, 0), 1).shape;
    let usual = AllocationLearning::of(&Config::default(), sizes);
    let config = AllocationConfig {
        proposals: 8,
        interval: 1,
        rows: 100,
        oldest: 1_000_000,
        ..usual.config.clone()
    };
    let learning = AllocationLearning { shape, config, learning_rate: 5e-3, ..usual };
    let mut level = AllocationLevel::new(learning, 1);
    let mut random = generator(1, Purpose::Rollout, 0);
    let mut surprise = Vec::new();
    for step in 0..150 {
        let windows = matching(&mut random, 60);
        let seed = random.next_u64();
        let draws = StepDraws {
            proposals: TaskColumns::in_order(3),
            stored: vec![0, 1, 2],
            target: vec![0, 1, 2],
            noise: Noise::Seeded { seed, greedy_first: false },
        };
        let report = level.learn_with(&windows, 0, &draws, 2).expect("rows");
        surprise.push(report.policy_loss);
        if step % 20 == 0 {
            level.copy_target();
        }
    }
    assert!(surprise[149] < 0.5 * surprise[0], "the policy proposes what is best: {surprise:?}");
    let last = &level.last;
    let (mut best, mut rows) = (0, 0);
    for row in 0..last.rows.len() {
        let kind = |entity: usize| last.rows.states.features.row(row * 5 + entity).next();
        for agent in 0..2 {
            let task = usize::from(last.best[row * 2 + agent]);
            best += usize::from(kind(2 + task) == kind(agent));
            rows += 1;
        }
    }
    assert!(best * 10 >= rows * 9, "{best} of {rows} agents are where they belong");
}
