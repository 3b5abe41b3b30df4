//! A run of any method becomes a bundle: networks, contract, golden observations, card and curve.

mod card;
mod golden;

use std::collections::BTreeMap;
use std::path::Path;

use sortie_bundle::files::{MOST_BYTES, read_file};
use sortie_bundle::{
    AGENT, ALLOCATOR, AgentGraph, CARD, CONTRACT_ABI, CURVE, CURVE_DATA, ContractV1, Draft,
    Environment as Described, FallbackAllocation, GoldenCase, Limits, Network, OPTION_GRAPHS,
    OPTIONS, POINTING, POINTING_PARTS, POLICY, POLICY_ROLES, PROPOSAL_PARTS, PROPOSALS,
    PointingContract, PolicyRoles, SubtaskConditioning, TEAM_VALUE, TRAINING,
};
use sortie_envs::{Environment, Shape, Spec, Split};

use self::golden::golden;
use crate::error::{LearnError, Result};
use crate::export::{
    AGENT_NUMBER, AgentNetwork, DeployedAgents, DeployedNetworks, ExportError, OwnRowNetworks,
    RecurrentAgent, TeamValueExport, agent_onnx, recurrent_agent_onnx, team_value_onnx,
};
use crate::method::Method;
use crate::random::{Purpose, generator};
use crate::run::{CurvePoint, RunDescription};
use crate::subtasks::{AllocatorNetworks, LearnedAllocator};

pub use card::{Measured, measured_table};
pub use golden::{DecoratedPolicy, EPISODES, Recorder};

/// A run of any method, as far as its bundle needs it.
pub struct MethodRun<'a> {
    /// How it learned.
    pub description: &'a RunDescription,
    /// Where it learned.
    pub environment: &'a dyn Environment,
    /// What has learned.
    pub method: &'a dyn Method,
    /// Its evaluations.
    pub curve: &'a [CurvePoint],
}

/// Makes a bundle of what the run in `folder` has learned; `sizes` are those of all environments that it is to serve.
///
/// # Errors
/// The agents cannot be deployed, files of the run cannot be read, or the network is not finite.
pub fn draft_method(
    run: &MethodRun<'_>,
    folder: &Path,
    sizes: &[Shape],
    measured: &[Measured],
    seed: u64,
) -> Result<Draft> {
    let spec = run.environment.spec();
    let DeployedAgents { networks, mut policy } = run.method.deployed()?;
    let subtasks = run.method.subtasks();
    let mut contract = contract(spec, networks.take_last_actions(spec.shape.features));
    if let Some(subtasks) = &subtasks {
        contract.decision_interval = subtasks.interval;
        contract.subtask_conditioning = SubtaskConditioning::Mask;
    }
    let diverged = |error| LearnError::format(folder, error);
    let (mut network, mut parts) = networks.to_parts(spec, &contract).map_err(diverged)?;
    let (mut limits, allocator) =
        (limits(sizes), subtasks.as_ref().and_then(|it| it.allocator.as_ref()));
    if let Some(allocator) = allocator {
        let written = allocator_parts(allocator, (spec, limits), contract.hash());
        let (kind, graphs) = written.map_err(diverged)?;
        parts.extend(graphs);
        network.allocator = Some(kind.to_owned());
        if matches!(allocator.networks, AllocatorNetworks::Pointing(_)) {
            network.pointing = Some(pointing(run.environment));
        }
        let team_max = allocator.team_max.and_then(|most| most.try_into().ok());
        limits.team_max = limits.team_max.min(team_max.unwrap_or(u16::MAX));
    }
    let golden = golden(run, &networks, &mut *policy, seed)?;
    parts.extend([
        (CARD.to_owned(), card::card(run, measured, &networks).into_bytes()),
        (CURVE.to_owned(), read_part(folder, CURVE)?),
        (CURVE_DATA.to_owned(), read_part(folder, CURVE_DATA)?),
        (TRAINING.to_owned(), read_part(folder, TRAINING)?),
    ]);
    Ok(Draft {
        environment: described(run.description.config.environment.to_string(), spec, &golden.cases),
        limits,
        network,
        golden,
        contract,
        parts,
    })
}

