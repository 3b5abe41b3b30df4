//! Facts about ONNX files and plans, for people and scripts, and what stands behind the weights of a policy's plan for
//! them: names, sizes, roles and metadata.
//!
//! The executor ignores bytes behind the weights, so that a plan without its annex decides alike.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize, Serializer};
use sortie_bundle::hex;
use sortie_core::internal::checksum::crc32c;
use sortie_core::plan::{AlignedBytes, GuardFacts, Header, Network, Plan, Proof, RobotFacts};

use crate::error::CompileError;
use crate::policy::PolicyFacts;
use crate::policy_plan::PolicyAgreement;
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
    /// What nobody refuses and somebody should know about a policy, in sentences.
    pub remarks: Vec<String>,
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
    /// How far its numbers were from the graph's, by the keys of [`crate::Report`] and [`crate::Comparison`].
    #[serde(flatten)]
    pub proof: Proof,
    /// Measured share of differing actions.
    pub action_mismatch: f32,
    /// Multiply-adds of one decision with all entities visible.
    pub macs: u64,
    /// The operators in order.
    pub operators: Vec<OperatorReport>,
    /// Names, sizes and roles of a policy's inputs and outputs; none where the plan has no annex.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<Annex>,
    /// What a robot must know of its policy beside the numbers; none where the plan does not say.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<RobotFacts>,
    /// What is let in and out; none where nothing is guarded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guards: Option<GuardFacts>,
}

fn network_name<S: Serializer>(network: &Network, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(network.name())
}

/// Reads the facts of a plan.
pub fn inspect_plan(plan: &[u8]) -> Result<PlanFacts, CompileError> {
    let flash_bytes = plan.len();
    let (policy, robot) = (Annex::of_plan(plan)?, RobotFacts::of_plan(plan));
    let bytes = AlignedBytes::copy_of(plan);
    let plan = Plan::load(bytes.as_slice())?;
    let guards = guards_of(bytes.as_slice())?;
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
        proof: header.proof,
        action_mismatch: header.action_mismatch,
        macs: operators.iter().map(|operator| operator.macs).sum(),
        operators,
        policy,
        robot,
        guards,
    })
}

/// The guards of a plan.
fn guards_of(plan: &[u8]) -> Result<Option<GuardFacts>, CompileError> {
    GuardFacts::of_plan(plan).map_err(|error| CompileError::Guards { reason: error.to_string() })
}

// What stands behind the weights of a policy's plan for hosts and people: names, sizes, roles and metadata.
//
// The executor ignores bytes behind the weights, so that a plan without its annex decides alike.

const MAGIC: [u8; 8] = *b"SORTIEAX";
/// The most bytes that metadata of a source may have, one entry's name and text.
const ENTRY: usize = 65_536;

/// What is known of a policy beside its plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Annex {
    /// Inputs, outputs and states, in the plan's order.
    pub facts: PolicyFacts,
    /// Metadata of the source, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub metadata: BTreeMap<String, String>,
    /// How a plan of few bits acts beside the exact one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<PolicyAgreement>,
}

impl Annex {
    /// Entries of metadata that are longer than 64 KiB are left out: they are no names.
    pub fn new(
        mut facts: PolicyFacts,
        metadata: impl IntoIterator<Item = (String, String)>,
    ) -> Self {
        facts.inputs.iter_mut().for_each(|input| input.normals.clear());
        let is_short = |(name, text): &(String, String)| name.len() + text.len() <= ENTRY;
        let metadata = metadata.into_iter().filter(is_short).collect();
        Self { facts, metadata, agreement: None }
    }

    /// Writes it behind a plan that has none.
    ///
    /// # Errors
    /// It is longer than a plan can say.
    pub fn append_to(&self, plan: &mut Vec<u8>) -> Result<(), CompileError> {
        let text = serde_json::to_vec(self).map_err(|error| broken(&error.to_string()))?;
        let length = u32::try_from(text.len()).map_err(|_| broken("it is too long"))?;
        plan.extend_from_slice(&MAGIC);
        plan.extend_from_slice(&length.to_le_bytes());
        plan.extend_from_slice(&crc32c(&text).to_le_bytes());
        plan.extend_from_slice(&text);
        Ok(())
    }

    /// Writes it behind a plan in place of the one that it has.
    ///
    /// # Errors
    /// The plan has no header, or this is longer than a plan can say.
    pub fn replace_in(&self, plan: &mut Vec<u8>) -> Result<(), CompileError> {
        let end = weights_end(plan)?.min(plan.len());
        let behind = plan.split_off(end);
        self.append_to(plan)?;
        // What stands behind the annex stays there.
        let kept = match behind.strip_prefix(&MAGIC) {
            Some(annex) => text(annex).and_then(|text| annex.get(8 + text.len()..)),
            None => Some(behind.as_slice()),
        };
        plan.extend_from_slice(kept.unwrap_or_default());
        Ok(())
    }

