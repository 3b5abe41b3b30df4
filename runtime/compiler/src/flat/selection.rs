//! What is taken of a file: the wanted outputs, and the states that they need.

use std::collections::HashSet;

use sortie_plans::{CompileError, PolicyOptions, ValueType};
use tract_onnx::pb;

use super::drawn::LIKELIEST;
use super::nodes::{ArgMax, Nodes};
use super::outputs::{Told, Wanted, wanted};
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
        let told = |output: &Value| {
            let behind = nodes.behind([output.name.as_str()]);
            let is_whole = output.kind.is_some_and(ValueType::is_integer);
            Told {
                is_choice: is_whole && nodes.argmax(&output.name).is_some(),
                is_drawn: nodes.drawn(&output.name).is_some(),
                is_constant: !values.inputs.iter().any(|input| behind.contains(&input.name)),
            }
        };
        let wanted = wanted(&others, told, &options.outputs)?;
        refuse_drawn(&nodes, &wanted, &options.outputs)?;
        let choices = wanted.iter().map(|wanted| nodes.argmax(&wanted.name)).collect();
        let (states, behind) = needed(&nodes, &wanted, pairs);
        if options.states.is_empty() {
            let is_wanted = |name: &str| wanted.iter().any(|wanted| wanted.name == name);
            let is_state = |name: &str| states.iter().any(|pair| pair.input == name);
            let inputs = values
                .inputs
                .iter()
                .filter(|input| behind.contains(&input.name) && !is_state(&input.name));
            let may_return = |output: &&Value| {
                let Told { is_drawn, is_constant, .. } = told(output);
                !is_wanted(&output.name) && !is_drawn && !is_constant
            };
            let outputs = others.iter().copied().filter(may_return);
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

/// Refuses wanted outputs that come out otherwise every time.
fn refuse_drawn(
    nodes: &Nodes<'_>,
    wanted: &[Wanted],
    asked: &[String],
) -> Result<(), CompileError> {
    for Wanted { name, .. } in wanted {
        let Some(node) = nodes.drawn(name) else { continue };
        let likeliest = format!("{name}{LIKELIEST}");
        if asked.contains(&likeliest) {
            let reason = format!("nothing is the likeliest of what {} draws", node.op_type);
            return Err(CompileError::NoPolicy { reason });
        }
        return Err(CompileError::Unclear {
            what: "what is wanted of numbers that are drawn at random".into(),
            candidates: format!("`{name}`, by {}", node.op_type),
            flag: format!(
                "`--output {likeliest}` for a normal's mean or the most probable of several"
            )
            .into(),
        });
    }
    Ok(())
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