/// What an allocator that points can give in an environment.
fn pointing(environment: &dyn Environment) -> PointingContract {
    let mut world = environment.open(1, Split::Train);
    world.reset(0, &mut generator(0, Purpose::Evaluation, 0));
    let (mut state, mut offers) = (Vec::new(), Vec::new());
    world.save(0, &mut state);
    let exclusive = world.offers(&state, &mut offers);
    let shape = world.spec().shape;
    PointingContract {
        exclusive: (0..32).filter(|task| exclusive >> task & 1 == 1).collect(),
        first_action: (shape.actions - shape.tasks) as u16,
    }
}

/// Graphs of networks, and what is said of their inputs where that must be, by their names in a bundle.
type Parts = BTreeMap<String, Vec<u8>>;

/// What an allocator decides by: its kind and its graphs.
fn allocator_parts(
    allocator: &LearnedAllocator<'_>,
    (spec, limits): (&Spec, Limits),
    contract: u64,
) -> Result<(&'static str, Parts), ExportError> {
    Ok(match &allocator.networks {
        AllocatorNetworks::TeamValue(layers) => {
            let (features, relations) = (spec.shape.features, spec.relations);
            let network = TeamValueExport { features, relations, contract, layers: **layers };
            (TEAM_VALUE, [(ALLOCATOR.to_owned(), team_value_onnx(&network)?)].into())
        }
        AllocatorNetworks::Proposals(write) => {
            let names = PROPOSAL_PARTS.map(str::to_owned);
            (PROPOSALS, names.into_iter().zip(write(contract)?).collect())
        }
        AllocatorNetworks::Pointing(write) => {
            let names = POINTING_PARTS.map(str::to_owned);
            let graphs = write([limits.team_max.into(), limits.t_max.into()], contract)?;
            (POINTING, names.into_iter().zip(graphs).collect())
        }
    })
}

impl DeployedNetworks<'_> {
    /// Whether rows hold last actions besides so many features.
    fn take_last_actions(&self, features: usize) -> bool {
        matches!(self, Self::Attention { network, .. } if network.inputs != features)
    }

    fn to_parts(
        &self,
        spec: &Spec,
        contract: &ContractV1,
    ) -> Result<(Network, Parts), ExportError> {
        match self {
            Self::Attention { network: layers, memory } => {
                let agent = AgentNetwork {
                    features: contract.features.into(),
                    append_last_action: contract.append_last_action,
                    contract: contract.hash(),
                    layers: *layers,
                };
                let hidden = memory.map_or(0, |_| layers.base as u32);
                let onnx = match *memory {
                    Some(gru) => {
                        recurrent_agent_onnx(&RecurrentAgent { agent, attention_relu: false, gru })
                    }
                    None => agent_onnx(&agent),
                }?;
                let agent = "masked-attention".to_owned();
                let network = Network { agent, hidden, ..Network::default() };
                Ok((network, [(AGENT.to_owned(), onnx)].into()))
            }
            Self::OwnRow(networks) => own_row_parts(networks, spec, contract),
            Self::Options { options, graphs } => {
                let (agent, options) = (OPTIONS.to_owned(), Some(options.clone()));
                let network = Network { agent, options, ..Network::default() };
                let names = OPTION_GRAPHS.map(|name| AgentGraph::part_of(name, AGENT));
                let parts = names.into_iter().zip(graphs.to_onnx(contract.hash())?).collect();
                Ok((network, parts))
            }
            Self::Lookup(tables) => {
                let network = Network { agent: POLICY.to_owned(), ..Network::default() };
                let onnx = tables.to_onnx(contract.hash())?;
                let parts = [(AGENT.to_owned(), onnx), told_number()].into();
                Ok((network, parts))
            }
        }
    }

    fn about(&self) -> &'static str {
        match self {
            Self::Attention { .. } => {
                "Every agent runs the same attention network over the entities that it observes."
            }
            Self::OwnRow(_) => {
                "Every agent decides by its own row alone, by the network that `bundle.toml` names for it."
            }
            Self::Options { .. } => {
                "The agent chooses which milestone to go for among those that it believes it can reach, and goes for it."
            }
            Self::Lookup(_) => "Every agent looks up in a table of its own what to do where it is.",
        }
    }
}

