//! A run of any method becomes a bundle: networks, contract, golden observations, card and curve.

mod recorder;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use sortie_bundle::files::{MOST_BYTES, read_file};
use sortie_bundle::{
    AGENT, AgentGraph, CARD, CONTRACT_ABI, CURVE, CURVE_DATA, ContractV1, Draft,
    Environment as Described, FallbackAllocation, Golden, GoldenCase, Limits, Network,
    OPTION_GRAPHS, OPTIONS, POLICY, POLICY_ROLES, PolicyRoles, SubtaskConditioning, TRAINING,
};
use sortie_envs::{Environment, Shape, Spec};

use crate::error::LearnError;
use crate::evaluate::Evaluation;
use crate::export::{
    AGENT_NUMBER, AgentNetwork, DeployedAgents, DeployedNetworks, ExportError, OwnRowNetworks,
    RecurrentAgent, agent_onnx, recurrent_agent_onnx,
};
use crate::method::Method;
use crate::play::{PolicyTeam, evaluate};
use crate::run::{CurvePoint, RunDescription};

pub use recorder::{EpisodeRecorder, Recorder};

/// Episodes that golden observations are drawn from.
const GOLDEN_EPISODES: usize = 400;
/// The same of agents that run options, whose episodes are long.
const OPTION_CASES: usize = 30;
/// Episodes that are golden as a whole, where agents run options.
const WHOLE_EPISODES: u64 = 3;

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
) -> Result<Draft, LearnError> {
    let spec = run.environment.spec();
    let DeployedAgents { networks, mut policy } = run.method.deployed()?;
    let contract = contract(spec, networks.take_last_actions(spec.shape.features));
    let agents =
        networks.to_parts(spec, &contract).map_err(|error| LearnError::format(folder, error))?;
    let runs_options = matches!(networks, DeployedNetworks::Options { .. });
    let mut team = PolicyTeam::new(Recorder::new(&mut *policy, spec.shape.features));
    let episodes = if runs_options { OPTION_CASES } else { GOLDEN_EPISODES };
    evaluate(run.environment, &mut team, episodes, seed)?;
    let mut golden = Golden { cases: team.into_policy().cases, ..Golden::default() };
    for index in 0..if runs_options { WHOLE_EPISODES } else { 0 } {
        let mut team = PolicyTeam::new(EpisodeRecorder::new(&mut *policy));
        evaluate(run.environment, &mut team, 1, seed.wrapping_add(index))?;
        golden.episodes.push(team.into_policy().episode);
    }
    let mut parts = BTreeMap::from([
        (CARD.to_owned(), card(run, measured, &networks).into_bytes()),
        (CURVE.to_owned(), read_part(folder, CURVE)?),
        (CURVE_DATA.to_owned(), read_part(folder, CURVE_DATA)?),
        (TRAINING.to_owned(), read_part(folder, TRAINING)?),
    ]);
    parts.extend(agents.parts);
    Ok(Draft {
        environment: described(run.description.config.environment.to_string(), spec, &golden.cases),
        limits: limits(sizes),
        network: agents.network,
        golden,
        contract,
        parts,
    })
}

/// What a bundle holds of its agents' networks.
struct AgentParts {
    network: Network,
    /// The graphs, and what is said of their inputs where that must be.
    parts: BTreeMap<String, Vec<u8>>,
}

impl DeployedNetworks<'_> {
    /// Whether rows hold last actions besides so many features.
    fn take_last_actions(&self, features: usize) -> bool {
        matches!(self, Self::Attention { network, .. } if network.inputs != features)
    }

    fn to_parts(&self, spec: &Spec, contract: &ContractV1) -> Result<AgentParts, ExportError> {
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
                Ok(AgentParts { network, parts: [(AGENT.to_owned(), onnx)].into() })
            }
            Self::OwnRow(networks) => own_row_parts(networks, spec, contract),
            Self::Options { options, graphs } => {
                let (agent, options) = (OPTIONS.to_owned(), Some(options.clone()));
                let network = Network { agent, options, ..Network::default() };
                let names = OPTION_GRAPHS.map(|name| AgentGraph::part_of(name, AGENT));
                let parts = names.into_iter().zip(graphs.to_onnx(contract.hash())?).collect();
                Ok(AgentParts { network, parts })
            }
            Self::Lookup(tables) => {
                let network = Network { agent: POLICY.to_owned(), ..Network::default() };
                let onnx = tables.to_onnx(contract.hash())?;
                let parts = [(AGENT.to_owned(), onnx), told_number()].into();
                Ok(AgentParts { network, parts })
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
) -> Result<AgentParts, ExportError> {
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
    Ok(AgentParts { network, parts })
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

/// The model card.
fn card(run: &MethodRun<'_>, measured: &[Measured], networks: &DeployedNetworks<'_>) -> String {
    let RunDescription { seed, version, config, .. } = run.description;
    let method = &config.method;
    let mut card = format!(
        "# A team for {}\n\n\
         {} Trained by\n\
         `sortie train {method}`, seed {seed}, Sortie {version}; `train.toml` repeats the run.\n\n\
         ## How well it does\n\n\
         {} that training never saw. The interval is that of the episodes, not of training again.\n\n",
        config.environment,
        networks.about(),
        if matches!(networks, DeployedNetworks::Options { .. }) {
            "Episodes"
        } else {
            "Greedy episodes"
        },
    );
    card += &measured_table(measured);
    if let Some(last) = run.curve.last() {
        let _ = writeln!(
            card,
            "\nTraining took {} environment steps, {:.0} seconds of processor time and {:.0} seconds.",
            last.env_steps, last.cpu_s, last.wall_s
        );
    }
    let _ = writeln!(
        card,
        "\nMatrix products were computed with `{}`: `--set run.products={0}` repeats the run byte for byte.",
        config.run.products
    );
    if let DeployedNetworks::Options { options, .. } = networks {
        let _ = writeln!(
            card,
            "\n{:.0} % of its actions are drawn, and {:.0} % of its goals, from the seed {} that `bundle.toml` states: the \
             same episode is the same again.",
            100.0 * options.action_chance,
            100.0 * options.goal_chance,
            options.seed
        );
    }
    if matches!(networks, DeployedNetworks::Attention { network, .. } if network.skip.is_some()) {
        card += "\n## Where the training departs from the dissertation\n\n\
                 - An agent's own embedding reaches the layer before the head past the attention (`network.skip`).\n";
    }
    card
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

/// A measured allocation, for the card.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The scenario set that it was measured on; the bundle serves its sizes.
    pub set: String,
    /// Who allocated.
    pub allocation: String,
    /// How the team did.
    pub evaluation: Evaluation,
}

/// The card's table of measured episodes, a row for each set.
pub fn measured_table(measured: &[Measured]) -> String {
    let mut table = "\
         | starts | episodes | success (95 % interval) | time-outs | return | steps |\n\
         | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for Measured { set, evaluation, .. } in measured {
        let [low, high] = evaluation.success_ci95;
        // Writing to a string cannot fail.
        let _ = writeln!(
            table,
            "| `{set}` | {} | {:.3} ({low:.3} to {high:.3}) | {:.3} | {:.2} | {:.2} |",
            evaluation.episodes,
            evaluation.success,
            evaluation.timeouts,
            evaluation.return_mean,
            evaluation.length_mean,
        );
    }
    table
}

/// A file of a run that becomes part of its bundle.
///
/// # Errors
/// It cannot be read.
pub fn read_part(folder: &Path, name: &str) -> Result<Vec<u8>, LearnError> {
    let path = folder.join(name);
    read_file(&path, MOST_BYTES).map_err(LearnError::file(path))
}
