//! The graphs that a team's agents decide by: one for all, or several and who decides by which.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use sortie_core::limits;

use crate::bundle::{AGENT, AGENT_PLAN};
use crate::contract::ContractV1;
use crate::manifest::{Network, POLICY};

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
        self.part(AGENT)
    }

    /// Its plan.
    pub fn plan_part(&self) -> String {
        self.part(AGENT_PLAN)
    }

    /// The name of a file of all agents becomes that of this graph's.
    fn part(&self, of_all: &str) -> String {
        match of_all.split_once('.') {
            Some((agent, ending)) if !self.name.is_empty() => {
                format!("{agent}-{}.{ending}", self.name)
            }
            _ => of_all.to_owned(),
        }
    }
}

impl Network {
    /// What is wrong with the agents' graphs.
    pub(crate) fn graphs_flaw(&self, contract: &ContractV1) -> Option<String> {
        let Self { agent, graph_of, graphs, .. } = self;
        let (agents, count) = (graph_of.len(), graphs.len());
        let names: BTreeSet<&str> = graphs.iter().map(|graph| graph.name.as_str()).collect();
        let unused = |index: &usize| !graph_of.iter().any(|graph| usize::from(*graph) == *index);
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
