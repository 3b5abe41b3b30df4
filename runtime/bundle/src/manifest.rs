//! `bundle.toml`: contract, limits, network and the hashes of all parts.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use sortie_core::allocate::PointingRules;
use sortie_core::limits;

use crate::contract::{ContractV1, OptionsContract};

/// The network of all agents; that of some has their graph's name in its own, see [`AgentGraph`].
pub const AGENT: &str = "agent.onnx";
/// The plan of the agent's network: profile `exact`, for as many entities as the limits say.
pub const AGENT_PLAN: &str = "agent.plan";
/// The newest bundle format that this program reads.
pub(crate) const FORMAT: u32 = 5;

/// The kind of agent network that is a policy over inputs of fixed sizes, whoever exported it.
pub const POLICY: &str = "policy";

/// The kind of agent that goes from milestone to milestone, by three networks.
pub const OPTIONS: &str = "options";
/// What its graphs are named: controller, meta-controller and affordances.
pub const OPTION_GRAPHS: [&str; 3] = ["controller", "meta", "affordance"];

/// The kind of allocator that values a team at a subtask, and searches.
pub const TEAM_VALUE: &str = "team-value";
/// The kind of allocator that proposes allocations and values them: trunk, step and critic.
pub const PROPOSALS: &str = "proposals";
/// The kind of allocator that points at a subtask for one agent after the other: encoder and decoder.
pub const POINTING: &str = "pointing";

/// The content of `bundle.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the bundle format.
    pub format: u32,
    /// What the policy was trained for.
    pub contract: Contract,
    /// The largest domain that the bundle serves.
    pub limits: Limits,
    /// What the networks are.
    pub network: Network,
    /// SHA-256 of every other file, by name.
    pub parts: BTreeMap<String, String>,
}

/// The contract with its hash, and facts for people that are not part of the hash.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contract {
    /// 16 hexadecimal digits: [`ContractV1::hash`].
    pub hash: String,
    /// Where the policy was trained.
    #[serde(flatten)]
    pub environment: Environment,
    /// The contract itself.
    #[serde(flatten)]
    pub v1: ContractV1,
}

/// The environment that a policy was trained in, for people to read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Environment {
    /// Its name.
    #[serde(rename = "environment")]
    pub name: String,
    /// Its version.
    #[serde(rename = "environment_version")]
    pub version: String,
    /// Units of the features, in order; empty where none are given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub feature_units: Vec<String>,
    /// Smallest and largest value of the features, in order; empty where none are given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub feature_ranges: Vec<[f32; 2]>,
}

/// The largest domain that a bundle serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Most visible entities.
    pub n_max: u16,
    /// Most subtasks.
    pub t_max: u16,
    /// Largest team per subtask.
    pub team_max: u16,
}

impl Limits {
    /// What the runtime cannot express.
    pub(crate) fn flaw(&self) -> Option<String> {
        let sizes = [
            ("n_max", self.n_max, limits::ENTITIES),
            ("t_max", self.t_max, limits::TASKS),
            ("team_max", self.team_max, limits::AGENTS),
        ];
        let beyond = |(name, size, most): (&str, u16, usize)| {
            let is_beyond = usize::from(size) > most;
            is_beyond.then(|| format!("{name} = {size} in [limits], at most {most} is possible"))
        };
        let empty =
            || (self.n_max == 0).then(|| "n_max = 0 in [limits]: nothing is seen".to_owned());
        sizes.into_iter().find_map(beyond).or_else(empty)
    }
}

/// What the networks of a bundle are.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Network {
    /// Kind of the agent network, for example `masked-attention`, or [`POLICY`].
    pub agent: String,
    /// Kind of the allocator's network, [`TEAM_VALUE`], [`PROPOSALS`] or [`POINTING`], where the bundle has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allocator: Option<String>,
    /// Floats of the agent's hidden state, 0 if it has none.
    pub hidden: u32,
    /// By agents: which of `graphs` each decides by; empty where all decide by the same.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub graph_of: Vec<u16>,
    /// The graphs of [`POLICY`] agents that do not all decide by the same.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub graphs: Vec<AgentGraph>,
    /// The rules of an [`OPTIONS`] agent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub options: Option<OptionsContract>,
    /// What a [`POINTING`] allocator can give.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointing: Option<PointingContract>,
}

/// What agents can be given by a [`POINTING`] allocator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointingContract {
    /// Subtasks that one agent alone can be given, while an action that heads for it is available.
    pub exclusive: Vec<u8>,
    /// The action that heads for the first subtask; each of the next heads for the next one.
    pub first_action: u16,
}

impl PointingContract {
    /// As allocators take them.
    pub fn rules(&self) -> PointingRules {
        let Self { exclusive, first_action } = self;
        let bit = |task: &u8| 1_u32.checked_shl((*task).into()).unwrap_or(0);
        PointingRules {
            exclusive: exclusive.iter().map(bit).fold(0, |tasks, task| tasks | task),
            first_action: *first_action,
        }
    }

