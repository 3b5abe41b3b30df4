//! A run becomes a bundle: contract, network, golden observations, card and curve.

use std::collections::BTreeMap;
use std::path::Path;

use sortie_bundle::{
    AGENT, ALLOCATOR, CARD, CURVE, CURVE_DATA, ContractV1, Draft, Environment, FallbackAllocation,
    Golden, Limits, Network, PROPOSAL_PARTS, PROPOSALS, SubtaskConditioning, TEAM_VALUE, TRAINING,
    WIRE_ABI,
};
use sortie_core::Policy;
use sortie_envs::save_the_city::{
    ACTION_NAMES, ACTIONS, FEATURE_NAMES, FEATURES, RELATIONS, ScenarioSet, VERSION,
};

use super::card::card;
use super::golden_allocations::golden_allocations;
use super::learned::LearnedAllocator;
use super::proposals::{ProposalGraphs, export_proposals};
use crate::alma::agents::{Conditioning, NetworkPolicy, UtilityWeights};
use crate::alma::evaluate::{EvaluationPlan, evaluate};
use crate::alma::run::{Run, RunAllocator};
use crate::alma::teams::{Allocation, PolicyTeam};
use sortie_learn::LearnError;
use sortie_learn::draft::{Measured, Recorder, read_part};
use sortie_learn::export::attention::{AttentionNetwork, ExportError, Layer, Layout, Matrix};
use sortie_learn::export::{AgentNetwork, TeamValueExport, agent_onnx, team_value_onnx};

/// Episodes that golden observations are drawn from; they end sooner than all are needed.
const GOLDEN_EPISODES: usize = 100;
/// Action 0 is to stay, which is always available.
const SAFE_ACTION: u16 = 0;

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
    run: &Run,
    folder: &Path,
    measured: &[Measured],
    seed: u64,
) -> Result<Draft, LearnError> {
    check_exportable(run)?;
    let allocator = LearnedAllocator::of(run);
    let contract = contract(run.config.interval());
    let diverged = |error: ExportError| LearnError::format(folder, error);
    let agent = agent(&run.network.weights(), contract.hash()).map_err(diverged)?;
    let mut parts = BTreeMap::from([
        (AGENT.to_owned(), agent),
        (CARD.to_owned(), card(run, allocator, measured).into_bytes()),
        (CURVE.to_owned(), read_part(folder, CURVE)?),
        (CURVE_DATA.to_owned(), read_part(folder, CURVE_DATA)?),
        (TRAINING.to_owned(), read_part(folder, TRAINING)?),
    ]);
    let kind = match &run.allocator {
        Some(RunAllocator::TeamValue(network)) => {
            let onnx = team_value(&network.weights(), contract.hash()).map_err(diverged)?;
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
    Ok(Draft {
        environment: environment(run),
        limits: limits(run, allocator, measured)?,
        network: Network {
            agent: "masked-attention".to_owned(),
            allocator: kind.map(str::to_owned),
            hidden: 0,
        },
        golden: golden(run, allocator, seed)?,
        contract,
        parts,
    })
}

fn contract(decision_interval: u32) -> ContractV1 {
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    ContractV1 {
        abi: WIRE_ABI,
        actions: ACTIONS as u16,
        features: FEATURES as u16,
        feature_names: names(&FEATURE_NAMES),
        action_names: names(&ACTION_NAMES),
        decision_interval,
        append_last_action: true,
        subtask_conditioning: SubtaskConditioning::Mask,
        subtask_actions: false,
        safe_action: Some(SAFE_ACTION),
        fallback_allocation: FallbackAllocation::Unallocated,
    }
}

fn environment(run: &Run) -> Environment {
    let unit = |name: &&str| match *name {
        "x-scaled" | "y-scaled" => "sides of the map",
        "health" | "fire" => "share of full",
        "since-last-fire" => "ignition periods",
        "ignition-rate" => "share of the fastest",
        _ => "flag",
    };
    Environment {
        name: run.description.config.environment.to_string(),
        version: VERSION.to_owned(),
        feature_units: FEATURE_NAMES.iter().map(|name| unit(name).to_owned()).collect(),
        feature_ranges: vec![[0.0, 1.0]; FEATURES],
    }
}

/// Sizes of the set that the run learned on and of all sets that it was measured on.
fn limits(
    run: &Run,
    allocator: Option<LearnedAllocator<'_>>,
    measured: &[Measured],
) -> Result<Limits, LearnError> {
    let (mut agents, mut buildings) = (0, 0);
    let learned_on = &run.description.config.environment.set;
    for name in measured.iter().map(|measured| &measured.set).chain([learned_on]) {
        let set = ScenarioSet::named(name).map_err(LearnError::environment)?;
        (agents, buildings) = (set.max_agents.max(agents), set.max_buildings.max(buildings));
    }
    let team_max = allocator.map_or(agents, |learned| learned.team_max.min(agents));
    Ok(Limits {
        n_max: (agents + buildings) as u16,
        t_max: buildings as u16,
        team_max: team_max as u16,
    })
}

/// The agents' network as ONNX.
fn agent(weights: &UtilityWeights, contract: u64) -> Result<Vec<u8>, ExportError> {
    let layers = layers(weights);
    agent_onnx(&AgentNetwork { features: FEATURES, append_last_action: true, contract, layers })
}

/// The allocator's network as ONNX.
fn team_value(weights: &UtilityWeights, contract: u64) -> Result<Vec<u8>, ExportError> {
    let (features, relations, layers) = (FEATURES, RELATIONS, layers(weights));
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
    allocator: Option<LearnedAllocator<'_>>,
    seed: u64,
) -> Result<Golden, LearnError> {
    let config = &run.config;
    let environment = config.environment().open()?;
    let plan = EvaluationPlan {
        interval: config.interval(),
        ..EvaluationPlan::new(&environment, GOLDEN_EPISODES, seed)
    };
    let allocations = match allocator {
        Some(allocator) => golden_allocations(&plan, &run.network, allocator)?,
        None => Vec::new(),
    };
    let mut recorder = Recorder::new(NetworkPolicy::new(&run.network), FEATURES);
    let mut team = PolicyTeam::new(&mut recorder as &mut dyn Policy);
    evaluate(&plan, &mut team, &mut Allocation::Coordinated.allocator())?;
    Ok(Golden { cases: recorder.cases, allocations })
}
