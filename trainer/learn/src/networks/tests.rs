use std::collections::BTreeMap;

use sortie_envs::random::generator;
use sortie_envs::{EntitySet, Observation, members};
use sortie_nn::gradient_check::{assert_gradient, random};
use sortie_nn::random::stream;
use sortie_nn::tape::{Parameters, Pass, Tape, Tensor, Var};

use super::*;

const LOOKING: LookShape = LookShape { input: 9, active_inputs: 3, width: 16, heads: 4 };
const KINDS: [MixerKind; 3] = [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix];

/// What is there in each of three states of three agents and two others, and what agents observe of it:
/// one agent of the second and one other of the third are absent, and nobody sees everything.
const PRESENT: [EntitySet; 3] = [0b11111, 0b11011, 0b01111];
const OBSERVABLE: [EntitySet; 3] = [0b11111, 0b01111, 0b10101];
/// Agents of all states.
const AGENTS: usize = 8;

/// The states with what each agent sees of what it could observe. All show the same first entity.
fn states(sees: impl Fn(usize) -> EntitySet) -> Vec<Observation> {
    let state = |(index, present): (usize, EntitySet)| {
        let mut seen = Observation { present, entities: present, ..Observation::default() };
        let first = random(1, 9);
        let numbers = random(10 + index as u64, 5 * 9);
        seen.rows.push_dense(&first);
        for row in numbers.chunks(9).take(present.count_ones() as usize - 1) {
            seen.rows.push_dense(row);
        }
        seen.observable = (0..3).map(|agent| OBSERVABLE[agent] & sees(agent)).collect();
        seen.available = vec![0b1111, 0b1101, 0b0110];
        seen
    };
    PRESENT.into_iter().enumerate().map(state).collect()
}

/// The entities in the part of an agent.
fn part(agent: usize) -> EntitySet {
    if agent == 1 { 0b10010 } else { 0b01101 }
}

/// The states as one episode, or each as one of its own.
fn batch(shares: bool, is_episode: bool) -> EntityBatch {
    let mut batch = EntityBatch::default();
    batch.share_rows(shares);
    batch.aim_at(TARGETS.entities(), RELATED.pairs());
    for (index, seen) in states(|_| EntitySet::MAX).iter().enumerate() {
        let [step, episode] = if is_episode { [index, 0] } else { [0, index] };
        batch.push_at(Moment { step, episode }, seen, part);
    }
    batch.finish(true);
    batch
}

/// Two agents and two others.
const TARGETS: Targets = Targets { first: 1, count: 4, first_pair: 0, pair_features: 0 };

/// The same, and that behind its first column a row has two features of each pair.
const RELATED: Targets = Targets { first_pair: 1, pair_features: 2, ..TARGETS };

fn agents(skip: bool, memory: usize) -> (EntityAgent, Parameters) {
    aiming(AgentShape { looking: LOOKING, actions: 4, skip, memory, targets: Targets::default() })
}

fn aiming(shape: AgentShape) -> (EntityAgent, Parameters) {
    let mut parameters = Parameters::default();
    (EntityAgent::new(&mut parameters, shape, &mut stream(3, 1, 0)), parameters)
}

fn mixer(shape: MixerShape) -> (Mixer, Parameters) {
    let mut parameters = Parameters::default();
    (Mixer::new(&mut parameters, shape, &mut stream(4, 1, 0)), parameters)
}

fn mixer_shape(kind: MixerKind) -> MixerShape {
    let (hypernetworks, weights_sum) = (Hypernetworks::Shared, WeightsSum::One);
    MixerShape { kind, hypernetworks, weights_sum, looking: LOOKING, mixing: 4 }
}

/// What agents make of a batch.
fn utilities(agents: &(EntityAgent, Parameters), batch: &EntityBatch, in_parts: bool) -> Vec<f32> {
    let mut tape = Tape::default();
    let mut pass = tape.begin(&agents.1.values);
    let view = if in_parts { batch.seen() } else { batch.seen().whole() };
    let memory = &mut vec![0.0; batch.slots(view) * agents.0.shape.memory];
    let utilities = agents.0.utilities(&mut pass, batch, view, memory);
    pass.values(utilities).to_vec()
}

fn assert_near(got: &[f32], want: &[f32]) {
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(want) {
        assert!((got - want).abs() < 1e-5, "{got} against {want}");
    }
}

