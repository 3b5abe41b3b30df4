//! The layers against the reference's modules, on recorded inputs (`tests/golden/networks`).

use sortie_methods::alma::agents::{
    UtilityInput, UtilityNetwork, UtilityPass, UtilityShape, UtilityWeights,
};
use sortie_methods::alma::records::{Mixer, MixerKind, MixerPass, MixerShape, Teams};
use sortie_nn::layers::attention::{self, AttentionShape};
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::{SparseRows, VisibleLists};

use crate::files::{Case, assert_close, json_cases, safetensors_case};

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
        linear::forward_without_bias(square, &rows[..queries.len()], &weight_q, &mut queries);
        let mut keys_values = vec![0.0; samples * count * 2 * width];
        let double = LinearShape { input: width, output: 2 * width };
        linear::forward_without_bias(double, &rows, &weight_kv, &mut keys_values);
        let mut weights = vec![0.0; visible.pairs() * 4];
        let mut attended = vec![0.0; queries.len()];
        attention::forward(shape, &visible, &queries, &keys_values, &mut weights, &mut attended);

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

fn network(case: &Case, heads: usize) -> UtilityNetwork {
    let sizes = |name: &str| case.get(name).shape.clone();
    let (fc1, head) = (sizes("w/_base.fc1.weight"), sizes("w/_head.fc_out.weight"));
    let tensor = |name: &str| case.get(name).f32s();
    UtilityNetwork::from_weights(&UtilityWeights {
        shape: UtilityShape {
            input: fc1[1],
            width: fc1[0],
            heads,
            base: head[1],
            actions: head[0],
            skip: false,
        },
        fc1_weight: tensor("w/_base.fc1.weight"),
        fc1_bias: tensor("w/_base.fc1.bias"),
        attention_in_weight: tensor("w/_base.attn.in_trans.weight"),
        attention_out_weight: tensor("w/_base.attn.out_trans.weight"),
        attention_out_bias: tensor("w/_base.attn.out_trans.bias"),
        fc2_weight: tensor("w/_base.fc2.weight"),
        fc2_bias: tensor("w/_base.fc2.bias"),
        head_weight: tensor("w/_head.fc_out.weight"),
        head_bias: tensor("w/_head.fc_out.bias"),
        skip_weight: Vec::new(),
    })
    .expect("tensors of the golden network fit")
}

fn check_utility_network(case: &Case, subtask_mask: bool) {
    let network = network(case, 4);
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
    let width = network.shape().input;
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

    let mut pass = UtilityPass::new(network.shape());
    let got = pass.forward(&network, &input);
    let want = &case.get("out/q").data;
    let actions = network.shape().actions;
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

/// The reference's four hypernetworks as one: each has its own columns of the embedding and its own
/// heads, so that nothing of one reaches another.
fn mixer(case: &Case) -> Mixer {
    let sizes = |name: &str| case.get(name).shape.clone();
    let (width, input) = (sizes("w/V.fc1.weight")[0], sizes("w/V.fc1.weight")[1]);
    let mixing = sizes("w/V.fc2.weight")[0];
    let names = ["hyper_w_1", "hyper_b_1", "hyper_w_final", "V"];
    let (heads, whole) = (4 * names.len(), width * names.len());
    let shape = MixerShape { kind: MixerKind::Qmix, input, width: whole, heads, mixing };
    let places = shape.tensors();
    let mut parameters = vec![0.0; shape.parameters()];
    for (block, name) in names.into_iter().enumerate() {
        let tensor = |part: &str| case.get(&format!("w/{name}.{part}")).f32s();
        let mut set = |place: usize, index: usize, value: f32| {
            parameters[places[place].range.start + index] += value;
        };
        let start = block * width;
        let (fc1, fc1_bias) = (tensor("fc1.weight"), tensor("fc1.bias"));
        let attention_in = tensor("attn.in_trans.weight");
        for i in 0..width {
            (0..input).for_each(|d| set(0, d * whole + start + i, fc1[i * input + d]));
            set(1, start + i, fc1_bias[i]);
            for part in 0..3 {
                for j in 0..width {
                    let row = part * whole + start + i;
                    set(2, row * whole + start + j, attention_in[(part * width + i) * width + j]);
                }
            }
        }
        let (out, out_bias) = (tensor("attn.out_trans.weight"), tensor("attn.out_trans.bias"));
        let (fc2, fc2_bias) = (tensor("fc2.weight"), tensor("fc2.bias"));
        for m in 0..mixing {
            // V is the mean of its outputs.
            let (row, share) = if name == "V" {
                (3 * mixing, 1.0 / mixing as f32)
            } else {
                (block * mixing + m, 1.0)
            };
            set(4, row, share * fc2_bias[m]);
            for k in 0..width {
                let weight = share * fc2[m * width + k];
                set(4, row, weight * out_bias[k]);
                (0..width)
                    .for_each(|j| set(3, row * whole + start + j, weight * out[k * width + j]));
            }
        }
    }
    Mixer::from_parameters(shape, parameters).expect("as many as the shape has")
}

#[test]
fn flexible_mixer_agrees() {
    for case in json_cases("mixer_flexible") {
        let mixer = mixer(&case);
        let shape = &case.get("in/entities").shape;
        let (count, width) = (shape[2], shape[3]);
        let agents = case.get("in/agent_qs").shape[2];
        let (absent, features) = (&case.get("in/entity_mask").data, case.get("in/entities").f32s());
        let present = |sample: usize, entity: usize| absent[sample * count + entity] == 0.0;
        // The reference divides by absent agents as well; here a team has none.
        let whole = |sample: &usize| (0..agents).all(|agent| present(*sample, agent));
        let samples: Vec<usize> = (0..shape[0] * shape[1]).filter(whole).collect();
        assert!(samples.len() > 4);

        let order = Order { agents, entities: count, samples: samples.len() };
        let mut input = UtilityInput::default();
        for (place, entity) in order.iter() {
            let start = (samples[place] * count + entity) * width;
            input.rows.push_dense(&features[start..][..width]);
        }
        for (place, _) in order.iter().take(samples.len() * agents) {
            for entity in (0..count).filter(|entity| present(samples[place], *entity)) {
                input.visible.push(order.row(place, entity));
            }
            input.visible.end_list();
        }
        let all = case.get("in/agent_qs").f32s();
        let utilities: Vec<f32> =
            samples.iter().flat_map(|sample| &all[sample * agents..][..agents]).copied().collect();
        let sizes = vec![agents; samples.len()];
        let teams = Teams { input: &input, sizes: &sizes, utilities: &utilities };
        let want: Vec<f64> = samples.iter().map(|s| case.get("out/q_tot").data[*s]).collect();
        assert_close(&case.name, MixerPass::default().forward(&mixer, teams), &want);
    }
}