/// A graph for each network; `agent.onnx` where all decide by one.
fn own_row_parts(
    networks: &OwnRowNetworks,
    spec: &Spec,
    contract: &ContractV1,
) -> Result<(Network, Parts), ExportError> {
    let mut network = Network { agent: POLICY.to_owned(), ..Network::default() };
    let mut parts = BTreeMap::new();
    for (index, own) in networks.networks.iter().enumerate() {
        let [features, actions] = [own.features, own.actions()].map(|size| size as u16);
        let graph =
            AgentGraph { name: graph_name(&networks.agents(index), spec), features, actions };
        parts.insert(graph.onnx_part(), networks.to_onnx(index, contract.hash())?);
        network.graphs.push(graph);
    }
    if networks.networks.len() == 1 {
        network.graphs.clear();
    } else {
        network.graph_of = networks.network_of.iter().map(|network| *network as u16).collect();
    }
    if networks.told_number() {
        parts.extend([told_number()]);
    }
    Ok((network, parts))
}

/// What says that graphs are told the agent's number.
fn told_number() -> (String, Vec<u8>) {
    let own = Some(AGENT_NUMBER.to_owned());
    let roles = PolicyRoles { own, ..PolicyRoles::default() };
    (POLICY_ROLES.to_owned(), roles.to_toml().into_bytes())
}

/// What the graph of these agents is named by: nothing where all decide by it, else their role, or the only one's number.
fn graph_name(agents: &[usize], spec: &Spec) -> String {
    if agents.len() == spec.shape.agents {
        return String::new();
    }
    let mut roles = spec.roles.iter();
    match (roles.find(|role| agents.iter().copied().eq(role.agents.clone())), agents) {
        (None, [agent, ..]) => agent.to_string(),
        (role, _) => role.map_or(String::new(), |role| role.name.to_owned()),
    }
}

/// The contract of agents that know of no subtasks.
pub fn contract(spec: &Spec, append_last_action: bool) -> ContractV1 {
    ContractV1 {
        abi: CONTRACT_ABI,
        actions: spec.shape.actions as u16,
        features: spec.shape.features as u16,
        feature_names: spec.features.clone(),
        action_names: spec.actions.clone(),
        decision_interval: 1,
        append_last_action,
        subtask_conditioning: SubtaskConditioning::None,
        subtask_actions: false,
        safe_action: spec.safe_action,
        fallback_allocation: FallbackAllocation::Unallocated,
    }
}

/// The environment, with the ranges of features that golden observations have shown.
pub fn described(name: String, spec: &Spec, cases: &[GoldenCase]) -> Described {
    let columns = spec.shape.features;
    let mut ranges = vec![[0.0f32, 0.0]; columns];
    for row in cases.iter().flat_map(|case| case.observation.rows.chunks_exact(columns)) {
        for (range, value) in ranges.iter_mut().zip(row) {
            *range = [range[0].min(*value), range[1].max(*value)];
        }
    }
    let unit = |column| spec.units.get(column).map_or("1", |unit| *unit).to_owned();
    Described {
        name,
        version: spec.version.to_owned(),
        feature_units: (0..columns).map(unit).collect(),
        feature_ranges: ranges,
    }
}

/// The sizes of all environments that a bundle is to serve; a team may be as large as all agents.
pub fn limits(sizes: &[Shape]) -> Limits {
    let most = |size: fn(&Shape) -> usize| sizes.iter().map(size).max().unwrap_or(0) as u16;
    Limits {
        n_max: most(|shape| shape.entities),
        t_max: most(|shape| shape.tasks),
        team_max: most(|shape| shape.agents),
    }
}

/// A file of a run that becomes part of its bundle.
pub fn read_part(folder: &Path, name: &str) -> Result<Vec<u8>> {
    let path = folder.join(name);
    read_file(&path, MOST_BYTES).map_err(LearnError::file(path))
}
