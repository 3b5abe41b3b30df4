//! The graphs that a team's agents decide by: one for all, or several and who decides by which.

use std::collections::BTreeSet;

use sortie_core::limits;

use crate::contract::ContractV1;
use crate::manifest::{AgentGraph, Network, OPTIONS, POLICY};
use crate::options::OptionsContract;

impl Network {
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
