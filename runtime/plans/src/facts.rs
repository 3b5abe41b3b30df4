//! Facts about ONNX files and plans, for people and scripts.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize, Serializer};
use sortie_bundle::hex;
use sortie_core::plan::{AlignedBytes, Network, Plan};

use crate::annex::Annex;
use crate::error::CompileError;
use crate::policy::PolicyFacts;
use crate::report::{OperatorReport, operators};

/// What an ONNX file holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OnnxFacts {
    /// Version of the file format.
    pub ir_version: i64,
    /// Version of the default operator set.
    pub opset: i64,
    /// The program that wrote the file.
    pub producer: String,
    /// Inputs with types and shapes.
    pub inputs: Vec<(String, String)>,
    /// Outputs with types and shapes.
    pub outputs: Vec<(String, String)>,
    /// Nodes per operator.
    pub operators: BTreeMap<String, usize>,
    /// Constant numbers stored in the file.
    pub parameters: i64,
    /// Metadata entries.
    pub metadata: BTreeMap<String, String>,
}

/// What an ONNX file holds, and, where it is none of the networks that plans are made of, the policy that it may be.
#[derive(Debug, Serialize, Deserialize)]
pub struct InspectedOnnx {
    /// What it holds.
    pub facts: OnnxFacts,
    /// The policy, or what must be said about the file before it is one; none for the networks that plans are made of.
    pub policy: Option<Result<PolicyFacts, CompileError>>,
}

/// What a plan holds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlanFacts {
    /// What it computes, by name for scripts: `agent` or `team-value`.
    #[serde(serialize_with = "network_name")]
    pub network: Network,
    /// Arithmetic profile, by name for scripts: `exact`, `fused` or `int8`.
    pub profile: &'static str,
    /// Bytes of the plan.
    pub flash_bytes: usize,
    /// Bytes of arena for one decision.
    pub arena_bytes: usize,
    /// Bytes of arena for every further agent of a team that decides together.
    pub arena_bytes_per_agent: usize,
    /// Most visible entities.
    pub n_max: usize,
    /// Features d of an entity.
    pub features: usize,
    /// Actions U.
    pub actions: usize,
    /// Floats of the recurrent state, 0 if there is none.
    pub hidden: usize,
    /// Most subtasks, 0 if none.
    pub t_max: u16,
    /// SHA-256 of the ONNX file that the plan was made from.
    pub source: String,
    /// Hash of the contract.
    pub contract: String,
    /// Largest measured error against the graph.
    pub max_rel_error: f32,
    /// Measured share of differing actions.
    pub action_mismatch: f32,
    /// Multiply-adds of one decision with all entities visible.
    pub macs: u64,
    /// The operators in order.
    pub operators: Vec<OperatorReport>,
    /// Names, sizes and roles of a policy's inputs and outputs; none where the plan has no annex.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<Annex>,
}

fn network_name<S: Serializer>(network: &Network, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(network.name())
}

/// Reads the facts of a plan.
pub fn inspect_plan(plan: &[u8]) -> Result<PlanFacts, CompileError> {
    let flash_bytes = plan.len();
    let policy = Annex::of_plan(plan)?;
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let header = plan.header();
    let operators = operators(plan.program(), header.n_max as usize);
    Ok(PlanFacts {
        network: header.network,
        profile: header.profile.name(),
        flash_bytes,
        arena_bytes: plan.arena_bytes(),
        arena_bytes_per_agent: plan.arena_bytes_per_agent(),
        n_max: header.n_max as usize,
        features: header.features as usize,
        actions: header.actions as usize,
        hidden: header.hidden as usize,
        t_max: header.t_max,
        source: hex(&header.source),
        contract: format!("{:016x}", header.contract),
        max_rel_error: header.max_error,
        action_mismatch: header.action_mismatch,
        macs: operators.iter().map(|operator| operator.macs).sum(),
        operators,
        policy,
    })
}