    /// The annex of a plan; `None` where nothing of the kind stands behind its weights.
    ///
    /// # Errors
    /// The plan has no header, or its annex is cut off or changed.
    pub fn of_plan(plan: &[u8]) -> Result<Option<Self>, CompileError> {
        let end = weights_end(plan)?;
        let Some((magic, rest)) = plan.get(end..).and_then(|rest| rest.split_first_chunk()) else {
            return Ok(None);
        };
        if *magic != MAGIC {
            return Ok(None);
        }
        let text = text(rest).ok_or_else(|| broken("it is cut off or changed"))?;
        let annex: Self =
            serde_json::from_slice(text).map_err(|error| broken(&error.to_string()))?;
        Ok(Some(annex))
    }
}

/// Where the weights of a plan end.
fn weights_end(plan: &[u8]) -> Result<usize, CompileError> {
    let (header, _) = Header::read(plan)?;
    Ok((header.weights_offset as usize).saturating_add(header.weights_len as usize))
}

/// The text behind the magic, where it is whole.
fn text(rest: &[u8]) -> Option<&[u8]> {
    let (length, rest) = rest.split_first_chunk()?;
    let (checksum, rest) = rest.split_first_chunk()?;
    let text = rest.get(..u32::from_le_bytes(*length) as usize)?;
    (crc32c(text) == u32::from_le_bytes(*checksum)).then_some(text)
}

fn broken(reason: &str) -> CompileError {
    CompileError::Annex { reason: reason.to_owned() }
}

#[cfg(test)]
mod tests {
    use sortie_core::plan::{GuardedSizes, HEADER_BYTES, VERSION};

    use super::*;
    use crate::policy::{InputRole, OutputRole, PolicyInput, PolicyOutput, ValueType};

    /// Only the header of a plan: nothing else is looked at.
    fn plan() -> Vec<u8> {
        let mut plan = include_bytes!("../../../tests/golden/plans/policy-2.0.plan").to_vec();
        assert_eq!(plan[8], VERSION.0 as u8);
        assert!(plan.len() > HEADER_BYTES);
        let (header, _) = Header::read(&plan).expect("a plan");
        plan.truncate((header.weights_offset + header.weights_len) as usize);
        plan
    }

    fn annex() -> Annex {
        let input = PolicyInput {
            name: "obs".into(),
            kind: ValueType::F32,
            shape: vec![1, 8],
            role: InputRole::Observation,
            normals: Vec::new(),
        };
        let output = PolicyOutput {
            name: "logits".into(),
            kind: ValueType::F32,
            shape: vec![1, 5],
            role: OutputRole::Discrete(5),
        };
        let facts = PolicyFacts {
            inputs: vec![input],
            outputs: vec![output],
            states: Vec::new(),
            operators: BTreeMap::new(),
            parameters: 45,
            multiply_adds: Some(40),
        };
        let long = ("weights".to_owned(), "x".repeat(ENTRY));
        Annex::new(facts, [("joint_names".to_owned(), "hip,knee".to_owned()), long])
    }

    #[test]
    fn what_is_written_behind_a_plan_is_read_again() {
        let (mut plan, annex) = (plan(), annex());
        assert_eq!(Annex::of_plan(&plan).expect("a plan"), None);
        annex.append_to(&mut plan).expect("short enough");
        assert_eq!(annex.metadata.keys().collect::<Vec<_>>(), ["joint_names"]);
        assert_eq!(Annex::of_plan(&plan).expect("whole"), Some(annex));
    }

    #[test]
    fn another_annex_stands_in_place_of_the_first() {
        let (mut plan, first) = (plan(), annex());
        first.append_to(&mut plan).expect("short enough");
        let robot = RobotFacts { joint_names: vec!["hip".to_owned()], ..RobotFacts::default() };
        robot.append_to(&mut plan);
        let guards = GuardFacts { age_ms: Some(20.0), ..GuardFacts::default() };
        let sizes = GuardedSizes { inputs: 8, outputs: 5, chooses: true };
        guards.append_to(&mut plan, &sizes).expect("no flaw");
        let length = plan.len();
        let agreement = PolicyAgreement { observations: 3, outputs: Vec::new() };
        let second = Annex { agreement: Some(agreement), ..first.clone() };
        second.replace_in(&mut plan).expect("short enough");
        assert_eq!(Annex::of_plan(&plan).expect("whole"), Some(second));
        first.replace_in(&mut plan).expect("short enough");
        assert_eq!((plan.len(), RobotFacts::of_plan(&plan)), (length, Some(robot)));
        assert_eq!(GuardFacts::of_plan(&plan), Ok(Some(guards)));
    }

    #[test]
    fn an_annex_that_is_cut_off_or_changed_is_refused() {
        let mut plan = plan();
        let end = plan.len();
        annex().append_to(&mut plan).expect("short enough");
        for length in end + MAGIC.len()..plan.len() {
            assert!(matches!(Annex::of_plan(&plan[..length]), Err(CompileError::Annex { .. })));
        }
        for place in end + MAGIC.len()..plan.len() {
            let mut changed = plan.clone();
            changed[place] ^= 1;
            assert!(matches!(Annex::of_plan(&changed), Err(CompileError::Annex { .. })), "{place}");
        }
    }

    #[test]
    fn other_bytes_behind_a_plan_are_no_annex() {
        let mut plan = plan();
        plan.extend_from_slice(b"SORTIEBX and more");
        assert_eq!(Annex::of_plan(&plan).expect("a plan"), None);
    }
}