/// A loss of every number that `network` computes has the slopes that the tape finds, tensor by tensor.
fn check(name: &str, parameters: &Parameters, network: impl Fn(&mut Pass<'_>) -> Var) {
    let loss = |weights: &[f32], gradient: Option<&mut [f32]>| {
        let mut tape = Tape::default();
        let mut pass = tape.begin(weights);
        let y = network(&mut pass);
        let targets = random(77, pass.values(y).len());
        let loss = pass.squared_error(y, &targets, 1.0);
        gradient.into_iter().for_each(|gradient| pass.backward(loss, gradient));
        pass.values(y).iter().zip(&targets).map(|(y, t)| f64::from(y - t).powi(2)).sum::<f64>()
    };
    let mut gradient = vec![0.0; parameters.values.len()];
    loss(&parameters.values, Some(&mut gradient));
    // A softmax does not change with what is added to all of its scores.
    let matters = |tensor: &&Tensor| tensor.name != "mixer.weights.project.bias";
    for tensor in parameters.tensors().iter().filter(matters) {
        let (name, own) = (format!("{} of {name}", tensor.name), tensor.range.clone());
        assert_gradient(&name, &parameters.values[own.clone()], &gradient[own.clone()], |part| {
            let mut weights = parameters.values.clone();
            weights[own.clone()].copy_from_slice(part);
            loss(&weights, None)
        });
    }
}

#[test]
fn gradients_of_agents_agree_with_finite_differences() {
    let none = Targets::default();
    for (skip, memory, shares, targets) in [
        (false, 0, false, none),
        (true, 0, true, none),
        (true, 6, false, none),
        (true, 0, true, TARGETS),
        (false, 6, false, TARGETS),
        (true, 0, true, RELATED),
        (false, 6, false, RELATED),
    ] {
        let actions = 4 + targets.count;
        let shape = AgentShape { looking: LOOKING, actions, skip, memory, targets };
        let (agents, parameters) = aiming(shape);
        let batch = batch(shares, true);
        for view in [batch.seen(), batch.seen().whole()] {
            check(&format!("{skip} {memory} {shares}"), &parameters, |pass| {
                let memory = &mut vec![0.0; batch.slots(view) * memory];
                agents.utilities(pass, &batch, view, memory)
            });
        }
    }
}

#[test]
fn gradients_of_mixers_agree_with_finite_differences() {
    for kind in [MixerKind::Linear, MixerKind::Qmix] {
        for hypernetworks in [Hypernetworks::Shared, Hypernetworks::Separate] {
            let shape = MixerShape { hypernetworks, ..mixer_shape(kind) };
            let (mixer, mut parameters) = mixer(shape);
            let batch = batch(false, false);
            parameters.values.iter_mut().for_each(|weight| *weight *= 2.0);
            check(&format!("{shape:?}"), &parameters, |pass| {
                // Far apart, so that what they are weighted by matters more than rounding.
                let chosen: Vec<f32> = random(5, 3 * AGENTS).iter().map(|x| 4.0 * x).collect();
                let chosen = pass.input(1, &chosen);
                let mixed = mixer.mix(pass, batch.teams(), chosen);
                pass.stack(&[mixed.real, mixed.imagined.unwrap()])
            });
        }
    }
}

#[test]
fn rows_that_are_shared_and_views_of_parts_change_nothing() {
    let agents = agents(true, 0);
    let (apart, shared) = (batch(false, true), batch(true, true));
    assert_eq!((apart.seen().own.len(), shared.seen().own.len()), (0, AGENTS));
    assert!(shared.seen().rows.len() < apart.seen().rows.len());
    let want = utilities(&agents, &apart, true);
    assert_near(&utilities(&agents, &shared, true), &want);
    assert_near(&utilities(&agents, &shared, false), &want[..AGENTS * 4]);
}

#[test]
fn imagined_utilities_are_those_of_agents_that_see_their_part_only() {
    let agents = agents(true, 0);
    let all = utilities(&agents, &batch(false, false), true);
    // Each part as if nothing else were seen.
    for (block, across) in [(1, false), (2, true)] {
        let mut batch = EntityBatch::default();
        let part = |agent: usize| if across { !part(agent) } else { part(agent) };
        states(part).iter().for_each(|seen| batch.push(seen));
        batch.finish(false);
        let own = &all[block * AGENTS * 4..][..AGENTS * 4];
        assert_near(own, &utilities(&agents, &batch, false));
    }
}

/// An action aims at an entity, whatever its number and whatever else is imagined; at one that is not seen it is worth nothing.
#[test]
fn aimed_actions_are_worth_what_their_targets_are() {
    let shape =
        AgentShape { looking: LOOKING, actions: 6, skip: true, memory: 0, targets: TARGETS };
    let (agents, parameters) = aiming(shape);
    let agents = (agents, parameters);
    let of = |batch: &EntityBatch, in_parts: bool| utilities(&agents, batch, in_parts);
    let whole = of(&batch(false, true), false);
    assert_near(&of(&batch(true, true), false), &whole);
    assert_near(&of(&batch(false, true), true)[..AGENTS * 6], &whole);
    // Entities 3 and 4 trade places.
    let mut traded = EntityBatch::default();
    traded.aim_at([1, 2, 4, 3].into_iter(), 0..0);
    states(|_| EntitySet::MAX).iter().for_each(|seen| traded.push(seen));
    traded.finish(false);
    let traded = of(&traded, false);
    let mut queries = 0;
    for present in PRESENT {
        for agent in members(present & 0b111) {
            let own = queries * 6..(queries + 1) * 6;
            let (own, other) = (&whole[own.clone()], &traded[own]);
            assert_near(
                &[other[0], other[2], other[3], other[5], other[4]],
                &[own[0], own[2], own[3], own[4], own[5]],
            );
            let seen = OBSERVABLE[agent] & present;
            for (utility, target) in own[2..].iter().zip(TARGETS.entities()) {
                assert_eq!(*utility != 0.0, seen >> target & 1 == 1, "{agent} at {target}");
            }
            // Targets that look different are worth different things.
            let mut worth: Vec<u32> = own[2..].iter().map(|utility| utility.to_bits()).collect();
            worth.retain(|bits| *bits != 0);
            worth.sort_unstable();
            worth.dedup();
            assert_eq!(worth.len(), (seen >> 1).count_ones() as usize, "{own:?}");
            queries += 1;
        }
    }
    assert_eq!(queries, AGENTS);
}

/// What is known of a pair counts as much as the agent's vector says, here the same for all agents: 1 and 10.
#[test]
fn features_of_pairs_add_to_what_targets_are_worth() {
    let shape =
        AgentShape { looking: LOOKING, actions: 6, skip: true, memory: 0, targets: RELATED };
    let (agents, mut parameters) = aiming(shape);
    let mut of_pairs = |name: &str, weights: [f32; 2]| {
        let range = parameters.tensors().iter().find(|it| it.name == name).unwrap().range.clone();
        let outputs = &mut parameters.values[range];
        let width = outputs.len() / 18;
        for (output, weight) in outputs.chunks_mut(width).skip(16).zip(weights) {
            output.fill(weight);
        }
        parameters.clone()
    };
    of_pairs("agent.pointing.weight", [0.0; 2]);
    let without = (agents, of_pairs("agent.pointing.bias", [0.0; 2]));
    let with = (agents, of_pairs("agent.pointing.bias", [1.0, 10.0]));
    // Deployed weights are scaled as these products are, by about one over the root of the width, which is 16.
    let scale = agents.deployed(&with.1.values).0.pointing.unwrap().scale;
    assert_eq!(scale, 0.25);
    let mut want = Vec::new();
    for seen in states(|_| EntitySet::MAX) {
        for agent in members(seen.acting().into()) {
            let mut row = [0.0; 9];
            seen.rows.write_dense(seen.row_of(agent), &mut row);
            let observed = seen.observable[agent] & seen.present;
            let worth =
                row[1..].as_chunks().0.iter().zip(TARGETS.entities()).map(|([a, b], it)| {
                    if observed >> it & 1 == 1 { scale * (a + 10.0 * b) } else { 0.0 }
                });
            want.extend([0.0; 2].into_iter().chain(worth));
        }
    }
    for (shares, in_parts) in [(false, false), (true, false), (false, true), (true, true)] {
        let batch = batch(shares, true);
        let [with, without] = [&with, &without].map(|it| utilities(it, &batch, in_parts));
        let found: Vec<f32> = with.iter().zip(without).map(|(with, it)| with - it).collect();
        assert_eq!(found.len(), want.len() * if in_parts { BLOCKS } else { 1 });
        found.chunks(want.len()).for_each(|block| assert_near(block, &want));
    }
}

/// Agents that go through an episode at once remember what those do that go step by step.
#[test]
fn agents_remember_from_step_to_step_and_begin_with_nothing() {
    let agents = agents(true, 6);
    let whole = utilities(&agents, &batch(true, true), false);
    let (mut memory, mut apart) = (vec![0.0; 3 * 6], Vec::new());
    for seen in states(|_| EntitySet::MAX) {
        let mut batch = EntityBatch::default();
        batch.push(&seen);
        batch.finish(false);
        let mut tape = Tape::default();
        let mut pass = tape.begin(&agents.1.values);
        let found = agents.0.utilities(&mut pass, &batch, batch.seen(), &mut memory);
        apart.extend_from_slice(pass.values(found));
    }
    assert_near(&whole, &apart);
}

#[test]
fn a_better_utility_never_makes_a_team_worse() {
    for kind in KINDS {
        let (mixer, weights) = mixer(mixer_shape(kind));
        let (batch, mut tape) = (batch(false, false), Tape::default());
        let mut pass = tape.begin(&weights.values);
        let chosen = pass.leaf(1, &random(5, 3 * AGENTS));
        let mixed = mixer.mix(&mut pass, batch.teams(), chosen);
        let both = [mixed.real, mixed.imagined.unwrap()].map(|values| pass.sum_rows(values));
        let sum = pass.add(both[0], both[1]);
        pass.backward(sum, &mut vec![0.0; weights.values.len()]);
        let slopes = pass.slopes(chosen).unwrap();
        assert!(slopes.iter().all(|slope| *slope > 0.0), "{kind:?} {slopes:?}");
    }
}

/// Weights of a linear mixer add up to what they are set to, over real and over imagined utilities; those of a sum do to the
/// number of utilities. What a state is worth beside them is the same whatever they add up to.
#[test]
fn weights_add_up_to_one_or_to_the_number_of_agents() {
    let linear = mixer_shape(MixerKind::Linear);
    let agents = MixerShape { weights_sum: WeightsSum::Agents, ..linear };
    let sizes = [3.0, 2.0, 3.0];
    let mut states = Vec::new();
    for (shape, real, imagined) in [
        (linear, [1.0; 3], [1.0; 3]),
        (agents, sizes, sizes),
        (mixer_shape(MixerKind::Sum), sizes, sizes.map(|size| 2.0 * size)),
    ] {
        let (mixer, weights) = mixer(shape);
        let (batch, mut tape) = (batch(false, false), Tape::default());
        let mut mix = |utility: f32| {
            let mut pass = tape.begin(&weights.values);
            let chosen = pass.input(1, &[utility; 3 * AGENTS]);
            let mixed = mixer.mix(&mut pass, batch.teams(), chosen);
            [mixed.real, mixed.imagined.unwrap()].map(|values| pass.values(values).to_vec())
        };
        let (none, one) = (mix(0.0), mix(1.0));
        for ((none, one), want) in none.iter().zip(&one).zip([real, imagined]) {
            let found: Vec<f32> = one.iter().zip(none).map(|(one, none)| one - none).collect();
            assert_near(&found, &want);
        }
        states.push(none);
    }
    assert_eq!(states[0], states[1]);
    assert!(states[0].iter().flatten().all(|value| *value != 0.0), "{states:?}");
}

/// The same state, once with an agent that does not act any more, once with its body as a thing.
#[test]
fn who_is_absent_is_a_thing_among_others() {
    let whole = &states(|_| EntitySet::MAX)[0];
    let absent = Observation { absent: 0b010, ..whole.clone() };
    let mut body = Observation { present: 0b11111, entities: 0b11111, ..Observation::default() };
    let order = [0, 2, 1, 3, 4];
    order.into_iter().for_each(|entity| {
        body.rows.push_row(&whole.rows, entity);
        body.rows.end_row();
    });
    let renamed = |set: EntitySet| {
        let new = |entity: usize| order.iter().position(|old| *old == entity).unwrap();
        members(set).fold(0, |all, entity| all | 1 << new(entity))
    };
    body.observable = [0, 2].map(|agent| renamed(whole.observable[agent])).to_vec();
    body.available = [0, 2].map(|agent| whole.available[agent]).to_vec();
    let batch = |seen: &Observation| {
        let mut batch = EntityBatch::default();
        batch.push(seen);
        batch.finish(false);
        batch
    };
    let (one, other) = (batch(&absent), batch(&body));
    assert_eq!((one.agents(), one.sizes(), one.available()), (2, &[2][..], other.available()));
    let agents = agents(true, 0);
    let values = utilities(&agents, &one, false);
    assert_near(&values, &utilities(&agents, &other, false));
    // Its body is seen: without it the others' utilities are other ones.
    let unseen = Observation {
        observable: whole.observable.iter().map(|set| set & !0b010).collect(),
        ..absent.clone()
    };
    assert_ne!(values, utilities(&agents, &batch(&unseen), false));
    for kind in KINDS {
        let (mixer, weights) = mixer(mixer_shape(kind));
        let mix = |batch: &EntityBatch| {
            let mut tape = Tape::default();
            let mut pass = tape.begin(&weights.values);
            let chosen = pass.input(1, &[0.5, -2.0]);
            let mixed = mixer.mix(&mut pass, batch.teams(), chosen).real;
            pass.values(mixed).to_vec()
        };
        assert_near(&mix(&one), &mix(&other));
    }
}

/// What three agents with so much memory remember of each instance behind states that they saw: of every time that they acted
/// whose teams, whether the team's episode began, and the state's number.
fn remembered(times: &[&[(usize, bool, usize)]]) -> BTreeMap<usize, Vec<f32>> {
    let (agents, weights) = agents(true, 6);
    let states = states(|_| EntitySet::MAX);
    let mut acting = Acting::default();
    for teams in times {
        acting.clear();
        for (instance, begins, state) in *teams {
            acting.push(*instance, *begins, &states[*state]);
        }
        acting.choose(&agents, &weights.values, &mut [0; 6]);
    }
    acting.memories
}

#[test]
fn who_acts_remembers_its_own_episode_and_nothing_of_the_one_before() {
    let once = remembered(&[&[(0, true, 0)]]);
    assert!(once[&0].iter().all(|number| *number != 0.0));
    let twice = remembered(&[&[(0, true, 0)], &[(0, false, 2)]]);
    assert_ne!(twice[&0], remembered(&[&[(0, true, 2)]])[&0]);
    let anew = remembered(&[&[(0, true, 2)], &[(0, false, 1)], &[(0, true, 0)]]);
    assert_eq!(anew[&0], once[&0]);
    // Whoever is absent remembers nothing.
    let absent = remembered(&[&[(0, true, 0)], &[(0, false, 1)]]);
    assert_eq!(absent[&0][2 * 6..], [0.0; 6]);
    assert!(absent[&0][..2 * 6].iter().all(|number| *number != 0.0));
    // Teams act side by side, in any order.
    let both = remembered(&[&[(5, true, 2), (0, true, 0)], &[(0, false, 2), (5, false, 0)]]);
    let other = remembered(&[&[(0, true, 2)], &[(0, false, 0)]]);
    for (both, alone) in [(&both[&0], &twice[&0]), (&both[&5], &other[&0])] {
        for (both, alone) in both.iter().zip(alone) {
            assert!((both - alone).abs() < 1e-6, "{both} {alone}");
        }
    }
}

/// Actions are those of the agents that act, also where one before them does not.
#[test]
fn who_is_absent_does_what_is_left_to_it() {
    let (agents, parameters) = agents(true, 0);
    let whole = &states(|_| EntitySet::MAX)[0];
    let chosen = |seen: &Observation| {
        let (mut acting, mut actions) = (Acting::default(), [9; 3]);
        acting.push(0, true, seen);
        acting.choose(&agents, &parameters.values, &mut actions);
        actions
    };
    let everybody = chosen(whole);
    for agent in 0..3 {
        let mut seen = Observation { absent: 1 << agent, ..whole.clone() };
        seen.available[agent] = 0b1000;
        let mut want = everybody;
        want[agent] = 3;
        assert_eq!(chosen(&seen), want, "{agent}");
    }
}

#[test]
fn the_best_available_action_is_the_first_of_equals() {
    assert_eq!(best(&[1.0, 3.0, 3.0, 9.0], 0b0111), 1);
    assert_eq!(best(&[1.0, f32::NAN], 0b10), 1);
}

#[test]
fn actions_are_drawn_by_their_chances() {
    for (number, action) in [(0.0, 1), (0.24, 1), (0.26, 2), (0.99, 2), (1.0, 2)] {
        assert_eq!(drawn(&[0.0, 0.25, 0.75, 0.0], number), action, "{number}");
    }
}

#[test]
fn actions_are_drawn_by_their_chances_among_those_that_are_available() {
    let (scores, mut random, mut drawn) = ([0.0, 9.0, 1.0, -1.0], generator(1), [0; 4]);
    for _ in 0..20_000 {
        drawn[draw(&scores, 0b1101, &mut random)] += 1;
    }
    let powers = [1.0, 0.0, 1_f64.exp(), (-1_f64).exp()];
    for (count, power) in drawn.into_iter().zip(powers) {
        let chance = power / powers.iter().sum::<f64>();
        assert!((f64::from(count) / 20_000.0 - chance).abs() < 0.015, "{drawn:?}");
    }
    assert_eq!(drawn[1], 0);
}