    fn flaw(&self, contract: &ContractV1) -> Option<String> {
        if let Some(task) = self.exclusive.iter().find(|task| usize::from(**task) >= limits::TASKS)
        {
            return Some(format!("pointing.exclusive names subtask {task}, there are up to 31"));
        }
        (self.first_action >= contract.actions).then(|| {
            let (first, actions) = (self.first_action, contract.actions);
            format!("pointing.first_action is {first}, there are {actions} actions")
        })
    }
}

/// A graph by which some of a team's agents decide.
///
/// It reads the first features of an agent's row and scores the first actions: what a role sees and does.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AgentGraph {
    /// What its files are named by; empty where all agents decide by the same.
    pub name: String,
    /// Features that it reads.
    pub features: u16,
    /// Actions that it scores.
    pub actions: u16,
}

impl AgentGraph {
    /// The graph of all agents.
    pub(crate) fn of_all(contract: &ContractV1) -> Self {
        Self { name: String::new(), features: contract.features, actions: contract.actions }
    }

    /// Its ONNX file.
    pub fn onnx_part(&self) -> String {
        Self::part_of(&self.name, AGENT)
    }

    /// Its plan.
    pub fn plan_part(&self) -> String {
        Self::part_of(&self.name, AGENT_PLAN)
    }

    /// The graphs of an agent that goes from milestone to milestone; what they take and give is in the files.
    pub(crate) fn of_options(contract: &ContractV1) -> [Self; 3] {
        let ContractV1 { features, actions, .. } = *contract;
        OPTION_GRAPHS.map(|name| Self { name: name.to_owned(), features, actions })
    }

    /// The name of a file of all agents becomes that of a graph's.
    pub fn part_of(name: &str, of_all: &str) -> String {
        match of_all.split_once('.') {
            Some((agent, ending)) if !name.is_empty() => format!("{agent}-{name}.{ending}"),
            _ => of_all.to_owned(),
        }
    }
}

impl Network {
    /// The format of its bundle: programs that know of one graph for all agents read the first, those that know of no options
    /// the second, those that know of no allocator that points the third, and those that would not guard the fourth.
    pub(crate) fn format(&self, is_guarded: bool) -> u32 {
        match (&self.pointing, &self.options) {
            _ if is_guarded => 5,
            (Some(_), _) => 4,
            (None, Some(_)) => 3,
            (None, None) if self.graphs.is_empty() => 1,
            (None, None) => 2,
        }
    }

    /// What is wrong with the agents' graphs.
    pub(crate) fn graphs_flaw(&self, contract: &ContractV1) -> Option<String> {
        let Self { agent, graph_of, graphs, .. } = self;
        let (agents, count) = (graph_of.len(), graphs.len());
        let names: BTreeSet<&str> = graphs.iter().map(|graph| graph.name.as_str()).collect();
        let unused = |index: &usize| !graph_of.iter().any(|graph| usize::from(*graph) == *index);
        if (agent == OPTIONS) != self.options.is_some() {
            return Some(
                "an agent of kind `options` needs its rules, and no other has any".to_owned(),
            );
        }
        if (self.allocator.as_deref() == Some(POINTING)) != self.pointing.is_some() {
            return Some(
                "an allocator of kind `pointing` needs its rules, and no other has any".to_owned(),
            );
        }
        if let Some(flaw) = self.pointing.as_ref().and_then(|pointing| pointing.flaw(contract)) {
            return Some(flaw);
        }
        if let Some(options) = &self.options {
            return options_flaw(options, contract);
        }
        if graphs.is_empty() && graph_of.is_empty() {
            return None;
        }
        if agent != POLICY {
            return Some(format!("`{agent}` agents all decide by one graph, {count} are named"));
        }
        if agents > limits::AGENTS {
            let most = limits::AGENTS;
            return Some(format!("graph_of is of {agents} agents, at most {most} are possible"));
        }
        if names.len() != count || names.contains("") {
            return Some("the agents' graphs need names, each another".to_owned());
        }
        if let Some(graph) = graph_of.iter().find(|graph| usize::from(**graph) >= count) {
            return Some(format!("graph_of names graph {graph}, there are {count}"));
        }
        if let Some(graph) = (0..count).find(unused).and_then(|index| graphs.get(index)) {
            return Some(format!("no agent decides by the graph `{}`", graph.name));
        }
        graphs.iter().find_map(|graph| {
            let AgentGraph { name, features, actions } = graph;
            let sizes = [
                ("features", *features, contract.features),
                ("actions", *actions, contract.actions),
            ];
            let wrong = |(_, got, most): &(&str, u16, u16)| !(1..=*most).contains(got);
            let (what, got, most) = sizes.into_iter().find(wrong)?;
            Some(format!("the graph `{name}` has {got} {what}, a row has {most}"))
        })
    }
}

/// What is wrong with the rules of options.
fn options_flaw(options: &OptionsContract, contract: &ContractV1) -> Option<String> {
    match options.rules(contract.actions.into()) {
        Err(reason) => Some(reason),
        Ok(rules) if rules.picture.features() != usize::from(contract.features) => {
            let (want, got) = (contract.features, rules.picture.features());
            Some(format!("the picture of options has {got} numbers, the contract says {want}"))
        }
        Ok(_) => None,
    }
}
