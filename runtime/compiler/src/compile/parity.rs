//! Whether a plan gives the answers of the graph that it was made from.

use sortie_bundle::OwnedObservation;
use sortie_core::allocate::{PlanTeamValue, TeamValueNetwork};
use sortie_core::choose::masked_argmax;
use sortie_core::internal::ops::OutputRows;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{PlanPolicy, Policy};
use sortie_plans::{
    Comparison, CompileError, OwnedEntities, OwnedTeamQuery, Rows, cannot_run, magnitude,
    random_states,
};

use crate::graph::Graph;
use crate::graph::inputs::TeamValueEngine;
use crate::tract::{TractEntities, TractPolicy, TractTeamValue};

/// Compares a plan with the ONNX graph that it was made from.
pub fn compare_with_graph(
    plan: &[u8],
    onnx: &[u8],
    observations: &[OwnedObservation],
) -> Result<Comparison, CompileError> {
    plan_against_graph(plan, &Graph::read(onnx)?, observations, 0)
}

pub(crate) fn plan_against_graph(
    plan: &[u8],
    graph: &Graph,
    observations: &[OwnedObservation],
    seed: u64,
) -> Result<Comparison, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let features = plan.header().features as usize;
    let mut reference = TractPolicy::from_graph(graph, features)?;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice())?;
    let mut comparison = Comparison::new("plan against tract");
    let (mut got, mut want) = (vec![0.0; policy.actions()], vec![0.0; policy.actions()]);
    let mut states = random_states(policy.hidden(), seed);
    for observation in observations {
        let view = observation.view();
        let mut state = states();
        let mut wanted_state = state.clone();
        policy.utilities_with(&view, &mut state, &mut got).map_err(cannot_run)?;
        reference.step(&view, Rows::All, &mut wanted_state, &mut want).map_err(cannot_run)?;
        let action = |utilities: &[f32]| masked_argmax(utilities, view.available).map(|d| d.action);
        let same_action = action(&got) == action(&want);
        // A wrong state shows in the next step's utilities, so it counts like them.
        let both = |utilities: &[f32], state: &[f32]| [utilities, state].concat();
        comparison.add(&both(&got, &state), &both(&want, &wanted_state), same_action);
    }
    Ok(comparison)
}

/// Compares an allocator's plan with the ONNX graph that it was made from.
///
/// Errors are measured against the largest value of all queries: values are added up and compared with
/// each other, so that their common scale counts, and one value has no others beside it.
pub fn compare_team_values_with_graph(
    plan: &[u8],
    onnx: &[u8],
    queries: &[OwnedTeamQuery],
) -> Result<Comparison, CompileError> {
    team_values_against_graph(plan, &Graph::read(onnx)?, queries)
}

pub(crate) fn team_values_against_graph(
    plan: &[u8],
    graph: &Graph,
    queries: &[OwnedTeamQuery],
) -> Result<Comparison, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let mut reference = TractTeamValue::from_graph(graph)?;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let entities = queries.iter().map(|query| query.state.entities()).max().unwrap_or(0);
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, entities)];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows)?;
    let (mut got, mut want) = (Vec::new(), Vec::new());
    for query in queries {
        let state = query.state.view();
        let query = query.view(&state);
        got.push(network.value(&query).map_err(cannot_run)?);
        want.push(reference.run(&query, Rows::All).map_err(cannot_run)?);
    }
    let largest = magnitude(&want);
    let mut comparison = Comparison::new("allocator plan against tract");
    for (got, want) in got.iter().zip(&want) {
        comparison.add_on_scale(largest, &[*got], &[*want], true);
    }
    Ok(comparison)
}

/// Compares the plan of a network over all entities with the ONNX graph that it was made from.
///
/// Every output is measured on its own scale; the worst one counts.
pub fn compare_entities_with_graph(
    plan: &[u8],
    onnx: &[u8],
    steps: &[OwnedEntities],
) -> Result<Comparison, CompileError> {
    entities_against_graph(plan, &Graph::read(onnx)?, steps)
}

pub(crate) fn entities_against_graph(
    plan: &[u8],
    graph: &Graph,
    steps: &[OwnedEntities],
) -> Result<Comparison, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let mut reference = TractEntities::from_graph(graph)?;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut comparison = Comparison::new("plan against tract");
    for step in steps {
        let view = step.view();
        let mut got: Vec<Vec<f32>> = Vec::new();
        for output in plan.program().outputs() {
            let rows = match output.rows {
                OutputRows::Entities => view.groups.len(),
                OutputRows::Groups => output.groups.into(),
                _ => 1,
            };
            got.push(vec![0.0; rows * output.width as usize]);
        }
        let mut outputs: Vec<&mut [f32]> = got.iter_mut().map(Vec::as_mut_slice).collect();
        plan.evaluate(arena.as_mut_slice(), &view, &mut outputs).map_err(cannot_run)?;
        let want = reference.run(&view)?;
        let sizes = |outputs: &[Vec<f32>]| outputs.iter().map(Vec::len).collect::<Vec<_>>();
        if sizes(&got) != sizes(&want) {
            return Err(cannot_run("the outputs of plan and graph have other sizes"));
        }
        let scaled = got.iter().zip(&want).map(|(got, want)| {
            let scale = 1.0 + magnitude(want);
            let on_scale = |values: &[f32]| values.iter().map(|v| v / scale).collect::<Vec<_>>();
            (on_scale(got), on_scale(want))
        });
        let (got, want): (Vec<_>, Vec<_>) = scaled.unzip();
        comparison.add_on_scale(0.0, &got.concat(), &want.concat(), true);
    }
    Ok(comparison)
}
