//! Layers of an allocator that proposes become operators.

use sortie_core::allocate::proposals::{PROPOSALS, arena_floats};
use sortie_core::internal::ops::{
    EmbedTasks, Op, PointerLogits, ProposalNetwork, RowAttention, ScoreAllocations,
};
use sortie_core::limits;
use sortie_core::plan::ProgramDraft;
use sortie_plans::CompileError;

use super::agent::{Weights, at_most, by_heads, check_weights, padded_heads, same_sizes};
use crate::matching::{
    AllAttention, CriticLayers, Layer, Matrix, ProposalLayers, StepLayers, TrunkLayers,
};

/// Lowers trunk, step and critic to one program and its weights.
pub(crate) fn lower_proposals(
    layers: &ProposalLayers,
    n_max: usize,
) -> Result<(ProgramDraft, Weights), CompileError> {
    check(layers, n_max)?;
    let mut weights = Weights::default();
    let network = ProposalNetwork {
        trunk: lower_trunk(&layers.trunk, &mut weights),
        step: lower_step(&layers.step, &mut weights),
        critic: lower_critic(&layers.critic, &mut weights),
    };
    let ProposalNetwork { trunk, step, critic } = network;
    let ops = [Op::EmbedTasks(trunk), Op::PointerLogits(step), Op::ScoreAllocations(critic)];
    let floats = arena_floats(&network, n_max);
    let floats = u32::try_from(floats).ok().filter(|floats| *floats < u32::MAX / 4);
    let too_large = CompileError::TooLarge {
        what: format!("the number of entities of {PROPOSALS} proposals").into(),
        got: n_max,
        max: limits::ENTITIES,
    };
    let floats = floats.ok_or(too_large)?;
    Ok((ProgramDraft { ops: ops.to_vec(), floats, nonzeros: 0 }, weights))
}

fn lower_trunk(layers: &TrunkLayers, weights: &mut Weights) -> EmbedTasks {
    EmbedTasks {
        embed: weights.add_layer(&layers.embed),
        tasks: weights.add_vectors(&layers.tasks),
        attention: lower_attention(&layers.attention, weights),
    }
}

fn lower_step(layers: &StepLayers, weights: &mut Weights) -> PointerLogits {
    let scale = Matrix { inputs: 1, outputs: 1, values: vec![layers.scale] };
    PointerLogits {
        counts: weights.add_vectors(&layers.counts),
        scale: weights.add_vectors(&scale),
        from_task: weights.add_layer(&layers.from_task),
        from_agent: weights.add_layer(&layers.from_agent),
    }
}

fn lower_critic(layers: &CriticLayers, weights: &mut Weights) -> ScoreAllocations {
    ScoreAllocations {
        embed: weights.add_layer(&layers.embed),
        tasks: weights.add_vectors(&layers.tasks),
        counts: weights.add_vectors(&layers.counts),
        attention: lower_attention(&layers.attention, weights),
        head: weights.add_layer(&layers.head),
    }
}

fn lower_attention(attention: &AllAttention, weights: &mut Weights) -> RowAttention {
    let AllAttention { heads, query, key, value, output } = attention;
    let padded_output = Layer { matrix: padded_heads(&output.matrix, *heads), ..output.clone() };
    let [query, key, value] =
        [query, key, value].map(|layer| weights.add_layer(&by_heads(layer, *heads)));
    let output = weights.add_layer(&padded_output);
    RowAttention { heads: *heads as u32, query, key, value, output }
}

/// Checks that sizes fit each other and into a plan, and that all numbers are finite.
fn check(layers: &ProposalLayers, n_max: usize) -> Result<(), CompileError> {
    let ProposalLayers { trunk, step, critic } = layers;
    at_most("the number of entities", n_max, limits::ENTITIES)?;
    at_most("the number of features", trunk.embed.matrix.inputs, limits::FEATURES)?;
    at_most("the number of subtasks", trunk.tasks.inputs, limits::TASKS)?;
    let (width, critic_width) = (trunk.embed.matrix.outputs, critic.embed.matrix.outputs);
    for (name, attention, width) in
        [("trunk", &trunk.attention, width), ("critic", &critic.attention, critic_width)]
    {
        check_attention(name, attention, width)?;
    }
    for (what, got, want) in [
        ("the critic's number of features", critic.embed.matrix.inputs, trunk.embed.matrix.inputs),
        ("the critic's number of subtasks", critic.tasks.inputs, trunk.tasks.inputs),
        ("the width of the trunk's subtasks", trunk.tasks.outputs, width),
        ("the width of the critic's subtasks", critic.tasks.outputs, critic_width),
        ("the width of the critic's counts", critic.counts.outputs, critic_width),
        ("the width of the step's counts", step.counts.outputs, width),
        ("the step's input", step.from_task.matrix.inputs, width),
        ("the step's output", step.from_task.matrix.outputs, width),
        ("the step's input of an agent", step.from_agent.matrix.inputs, width),
        ("the step's output of an agent", step.from_agent.matrix.outputs, width),
        ("the input of the critic's last layer", critic.head.matrix.inputs, critic_width),
        ("the output of the critic's last layer", critic.head.matrix.outputs, 1),
    ] {
        same_sizes(what, got, want)?;
    }
    let of_layer =
        |layer: &'static str, found: &Layer| check_weights(layer, &found.matrix, &found.bias);
    of_layer("trunk's first", &trunk.embed)?;
    of_layer("step's", &step.from_task)?;
    of_layer("step's", &step.from_agent)?;
    of_layer("critic's first", &critic.embed)?;
    of_layer("critic's last", &critic.head)?;
    check_weights("trunk's subtask", &trunk.tasks, &[])?;
    check_weights("critic's subtask", &critic.tasks, &[])?;
    check_weights("critic's count", &critic.counts, &[])?;
    check_weights("step's count", &step.counts, &[step.scale])
}

fn check_attention(
    name: &'static str,
    attention: &AllAttention,
    width: usize,
) -> Result<(), CompileError> {
    let AllAttention { heads, query, key, value, output } = attention;
    let inner = query.matrix.outputs;
    for layer in [query, key, value] {
        check_weights(name, &layer.matrix, &layer.bias)?;
        same_sizes("the attention's input", layer.matrix.inputs, width)?;
        same_sizes("the heads' joint width", layer.matrix.outputs, inner)?;
    }
    check_weights(name, &output.matrix, &output.bias)?;
    same_sizes("the heads' joint width", inner / (*heads).max(1) * heads, inner)?;
    same_sizes("the attention output's input", output.matrix.inputs, inner)?;
    same_sizes("the attention's output", output.matrix.outputs, width)?;
    at_most("the width of a layer", inner * 8, usize::from(u16::MAX))
}
