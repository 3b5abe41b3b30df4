//! A plan before a judge: the source graph in an independent engine, family by family of inputs.

use sortie_bundle::OwnedObservation;
use sortie_core::allocate::{PlanTeamValue, TeamValueNetwork};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{Observation, PlanPolicy};
use sortie_plans::{
    Comparison, CompileError, Family, OwnedTeamQuery, Standard, compare_agents, magnitude,
};

use crate::graph::inputs::{AgentEngine, TeamValueEngine, all_finite};
use crate::onnxruntime::{OnnxRuntime, OnnxRuntimePolicy, OnnxRuntimeTeamValue};
use crate::tract::{TractPolicy, TractTeamValue};

/// An engine that runs the source graph itself.
#[derive(Clone, Copy, Debug)]
pub enum Judge<'a> {
    /// tract, on the simplified graph.
    Tract,
    /// onnxruntime, on the file as it is.
    OnnxRuntime(&'a OnnxRuntime),
}

impl Judge<'_> {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tract => "tract",
            Self::OnnxRuntime(_) => "onnxruntime",
        }
    }

    fn agent(self, onnx: &[u8], features: usize) -> Result<Box<dyn AgentEngine>, CompileError> {
        Ok(match self {
            Self::Tract => Box::new(TractPolicy::new(onnx, features)?),
            Self::OnnxRuntime(runtime) => {
                Box::new(OnnxRuntimePolicy::new(runtime, onnx, features)?)
            }
        })
    }

    fn team_value(self, onnx: &[u8]) -> Result<Box<dyn TeamValueEngine>, CompileError> {
        Ok(match self {
            Self::Tract => Box::new(TractTeamValue::new(onnx)?),
            Self::OnnxRuntime(runtime) => Box::new(OnnxRuntimeTeamValue::new(runtime, onnx)?),
        })
    }
}

/// Compares an agent's plan with its graph, a comparison for each family.
///
/// A plan refuses a feature or a utility that is not finite; graphs compute on. Where a graph's utilities
/// are not finite either, both have given no answer, and agree; see [`Standard`] for what is no number.
/// Families hold no recurrent states: an agent with memory is judged with an empty one.
pub fn judge_agent(
    plan: &[u8],
    onnx: &[u8],
    judge: Judge<'_>,
    families: &[Family<OwnedObservation>],
) -> Result<Vec<Comparison>, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let mut engine = judge.agent(onnx, plan.header().features as usize)?;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice())?;
    let mut answers = |seen: &Observation<'_>, rows, want: &mut [f32]| {
        engine.run(seen, rows, want).is_ok() && all_finite(want)
    };
    let compare = |family| compare_agents(&mut policy, &mut answers, family);
    Ok(families.iter().map(compare).collect())
}

/// Compares an allocator's plan with its graph, a comparison for each family.
///
/// Errors are measured against the largest value of a family: values are added up and compared with each other.
pub fn judge_team_values(
    plan: &[u8],
    onnx: &[u8],
    judge: Judge<'_>,
    families: &[Family<OwnedTeamQuery>],
) -> Result<Vec<Comparison>, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let mut engine = judge.team_value(onnx)?;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let entities = families.iter().flat_map(|family| &family.inputs);
    let entities = entities.map(|query| query.state.entities()).max().unwrap_or(0);
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, entities)];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows)?;
    let compare = |family| compare_values(&mut network, engine.as_mut(), family);
    Ok(families.iter().map(compare).collect())
}

fn compare_values(
    network: &mut dyn TeamValueNetwork,
    engine: &mut dyn TeamValueEngine,
    family: &Family<OwnedTeamQuery>,
) -> Comparison {
    let mut comparison = family.comparison();
    let (mut got, mut want) = (Vec::new(), Vec::new());
    for query in &family.inputs {
        let state = query.state.view();
        let query = query.view(&state);
        let ours = network.value(&query);
        let theirs = engine.run(&query, family.rows).ok().filter(|value| value.is_finite());
        match (ours, theirs) {
            (ours, theirs) if family.standard == Standard::Refusal => {
                comparison.add_no_number(ours.is_err(), theirs.is_some());
            }
            (Ok(ours), Some(theirs)) => {
                got.push(ours);
                want.push(theirs);
            }
            (ours, theirs) => comparison.add_refusal(ours.is_ok() == theirs.is_some()),
        }
    }
    let largest = magnitude(&want);
    for (got, want) in got.iter().zip(&want) {
        comparison.add_on_scale(largest, &[*got], &[*want], true);
    }
    comparison
}
