//! A run becomes a bundle: contract, network, golden observations, card and curve.

use std::collections::BTreeMap;
use std::path::Path;

use sortie_bundle::{
    AGENT, ALLOCATOR, CARD, CURVE, CURVE_DATA, ContractV1, Draft, Golden, Limits, Network,
    PROPOSAL_PARTS, PROPOSALS, SubtaskConditioning, TEAM_VALUE, TRAINING,
};
use sortie_core::Policy;
use sortie_envs::{Environment, Shape, Spec};

use super::card::card;
use super::golden_allocations::golden_allocations;
use super::learned::LearnedAllocator;
use super::proposals::{ProposalGraphs, export_proposals};
use crate::alma::agents::{Conditioning, NetworkPolicy, UtilityWeights};
use crate::alma::evaluate::{EvaluationPlan, evaluate};
use crate::alma::run::{Run, RunAllocator};
use crate::alma::teams::{Allocation, PolicyTeam};
use sortie_learn::LearnError;
use sortie_learn::draft::{self, Measured, Recorder, described, read_part};
use sortie_learn::export::attention::{AttentionNetwork, ExportError, Layer, Layout, Matrix};
use sortie_learn::export::{AgentNetwork, TeamValueExport, agent_onnx, team_value_onnx};

/// Episodes that golden observations are drawn from; they end sooner than all are needed.
const GOLDEN_EPISODES: usize = 100;

/// Refuses runs whose agents need more than what a deployed agent is shown.
///
/// # Errors
/// The agents are not conditioned on subtasks by masks, or have a memory.
pub fn check_exportable(run: &Run) -> Result<(), LearnError> {
    if let Some(coach) = &run.coach {
        let numbers = coach.shape().strategy;
        return Err(LearnError::Config(format!(
            "agents with a coach are evaluated only: deployed they would need the coach, which sees \
             everything, and a message of {numbers} numbers from it to each of them"
        )));
    }
    let conditioning = run.config.subtask();
    if !run.memory_unit.is_empty() {
        let reason =
            "agents with a memory are evaluated only: teams of processes keep no memories yet";
        return Err(LearnError::Config(reason.to_owned()));
    }
    if conditioning == Conditioning::Mask {
        return Ok(());
    }
    let conditioning = conditioning.name();
    Err(LearnError::Config(format!(
        "agents with `network.subtask = \"{conditioning}\"` are evaluated only: bundles hold agents that see their \
         own subtask (`network.subtask=mask`)"
    )))
}

/// Makes a bundle of the averaged weights of the run in `folder`, with its allocator where it has one.
///
/// # Errors
/// The run is not [deployable](check_exportable), its files cannot be read, or its network is not finite.
pub fn draft_bundle(
    (run, environment): (&Run, &dyn Environment),
    folder: &Path,
    sizes: &[Shape],
    measured: &[Measured],
    seed: u64,
) -> Result<Draft, LearnError> {
    check_exportable(run)?;
    let allocator = LearnedAllocator::of(run);
    let spec = environment.spec();
    let contract = contract(spec, run.config.interval());
    let golden = golden(run, environment, allocator, seed)?;
    let diverged = |error: ExportError| LearnError::format(folder, error);
    let agent = agent(spec, &run.network.weights(), contract.hash()).map_err(diverged)?;
    let mut parts = BTreeMap::from([
        (AGENT.to_owned(), agent),
        (CARD.to_owned(), card(run, allocator, measured).into_bytes()),
        (CURVE.to_owned(), read_part(folder, CURVE)?),
        (CURVE_DATA.to_owned(), read_part(folder, CURVE_DATA)?),
        (TRAINING.to_owned(), read_part(folder, TRAINING)?),
    ]);
    let kind = match &run.allocator {
        Some(RunAllocator::TeamValue(network)) => {
            let onnx = team_value(spec, &network.weights(), contract.hash()).map_err(diverged)?;
            parts.insert(ALLOCATOR.to_owned(), onnx);
            Some(TEAM_VALUE)
        }
        Some(RunAllocator::Proposals { policy, critic }) => {
            let graphs = export_proposals(&policy.weights(), &critic.weights(), contract.hash());
            let ProposalGraphs { trunk, step, critic } = graphs.map_err(diverged)?;
            let names = PROPOSAL_PARTS.map(str::to_owned);
            parts.extend(names.into_iter().zip([trunk, step, critic]));
            Some(PROPOSALS)
        }
        None => None,
    };
    let name = run.description.config.environment.to_string();
    Ok(Draft {
        environment: described(name, spec, &golden.cases),
        limits: limits(allocator, sizes),
        network: Network {
            agent: "masked-attention".to_owned(),
            allocator: kind.map(str::to_owned),
            ..Network::default()
        },
        golden,
        contract,
        parts,
    })
}

