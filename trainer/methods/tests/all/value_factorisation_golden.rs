//! Value factorisation against the reference's modules, on recorded inputs (`tests/golden`).

use sortie_envs::{EntitySet, Observation, members};
use sortie_learn::learner::Shard;
use sortie_learn::networks::{
    AgentShape, EntityAgent, EntityBatch, Hypernetworks, LookShape, MixerKind, MixerShape, Moment,
    Targets, WeightsSum,
};
use sortie_methods::value_factorisation::{Lesson, NetworkShape, Networks, Partitions};
use sortie_nn::optimise::RmsProp;
use sortie_nn::random::stream;
use sortie_nn::tape::{Parameters, Tape};

use crate::files::{Case, json_cases, safetensors_case};

/// The entities that a row of a mask leaves open.
fn open(mask: &[f64]) -> EntitySet {
    mask.iter().enumerate().map(|(at, masked)| EntitySet::from(*masked == 0.0) << at).sum()
}

/// Rows of a tensor.
fn rows<'a>(case: &'a Case, name: &str, width: usize) -> Vec<&'a [f64]> {
    case.get(name).data.chunks(width).collect()
}

#[test]
fn imagined_masks_are_the_recorded_ones() {
    for case in json_cases("imagined_masks") {
        let (observed, present) = (rows(&case, "in/obs_mask", 6), rows(&case, "in/entity_mask", 6));
        for (trajectory, part) in rows(&case, "in/partition_groupA", 6).into_iter().enumerate() {
            let part = !open(part);
            for step in 0..3 {
                let state = 3 * trajectory + step;
                // As recorded, who is there at first counts.
                let there = open(present[3 * trajectory]);
                for entity in (0..6).filter(|entity| there >> entity & 1 == 1) {
                    let within = Partitions::Drawn.within(part, 0, entity) & there;
                    let at = 6 * state + entity;
                    let seen = open(observed[at]);
                    let want = |name: &str| open(rows(&case, name, 6)[at]);
                    let name = format!("{}, state {state}, entity {entity}", case.name);
                    assert_eq!(seen & within, want("out/within_obs_mask"), "{name}");
                    assert_eq!(seen & !within, want("out/interact_obs_mask"), "{name}");
                    assert_eq!(there & within, want("out/within_mixer_mask"), "{name}");
                    assert_eq!(there & !within, want("out/interact_mixer_mask"), "{name}");
                }
            }
        }
    }
}

/// With a head that hands on what stands before it, utilities are what the recorded network has behind
/// its attention, rectified.
#[test]
fn agents_look_as_the_recorded_ones_do() {
    for case in json_cases("agent_ff_none") {
        let (input, width) = (9, 16);
        let looking = LookShape { input, active_inputs: 9, width, heads: 4 };
        let shape = AgentShape {
            looking,
            actions: width,
            skip: false,
            memory: 0,
            targets: Targets::default(),
        };
        let weights = |name: &str| case.get(&format!("w/_base.{name}")).f32s();
        let fc1 = weights("fc1.weight");
        let mut parameters: Vec<f32> =
            (0..input * width).map(|at| fc1[at % width * input + at / width]).collect();
        parameters.extend(weights("fc1.bias"));
        parameters.extend(weights("attn.in_trans.weight"));
        parameters.extend(weights("attn.out_trans.weight"));
        parameters.extend(weights("attn.out_trans.bias"));
        let unit = |at: usize| f32::from(u8::from(at / width == at % width));
        parameters.extend((0..width * width).map(unit));
        parameters.extend([0.0; 16]);

        let mut batch = EntityBatch::default();
        let entities = case.get("in/entities").f32s();
        let (observed, absent) = (rows(&case, "in/obs_mask", 6), rows(&case, "in/entity_mask", 6));
        let mut want: Vec<f64> = Vec::new();
        for state in 0..9 {
            let present = open(absent[state]);
            let mut seen = Observation { present, entities: present, ..Observation::default() };
            for entity in (0..6).filter(|entity| present >> entity & 1 == 1) {
                seen.rows.push_dense(&entities[(6 * state + entity) * input..][..input]);
            }
            seen.observable = (0..3).map(|agent| open(observed[6 * state + agent])).collect();
            seen.available = vec![1; 3];
            batch.push(&seen);
            for agent in (0..3).filter(|agent| present >> agent & 1 == 1) {
                want.extend(rows(&case, "out/attn_out", width)[3 * state + agent]);
            }
        }
        batch.finish(false);
        let agents = EntityAgent::new(&mut Parameters::default(), shape, &mut stream(1, 1, 0));
        let mut tape = Tape::default();
        let mut pass = tape.begin(&parameters);
        let got = agents.utilities(&mut pass, &batch, batch.seen(), &mut []);
        let got = pass.values(got);
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(want) {
            let want = want.max(0.0);
            assert!((f64::from(*got) - want).abs() <= 1e-5 * (1.0 + want), "{got} and {want}");
        }
    }
}

