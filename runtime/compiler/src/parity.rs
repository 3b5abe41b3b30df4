//! Whether two engines give the same answers.

use serde::Serialize;
use sortie_bundle::{Golden, OwnedObservation};
use sortie_core::allocate::{PlanTeamValue, TeamValueNetwork};
use sortie_core::choose::masked_argmax;
use sortie_core::ops::OutputRows;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{PlanPolicy, Policy};

use crate::engine::TeamValueEngine;
use crate::error::CompileError;
use crate::graph::Graph;
use crate::graph_inputs::Rows;
use crate::observations::{OwnedEntities, OwnedTeamQuery, random_states};
use crate::tract_entities::TractEntities;
use crate::tract_policy::TractPolicy;
use crate::tract_team_value::TractTeamValue;

/// Largest error of an f32 plan, see [`Comparison::max_rel_error`].
pub const TOLERANCE: f32 = 1.0e-5;

/// How far an engine is from the expected answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// What was compared, for example `plan against tract`.
    pub name: String,
    /// Observations.
    pub inputs: usize,
    /// Largest |a - b| / (1 + m) of any utility, with m the largest |b| of its observation.
    ///
    /// Rounding grows with the largest numbers of a sum, not with its result: a small utility beside
    /// large ones carries their error, in the source graph as well.
    pub max_rel_error: f32,
    /// Observations for which another action, or another allocation, was chosen.
    pub action_mismatches: usize,
    /// Inputs without an answer, as it should be: an engine refuses, its numbers are not finite, or no
    /// action is available.
    pub refused: usize,
    /// Inputs for which only one of both gave an answer, and inputs that should have been refused.
    pub refusals_differ: usize,
    /// Inputs that are no numbers, rightly refused, to which the other engine gave finite numbers.
    pub swallowed: usize,
    /// Whether differences count: not where products leave the range of f32 in any engine.
    pub judged: bool,
    /// The observation with the largest error.
    #[serde(skip)]
    pub worst_input: usize,
}

impl Comparison {
    pub(crate) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            inputs: 0,
            max_rel_error: 0.0,
            action_mismatches: 0,
            refused: 0,
            refusals_differ: 0,
            swallowed: 0,
            judged: true,
            worst_input: 0,
        }
    }

    /// Adds an input that one engine did not answer, or both.
    pub(crate) fn add_refusal(&mut self, agreed: bool) {
        self.inputs += 1;
        self.refused += usize::from(agreed);
        self.refusals_differ += usize::from(!agreed);
    }

    /// Adds an input that must be refused, whatever the other engine makes of it.
    pub(crate) fn add_no_number(&mut self, refused: bool, other_answers: bool) {
        self.add_refusal(refused);
        self.swallowed += usize::from(refused && other_answers);
    }

    /// Whether nothing counts as a difference, but for other choices: within the tolerance they are near ties.
    pub fn agrees(&self) -> bool {
        !self.judged || self.max_rel_error <= TOLERANCE && self.refusals_differ == 0
    }

    pub(crate) fn add(&mut self, got: &[f32], want: &[f32], same_action: bool) {
        self.add_on_scale(magnitude(want), got, want, same_action);
    }

    /// Adds utilities from which no action was chosen, by both engines or by one.
    pub(crate) fn add_unchosen(&mut self, got: &[f32], want: &[f32], by_both: bool) {
        self.add(got, want, true);
        self.refused += usize::from(by_both);
        self.refusals_differ += usize::from(!by_both);
    }

    /// Adds answers whose largest magnitude is known from more than themselves.
    pub(crate) fn add_on_scale(
        &mut self,
        largest: f32,
        got: &[f32],
        want: &[f32],
        same_action: bool,
    ) {
        let distance =
            got.iter().zip(want).map(|(got, want)| (got - want).abs()).fold(0.0, f32::max);
        let error = distance / (1.0 + largest);
        if error > self.max_rel_error {
            (self.max_rel_error, self.worst_input) = (error, self.inputs);
        }
        self.inputs += 1;
        self.action_mismatches += usize::from(!same_action);
    }
}

pub(crate) fn magnitude(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()))
}

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

/// Compares a policy with recorded answers.
pub fn compare_with_golden(
    name: &str,
    policy: &mut dyn Policy,
    golden: &Golden,
) -> Result<Comparison, CompileError> {
    let mut comparison = Comparison::new(name);
    let mut got = vec![0.0; policy.actions()];
    for case in &golden.cases {
        let view = case.observation.view();
        policy.utilities(&view, &mut got).map_err(cannot_run)?;
        let action = policy.decide(&view).map_err(cannot_run)?.action;
        comparison.add(&got, &case.utilities, action == case.action);
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
                OutputRows::Groups(groups) => groups.into(),
                _ => 1,
            };
            got.push(vec![0.0; rows * usize::from(output.width)]);
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

pub(crate) fn cannot_run(error: impl std::fmt::Display) -> CompileError {
    CompileError::Run { reason: error.to_string() }
}
