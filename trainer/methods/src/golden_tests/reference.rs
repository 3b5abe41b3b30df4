//! Weights and masks of the reference's low level as ours.

use crate::alma::agents::{TaskOrder, UtilityNetwork, UtilityShape, transpose};
use crate::alma::windows::{NO_TASK, WindowShape, Windows};
use sortie_learn::networks::Targets;

use super::files::Case;

/// The reference's names of the four hypernetworks, in our order.
const HYPERNETWORKS: [&str; 4] = ["hyper_w_1", "hyper_b_1", "hyper_w_final", "V"];

/// The recorded numbers of a hypernetwork in our order; `prefix` leads to its tensors.
pub(crate) fn hypernetwork(case: &Case, prefix: &str) -> Vec<f32> {
    let tensor = |name: &str| case.get(&format!("{prefix}{name}")).f32s();
    let sizes = &case.get(&format!("{prefix}fc1.weight")).shape;
    let (width, input) = (sizes[0], sizes[1]);
    let fc1 = tensor("fc1.weight");
    let columns = (0..input).flat_map(|d| (0..width).map(move |e| e * input + d));
    let mut parameters: Vec<f32> = columns.map(|index| fc1[index]).collect();
    for name in [
        "fc1.bias",
        "attn.in_trans.weight",
        "attn.out_trans.weight",
        "attn.out_trans.bias",
        "fc2.weight",
        "fc2.bias",
    ] {
        parameters.extend(tensor(name));
    }
    parameters
}

/// The recorded numbers of a mixer in our order; `outputs` are the pairs of its head.
pub(crate) fn mixer(case: &Case, prefix: &str, outputs: usize) -> Vec<f32> {
    let of = |name: &str| hypernetwork(case, &format!("{prefix}{name}."));
    let mut parameters: Vec<f32> = HYPERNETWORKS.into_iter().flat_map(of).collect();
    for (name, nothing) in [("popart_weight", 1.0), ("popart_bias", 0.0)] {
        match case.tensors.get(&format!("{prefix}{name}")) {
            Some(tensor) => parameters.extend(tensor.f32s()),
            None => parameters.resize(parameters.len() + outputs, nothing),
        }
    }
    parameters
}

/// The recorded utility network; an embedding of subtasks becomes further columns of `fc1`.
pub(crate) fn agents(case: &Case, prefix: &str, heads: usize) -> UtilityNetwork {
    let name = |name: &str| format!("{prefix}{name}");
    let tensor = |part: &str| case.get(&name(part)).f32s();
    let sizes = |part: &str| case.get(&name(part)).shape.clone();
    let (fc1, head) = (sizes("_base.fc1.weight"), sizes("_head.fc_out.weight"));
    let mut columns = vec![(fc1[1], tensor("_base.fc1.weight"))];
    if let Some(embedding) = case.tensors.get(&name("task_embed.fc.weight")) {
        columns.push((embedding.shape[1], embedding.f32s()));
    }
    let row = |e: usize| columns.iter().flat_map(move |(count, all)| &all[e * count..][..*count]);
    let shape = UtilityShape {
        input: columns.iter().map(|(count, _)| count).sum(),
        width: fc1[0],
        heads,
        base: head[1],
        actions: head[0],
        skip: false,
        targets: Targets::default(),
    };
    let embed: Vec<f32> = (0..fc1[0]).flat_map(row).copied().collect();
    let mut parameters = transpose(&embed, shape.width, shape.input);
    for part in [
        "_base.fc1.bias",
        "_base.attn.in_trans.weight",
        "_base.attn.out_trans.weight",
        "_base.attn.out_trans.bias",
        "_base.fc2.weight",
        "_base.fc2.bias",
        "_head.fc_out.weight",
        "_head.fc_out.bias",
    ] {
        parameters.extend(tensor(part));
    }
    assert_eq!(parameters.len(), shape.parameters(), "tensors of the recorded network fit");
    UtilityNetwork { shape, parameters }
}

/// The states of a recorded network case as windows of one step: entities, who is there, who works on
/// what and, where it was recorded, who sees whom. Last actions are columns of the entities already.
pub(crate) fn states(case: &Case, agents: usize, actions: usize) -> Windows {
    let entities = case.get("in/entities");
    let [.., count, width] = entities.shape[..] else { panic!("sizes") };
    let samples = entities.data.len() / count / width;
    let member = case.tensors.get("in/entity2task_mask");
    let tasks = member.map_or(1, |member| member.shape[member.shape.len() - 1]);
    let mut windows = Windows::new(WindowShape {
        windows: samples,
        steps: 1,
        agents,
        entities: count,
        tasks,
        actions,
        features: width - actions,
        targets: Targets::NONE,
    });
    windows.features.clear();
    entities.f32s().chunks(width).for_each(|row| windows.features.push_dense(row));
    windows.present = case.get("in/entity_mask").data.iter().map(|v| *v == 0.0).collect();
    if let Some(outside) = member {
        let task = |row: &[f64]| row.iter().position(|v| *v == 0.0).map_or(NO_TASK, |t| t as u8);
        windows.entity_task = outside.data.chunks(tasks).map(task).collect();
    }
    if let Some(blocked) = case.tensors.get("in/obs_mask") {
        let of_agents = |state: &'_ [f64]| state[..agents * count].to_vec();
        let seen = blocked.data.chunks(count * count).flat_map(of_agents);
        windows.observable = seen.map(|v| v == 0.0).collect();
    }
    windows
}

/// The columns of tasks, where the reference says which task each column stands for.
pub(crate) fn order(case: &Case) -> TaskOrder {
    let tasks = &case.get("in/task_perm").data;
    let column = |task: usize| tasks.iter().position(|it| *it == task as f64);
    TaskOrder((0..tasks.len()).map(|task| column(task).expect("all tasks") as u16).collect())
}