/// Agents, entities, actions and columns of the recorded episodes, of which each has room for so many states.
const AGENTS: usize = 3;
const ENTITIES: usize = 6;
const ACTIONS: usize = 4;
const FEATURES: usize = 5;
const STATES: usize = 8;
const WIDTH: usize = 16;
const MIXING: usize = 8;

const LOOKING_SHAPE: LookShape = LookShape {
    input: FEATURES + ACTIONS,
    active_inputs: FEATURES + ACTIONS,
    width: WIDTH,
    heads: 4,
};

const SHAPE: NetworkShape = NetworkShape {
    agent: AgentShape {
        looking: LOOKING_SHAPE,
        actions: ACTIONS,
        skip: false,
        memory: 8,
        targets: Targets::NONE,
    },
    mixer: MixerShape {
        kind: MixerKind::Qmix,
        hypernetworks: Hypernetworks::Separate,
        weights_sum: WeightsSum::One,
        looking: LOOKING_SHAPE,
        mixing: MIXING,
    },
};

/// Tensors of embedding and attention, and those of an agent behind them.
const LOOKING: [&str; 3] = ["fc1.weight", "fc1.bias", "attn.in_trans.weight"];
const DECIDING: [&str; 10] = [
    "attn.out_trans.weight",
    "attn.out_trans.bias",
    "fc2.weight",
    "fc2.bias",
    "rnn.weight_ih",
    "rnn.weight_hh",
    "rnn.bias_ih",
    "rnn.bias_hh",
    "fc3.weight",
    "fc3.bias",
];
/// The hypernetworks; all but the first take means over the team.
const HYPERNETWORKS: [&str; 4] = ["hyper_w_1", "hyper_b_1", "hyper_w_final", "V"];

/// Recorded tensors one behind the other; embeddings are turned round here.
fn tensors(case: &Case, prefix: &str, names: &[&str]) -> Vec<f64> {
    let mut numbers = Vec::new();
    for name in names {
        let tensor = case.get(&format!("{prefix}.{name}"));
        if *name == "fc1.weight" {
            let [rows, columns] = tensor.shape[..] else { panic!("sizes") };
            let turned = (0..rows * columns).map(|at| at % rows * columns + at / rows);
            numbers.extend(turned.map(|at| tensor.data[at]));
        } else {
            numbers.extend(&tensor.data);
        }
    }
    numbers
}

/// What stands behind a hypernetwork's attention: two layers there, of which the second's outputs are averaged for the value
/// of a state; one here.
struct Behind<'a> {
    out: &'a [f64],
    out_bias: &'a [f64],
    /// `[outputs, WIDTH]`
    second: Vec<f64>,
    second_bias: Vec<f64>,
}

impl<'a> Behind<'a> {
    fn new(case: &'a Case, prefix: &str, averages: bool) -> Self {
        let get = |name: &str| &*case.get(&format!("{prefix}.{name}")).data;
        let (weight, bias) = (get("fc2.weight"), get("fc2.bias"));
        let mean = |numbers: &[f64], column: usize, columns: usize| {
            numbers.iter().skip(column).step_by(columns).sum::<f64>() / MIXING as f64
        };
        let (second, second_bias) = if averages {
            let weight = (0..WIDTH).map(|column| mean(weight, column, WIDTH)).collect();
            (weight, vec![mean(bias, 0, 1)])
        } else {
            (weight.to_vec(), bias.to_vec())
        };
        let (out, out_bias) = (get("attn.out_trans.weight"), get("attn.out_trans.bias"));
        Self { out, out_bias, second, second_bias }
    }

    /// Weight and bias of the one layer.
    fn merged(&self) -> (Vec<f64>, Vec<f64>) {
        let rows = || self.second.chunks(WIDTH).zip(&self.second_bias);
        let products = |row: &[f64], column: usize| -> f64 {
            row.iter().enumerate().map(|(k, number)| number * self.out[k * WIDTH + column]).sum()
        };
        let weight =
            rows().flat_map(|(row, _)| (0..WIDTH).map(move |column| products(row, column)));
        let bias = rows().map(|(row, bias)| dot(row, self.out_bias) + bias);
        (weight.collect(), bias.collect())
    }

