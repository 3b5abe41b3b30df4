//! The layers against the reference's modules, on recorded inputs (`tests/golden/networks`).

use crate::alma::agents::{UtilityInput, UtilityLayers};
use sortie_nn::layers::attention::{self, AttentionShape};
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::{SparseRows, VisibleLists};
use sortie_nn::tape::Tape;

use super::assert_close;
use super::files::{Case, json_cases, safetensors_case};
use super::reference::agents;

/// Entities of several samples: rows of agents first, then the others, as the learner orders them.
struct Order {
    agents: usize,
    entities: usize,
    samples: usize,
}

impl Order {
    fn row(&self, sample: usize, entity: usize) -> usize {
        if entity < self.agents {
            sample * self.agents + entity
        } else {
            let others = self.entities - self.agents;
            self.samples * self.agents + sample * others + entity - self.agents
        }
    }

    /// (sample, entity) in the order of the rows.
    fn iter(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let part = |range: std::ops::Range<usize>| {
            (0..self.samples).flat_map(move |sample| range.clone().map(move |e| (sample, e)))
        };
        part(0..self.agents).chain(part(self.agents..self.entities))
    }
}

#[test]
fn attention_layer_agrees() {
    for case in json_cases("attention_layer") {
        let entities = case.get("in/entities");
        let [samples, count, width] = entities.shape[..] else { panic!("sizes") };
        let agents = case.get("in/post_mask").shape[1];
        let order = Order { agents, entities: count, samples };
        let blocked = &case.get("in/pre_mask").data;

        let mut rows = Vec::new();
        for (sample, entity) in order.iter() {
            rows.extend(&entities.f32s()[(sample * count + entity) * width..][..width]);
        }
        let mut visible = VisibleLists::default();
        for (sample, query) in order.iter().take(samples * agents) {
            for entity in 0..count {
                if blocked[(sample * count + query) * count + entity] == 0.0 {
                    visible.push(order.row(sample, entity));
                }
            }
            visible.end_list();
        }

        let shape = AttentionShape { width, heads: 4 };
        let (weight_q, weight_kv) = {
            let mut all = case.get("w/in_trans.weight").f32s();
            let rest = all.split_off(width * width);
            (all, rest)
        };
        let mut queries = vec![0.0; samples * agents * width];
        let square = LinearShape { input: width, output: width };
        linear::product(square, Store::Replace, &rows[..queries.len()], &weight_q, &mut queries);
        let mut keys_values = vec![0.0; samples * count * 2 * width];
        let double = LinearShape { input: width, output: 2 * width };
        linear::product(double, Store::Replace, &rows, &weight_kv, &mut keys_values);
        let mut attended = vec![0.0; queries.len()];
        let pass = attention::Forward {
            queries: &queries,
            keys_values: &keys_values,
            of_pairs: &mut vec![0.0; visible.pairs() * 4],
            shares: &mut [],
            output: &mut attended,
        };
        attention::forward(shape, &visible, pass);

        let want = case.get("out/out");
        let output = want.shape[2];
        let mut got = vec![0.0; samples * agents * output];
        linear::forward(
            LinearShape { input: width, output },
            &attended,
            &case.get("w/out_trans.weight").f32s(),
            &case.get("w/out_trans.bias").f32s(),
            &mut got,
        );
        // Absent agents are not computed here; the reference blanks their rows.
        let absent = &case.get("in/post_mask").data;
        let mut compared = 0;
        for (row, absent) in absent.iter().enumerate() {
            if *absent == 0.0 {
                let span = row * output..(row + 1) * output;
                assert_close(&case.name, &got[span.clone()], &want.data[span]);
                compared += 1;
            }
        }
        assert!(compared > samples, "{}: too few agents present", case.name);
    }
}

fn check_utility_network(case: &Case, subtask_mask: bool) {
    let network = agents(case, "w/", 4);
    let shape = &case.get("in/entities").shape;
    let (samples, count) = (shape[0] * shape[1], shape[2]);
    let agents = case.get("out/q").shape[2];
    let tasks = case.get("in/entity2task_mask").shape[3];
    let order = Order { agents, entities: count, samples };
    let (blocked, outside) = (&case.get("in/obs_mask").data, &case.get("in/entity2task_mask").data);
    let same_task = |sample: usize, a: usize, b: usize| {
        let member = |e: usize, t: usize| outside[(sample * count + e) * tasks + t] == 0.0;
        (0..tasks).any(|task| member(a, task) && member(b, task))
    };

    let features = case.get("in/entities").f32s();
    let width = network.shape.input;
    let mut input = UtilityInput { rows: SparseRows::default(), ..UtilityInput::default() };
    for (sample, entity) in order.iter() {
        input.rows.push_dense(&features[(sample * count + entity) * width..][..width]);
    }
    for (sample, agent) in order.iter().take(samples * agents) {
        for entity in 0..count {
            let seen = blocked[(sample * count + agent) * count + entity] == 0.0;
            if seen && (!subtask_mask || same_task(sample, agent, entity)) {
                input.visible.push(order.row(sample, entity));
            }
        }
        input.visible.end_list();
    }

    let mut tape = Tape::default();
    let mut pass = tape.begin(&network.parameters);
    let layers = UtilityLayers::of(network.shape);
    let got = layers.utilities(&mut pass, &input);
    let got = pass.values(got);
    let want = &case.get("out/q").data;
    let actions = network.shape.actions;
    let absent = &case.get("in/entity_mask").data;
    let mut compared = 0;
    for (sample, agent) in order.iter().take(samples * agents) {
        if absent[sample * count + agent] == 0.0 {
            let span = (sample * agents + agent) * actions..(sample * agents + agent + 1) * actions;
            assert_close(&case.name, &got[span.clone()], &want[span]);
            compared += 1;
        }
    }
    assert!(compared > samples, "{}: too few agents present", case.name);
}

#[test]
fn utility_network_without_subtasks_agrees() {
    for case in json_cases("agent_ff_none") {
        check_utility_network(&case, false);
    }
}

#[test]
fn utility_network_with_subtask_mask_agrees() {
    for case in json_cases("agent_ff_mask") {
        check_utility_network(&case, true);
    }
}

#[test]
fn utility_network_at_save_the_city_sizes_agrees() {
    check_utility_network(&safetensors_case("networks", "agent_ff_default"), true);
}