/// The contract of agents that see their own subtask.
fn contract(spec: &Spec, decision_interval: u32) -> ContractV1 {
    let subtask_conditioning = SubtaskConditioning::Mask;
    ContractV1 { decision_interval, subtask_conditioning, ..draft::contract(spec, true) }
}

/// Sizes of all environments that the bundle is to serve.
fn limits(allocator: Option<LearnedAllocator<'_>>, sizes: &[Shape]) -> Limits {
    let limits = draft::limits(sizes);
    let team_max = allocator.map_or(usize::MAX, |learned| learned.team_max);
    Limits { team_max: limits.team_max.min(team_max.try_into().unwrap_or(u16::MAX)), ..limits }
}

/// The agents' network as ONNX.
fn agent(spec: &Spec, weights: &UtilityWeights, contract: u64) -> Result<Vec<u8>, ExportError> {
    let (features, layers) = (spec.shape.features, layers(weights));
    agent_onnx(&AgentNetwork { features, append_last_action: true, contract, layers })
}

/// The allocator's network as ONNX.
fn team_value(
    spec: &Spec,
    weights: &UtilityWeights,
    contract: u64,
) -> Result<Vec<u8>, ExportError> {
    let (features, relations, layers) = (spec.shape.features, spec.relations, layers(weights));
    team_value_onnx(&TeamValueExport { features, relations, contract, layers })
}

/// The layers of a network.
pub(super) fn layers(weights: &UtilityWeights) -> AttentionNetwork<'_> {
    let matrix = |values| Matrix { values, layout: Layout::OutputsFirst };
    let shape = weights.shape;
    AttentionNetwork {
        inputs: shape.input,
        width: shape.width,
        heads: shape.heads,
        base: shape.base,
        outputs: shape.actions,
        fc1: Layer { weight: matrix(&weights.fc1_weight), bias: &weights.fc1_bias },
        attention_in: matrix(&weights.attention_in_weight),
        attention_out: Layer {
            weight: matrix(&weights.attention_out_weight),
            bias: &weights.attention_out_bias,
        },
        skip: shape.skip.then(|| matrix(&weights.skip_weight)),
        fc2: Some(Layer { weight: matrix(&weights.fc2_weight), bias: &weights.fc2_bias }),
        head: Layer { weight: matrix(&weights.head_weight), bias: &weights.head_bias },
    }
}

/// Observations and allocation states of greedy episodes, with the answers of the trainer's own passes.
fn golden(
    run: &Run,
    environment: &dyn Environment,
    allocator: Option<LearnedAllocator<'_>>,
    seed: u64,
) -> Result<Golden, LearnError> {
    let config = &run.config;
    let plan = EvaluationPlan {
        interval: config.interval(),
        ..EvaluationPlan::new(environment, GOLDEN_EPISODES, seed)
    };
    let allocations = match allocator {
        Some(allocator) => golden_allocations(&plan, &run.network, allocator)?,
        None => Vec::new(),
    };
    let mut recorder =
        Recorder::new(NetworkPolicy::new(&run.network), environment.spec().shape.features);
    let mut team = PolicyTeam::new(&mut recorder as &mut dyn Policy);
    evaluate(&plan, &mut team, &mut Allocation::Coordinated.allocator())?;
    Ok(Golden { cases: recorder.cases, allocations, ..Golden::default() })
}