    /// Gradients of the two layers from those of the one: in the order of the tensors `attn.out_trans` and `fc2`, weights before
    /// biases.
    fn parted(&self, weight: &[f64], bias: &[f64], averages: bool) -> [Vec<f64>; 4] {
        let (mut out, mut out_bias) = (vec![0.0; WIDTH * WIDTH], vec![0.0; WIDTH]);
        let mut second = Vec::new();
        for ((row, d_row), d_bias) in self.second.chunks(WIDTH).zip(weight.chunks(WIDTH)).zip(bias)
        {
            for k in 0..WIDTH {
                let from = &self.out[k * WIDTH..][..WIDTH];
                second.push(dot(d_row, from) + d_bias * self.out_bias[k]);
                out_bias[k] += row[k] * d_bias;
                let to = out[k * WIDTH..][..WIDTH].iter_mut();
                to.zip(d_row).for_each(|(to, d)| *to += row[k] * d);
            }
        }
        let share = |numbers: &[f64]| -> Vec<f64> {
            let each: Vec<f64> = numbers.iter().map(|number| number / MIXING as f64).collect();
            if averages { each.repeat(MIXING) } else { numbers.to_vec() }
        };
        [out, out_bias, share(&second), share(bias)]
    }
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

/// The recorded weights as this crate has them. Means over a team divide by absent agents as well there, so that of teams of
/// which this share is present what they are means of counts so much less: by the factors.
fn weights(case: &Case, prefix: &str, present: f32) -> [Vec<f32>; 2] {
    let agent = format!("{prefix}/agent");
    let mut numbers = tensors(case, &agent, &LOOKING);
    numbers.extend(tensors(case, &agent, &DECIDING));
    let mut factors = vec![1.0; numbers.len()];
    for name in HYPERNETWORKS {
        let prefix = format!("{prefix}/mixer.{name}");
        numbers.extend(tensors(case, &prefix, &LOOKING));
        factors.resize(numbers.len(), 1.0);
        let (weight, bias) = Behind::new(case, &prefix, name == "V").merged();
        numbers.extend(weight.iter().chain(&bias));
        factors.resize(numbers.len(), if name == "hyper_w_1" { 1.0 } else { present });
    }
    let weights = numbers.iter().zip(&factors).map(|(number, factor)| *number as f32 * factor);
    [weights.collect(), factors]
}

/// The actions that a row of availability leaves open.
fn available(row: &[f64]) -> u128 {
    row.iter().enumerate().map(|(at, open)| u128::from(*open != 0.0) << at).sum()
}

/// Adds a recorded episode to others, as the one at a place of theirs.
fn push_episode(case: &Case, (place, number): (usize, usize), lesson: &mut Lesson) {
    let column = |name: &str| &case.get(name).data[number * STATES..][..STATES];
    let (filled, terminated) = (column("in/filled"), column("in/terminated"));
    let states = filled.iter().filter(|filled| **filled != 0.0).count();
    let part = !open(rows(case, "in/partition_groupA", ENTITIES)[number]);
    let entities = case.get("in/entities").f32s();
    let actions = &case.get("in/actions").data;
    let first = lesson.next.len();
    for step in 0..states {
        let state = number * STATES + step;
        let present = open(rows(case, "in/entity_mask", ENTITIES)[state]);
        let mut seen = Observation { present, entities: present, ..Observation::default() };
        for entity in members(present) {
            let mut row = entities[(state * ENTITIES + entity) * FEATURES..][..FEATURES].to_vec();
            row.resize(FEATURES + ACTIONS, 0.0);
            // What an agent did last is shown with it.
            if entity < AGENTS && step > 0 {
                row[FEATURES + actions[(state - 1) * AGENTS + entity] as usize] = 1.0;
            }
            seen.rows.push_dense(&row);
        }
        let of_agent = |name: &str, each: usize, width: usize, agent: usize| {
            rows(case, name, width)[state * each + agent]
        };
        seen.observable =
            (0..AGENTS).map(|a| open(of_agent("in/obs_mask", ENTITIES, ENTITIES, a))).collect();
        seen.available = (0..AGENTS)
            .map(|a| available(of_agent("in/avail_actions", AGENTS, ACTIONS, a)))
            .collect();
        let moment = Moment { step, episode: place };
        lesson.before.push_at(moment, &seen, |agent| Partitions::Drawn.within(part, 0, agent));
        let there = members(present).filter(|entity| *entity < AGENTS);
        lesson.actions.extend(there.map(|agent| actions[state * AGENTS + agent] as u32));
        let goes_on = step + 1 < states && terminated[..step].iter().all(|over| *over == 0.0);
        lesson.next.push(goes_on.then_some((first + step + 1) as u32));
        lesson.rewards.push(column("in/reward")[step] as f32);
        lesson.discounts.push(if terminated[step] == 0.0 { 0.99 } else { 0.0 });
    }
}

fn assert_gradients(what: &str, got: &[f64], want: &[f64]) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (at, (got, want)) in got.iter().zip(want).enumerate() {
        let error = (got - want).abs();
        assert!(error <= 1e-6 + 1e-3 * want.abs(), "{what}[{at}]: {got} against {want}");
    }
}

