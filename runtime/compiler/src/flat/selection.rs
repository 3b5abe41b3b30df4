//! What is taken of a file: the wanted outputs, and the states that they need.

use std::collections::HashSet;

use sortie_plans::{CompileError, PolicyOptions, ValueType};
use tract_onnx::pb;

use super::nodes::{ArgMax, Nodes};
use super::outputs::{Wanted, wanted};
use super::states::{self, Pair};
use super::values::{Value, Values};

/// What is taken of a file.
pub(super) struct Selection {
    pub(super) wanted: Vec<Wanted>,
    /// What the wanted outputs choose, where they are choices.
    pub(super) choices: Vec<Option<ArgMax>>,
    pub(super) states: Vec<Pair>,
}

impl Selection {
    pub(super) fn of(
        file: &pb::ModelProto,
        values: &Values,
        options: &PolicyOptions,
    ) -> Result<Self, CompileError> {
        let graph = file.graph.clone().unwrap_or_default();
        let nodes = Nodes::of(&graph);
        let pairs = states::find(values, &options.states)?;
        let is_state = |name: &str| pairs.iter().any(|pair| pair.output == name);
        let others: Vec<&Value> =
            values.outputs.iter().filter(|output| !is_state(&output.name)).collect();
        let is_choice = |output: &Value| {
            output.kind.is_some_and(ValueType::is_integer) && nodes.argmax(&output.name).is_some()
        };
        let wanted = wanted(&others, is_choice, &options.outputs)?;
        let choices = wanted.iter().map(|wanted| nodes.argmax(&wanted.name)).collect();
        let (states, behind) = needed(&nodes, &wanted, pairs);
        if options.states.is_empty() {
            let is_wanted = |name: &str| wanted.iter().any(|wanted| wanted.name == name);
            let is_state = |name: &str| states.iter().any(|pair| pair.input == name);
            let inputs = values
                .inputs
                .iter()
                .filter(|input| behind.contains(&input.name) && !is_state(&input.name));
            let outputs = others.iter().copied().filter(|output| !is_wanted(&output.name));
            states::refuse_hidden(&inputs.collect::<Vec<_>>(), &outputs.collect::<Vec<_>>())?;
        }
        Ok(Self { wanted, choices, states })
    }

    /// The outputs of the cut file, none twice.
    pub(super) fn outputs(&self) -> Vec<String> {
        let wanted = self.wanted.iter().map(|wanted| &wanted.name);
        let states = self.states.iter().map(|pair| &pair.output);
        let scores = self.choices.iter().flatten().map(|choice| &choice.scores);
        let mut seen = HashSet::new();
        let names = wanted.chain(states).chain(scores).filter(|name| seen.insert(*name));
        names.cloned().collect()
    }
}

/// The states that the wanted outputs need, those among them that these states need, and the names of all behind them.
fn needed(nodes: &Nodes<'_>, wanted: &[Wanted], pairs: Vec<Pair>) -> (Vec<Pair>, HashSet<String>) {
    let mut behind = nodes.behind(wanted.iter().map(|wanted| wanted.name.as_str()));
    loop {
        let needed = pairs.iter().filter(|pair| behind.contains(&pair.input));
        let missing: Vec<&str> = needed
            .map(|pair| pair.output.as_str())
            .filter(|output| !behind.contains(*output))
            .collect();
        if missing.is_empty() {
            break;
        }
        behind.extend(nodes.behind(missing));
    }
    let states = pairs.into_iter().filter(|pair| behind.contains(&pair.input)).collect();
    (states, behind)
}