/// Targets, loss, gradients and the agents' parameters behind one update of REFIL with agents that remember.
#[test]
fn an_update_of_refil_agrees() {
    let case = safetensors_case("learner", "refil_gru_0");
    let figure = |name: &str| case.get(&format!("out/stat/{name}")).data[0];
    // In the first two episodes one of three agents is absent.
    let groups = [(&[0, 1][..], 2.0 / 3.0), (&[2], 1.0)];
    let mut lessons = groups.map(|(numbers, share)| {
        let mut lesson = Lesson::default();
        lesson.before.share_rows(true);
        let places = numbers.iter().copied().enumerate();
        places.for_each(|place| push_episode(&case, place, &mut lesson));
        lesson.before.finish(true);
        (lesson, share)
    });
    let records = lessons.iter().map(|(lesson, _)| lesson.next.iter().flatten().count()).sum();
    assert_eq!(records, 7 + 7 + 5);
    let (networks, parameters) = Networks::new(SHAPE, &mut stream(1, 1, 0));
    let mut gradient = vec![0.0; parameters.values.len()];
    let [mut real, mut imagined, mut targets] = [0.0; 3];
    for (lesson, present) in &mut lessons {
        let [online, factors] = weights(&case, "w", *present);
        let [target, _] = weights(&case, "target_w", *present);
        let [mut tape, mut spare] = [Tape::default(), Tape::default()];
        let (pass, mut own) = (tape.begin(&online), vec![0.0; gradient.len()]);
        let (online, target) = (&online, &target);
        let mut shard =
            Shard { number: 0, pass, spare: &mut spare, online, target, space: &mut *lesson };
        let loss = networks.loss(&mut shard, Some(0.5), records);
        shard.pass.backward(loss.total, &mut own);
        let losses = lesson.losses;
        let slopes = own.iter().zip(&factors).map(|(slope, factor)| f64::from(slope * factor));
        gradient.iter_mut().zip(slopes).for_each(|(sum, slope)| *sum += slope);
        real += losses.real / records as f64;
        imagined += losses.imagined / records as f64;
        targets += losses.targets / (records * AGENTS) as f64;
    }
    let near = |what: &str, got: f64, want: f64| {
        assert!((got - want).abs() <= 1e-5, "{what}: {got} against {want}");
    };
    near("targets", targets, figure("target_mean"));
    near("imagined", imagined, figure("im_loss"));
    near("loss", 0.5 * real + 0.5 * imagined, figure("loss"));

    let mut left = &gradient[..];
    let mut take = |count: usize| left.split_off(..count).expect("as many as there are parameters");
    let mut want = tensors(&case, "out/grad/agent", &LOOKING);
    want.extend(tensors(&case, "out/grad/agent", &DECIDING));
    let of_agents = take(want.len());
    assert_gradients("agents", of_agents, &want);
    for name in HYPERNETWORKS {
        let want = tensors(&case, &format!("out/grad/mixer.{name}"), &LOOKING);
        assert_gradients(name, take(want.len()), &want);
        let (averages, prefix) = (name == "V", format!("w/mixer.{name}"));
        let behind = Behind::new(&case, &prefix, averages);
        let (weight, bias) = (take(behind.second.len()), take(behind.second_bias.len()));
        let parted = behind.parted(weight, bias, averages);
        let names = ["attn.out_trans.weight", "attn.out_trans.bias", "fc2.weight", "fc2.bias"];
        for (got, tensor) in parted.iter().zip(names) {
            let name = format!("mixer.{name}.{tensor}");
            assert_gradients(&name, got, &case.get(&format!("out/grad/{name}")).data);
        }
    }

    let [mut parameters, _] = weights(&case, "w", 1.0);
    parameters.truncate(of_agents.len());
    let slopes: Vec<f32> = of_agents.iter().map(|slope| *slope as f32).collect();
    RmsProp::new(parameters.len()).step(&mut parameters, &slopes, 5e-4);
    let mut after = tensors(&case, "out/after/agent", &LOOKING);
    after.extend(tensors(&case, "out/after/agent", &DECIDING));
    for ((got, after), slope) in parameters.iter().zip(&after).zip(&want) {
        // The first step of RMSprop is nearly the sign of the slope, which is noise where it is tiny.
        if slope.abs() >= 1e-6 {
            near("after", (*got).into(), *after);
        }
    }
}
