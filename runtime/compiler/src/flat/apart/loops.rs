//! Loops that turn a known number of times, which tract does not read, as their turns one behind the other.

use std::collections::HashMap;

use tract_onnx::pb::tensor_proto::DataType::Int64;
use tract_onnx::pb::{AttributeProto, GraphProto, NodeProto, TensorProto};

use super::{Parts, whole, wholes};
use crate::flat::unrolled::TURNS;

/// The turns of a loop whose count is constant and whose condition always holds.
pub(super) fn laid_open(parts: &mut Parts<'_>) -> Option<()> {
    let body = parts.attribute("body")?.g.clone()?;
    let turns = parts.computed(&parts.input(0)?)?.first().copied()?;
    let holds =
        parts.input(1).is_none_or(|name| parts.computed(&name).is_some_and(|holds| holds == [1.0]));
    if !holds || !(1.0..=TURNS as f64).contains(&turns) || !always_goes_on(&body) {
        return None;
    }
    let own = parts.name("loop", 0);
    let names = |values: &[String]| -> Vec<String> {
        values.iter().map(|name| format!("{own}.{name}")).collect()
    };
    let stored: Vec<String> = body.initializer.iter().map(|tensor| tensor.name.clone()).collect();
    for (tensor, name) in body.initializer.iter().zip(names(&stored)) {
        parts.added.push(TensorProto { name, ..tensor.clone() });
    }
    let condition = parts.truths(Vec::new(), [true].into_iter());
    let mut states: Vec<String> = parts.node.input.iter().skip(2).cloned().collect();
    let mut rows: Vec<Vec<String>> = Vec::new();
    for turn in 0..turns as i64 {
        let count = parts.scalar(turn);
        let given = [count, condition.clone()].into_iter().chain(states.clone());
        let mut known: HashMap<String, String> =
            body.input.iter().map(|input| input.name.clone()).zip(given).collect();
        known.extend(stored.iter().cloned().zip(names(&stored)));
        let inside = body.node.iter().flat_map(|node| &node.output).filter(|name| !name.is_empty());
        known.extend(inside.map(|name| (name.clone(), format!("{own}.{turn}.{name}"))));
        for node in &body.node {
            let mut node = renamed(node, &known);
            node.name = format!("{own}.{turn}.{}", node.name);
            parts.nodes.push(node);
        }
        let found = |output: &str| known.get(output).cloned().unwrap_or_else(|| output.to_owned());
        let mut results = body.output.iter().skip(1).map(|output| found(&output.name));
        states = results.by_ref().take(states.len()).collect();
        rows.push(results.collect());
    }
    for (slot, state) in states.iter().enumerate() {
        parts.give(slot, state)?;
    }
    for scan in 0..rows.first().map_or(0, Vec::len) {
        let of_turns: Vec<String> = rows.iter().filter_map(|row| row.get(scan).cloned()).collect();
        let of_turns: Vec<String> = of_turns.iter().map(|row| parts.stood(row)).collect();
        let of_turns: Vec<&str> = of_turns.iter().map(String::as_str).collect();
        let all = parts.add_with("Concat", &of_turns, vec![whole("axis", 0)]);
        parts.give(states.len() + scan, &all)?;
    }
    Some(())
}

/// Whether a body hands on the condition that it is given, or one that is true.
fn always_goes_on(body: &GraphProto) -> bool {
    let (Some(given), Some(output)) = (body.input.get(1), body.output.first()) else {
        return false;
    };
    let mut name = output.name.as_str();
    for _ in 0..=body.node.len() {
        if name == given.name
            || body.initializer.iter().any(|tensor| tensor.name == name && is_true(tensor))
        {
            return true;
        }
        let makes = |node: &&NodeProto| node.output.iter().any(|output| output == name);
        let Some(node) = body.node.iter().find(makes) else { return false };
        match (node.op_type.as_str(), node.input.first()) {
            ("Identity" | "Cast", Some(before)) => name = before,
            ("Constant", _) => {
                let constant = node.attribute.first().and_then(|attribute| attribute.t.as_ref());
                return constant.is_some_and(is_true);
            }
            _ => return false,
        }
    }
    false
}

fn is_true(tensor: &TensorProto) -> bool {
    tensor.raw_data.first().map_or(tensor.int32_data.first() == Some(&1), |byte| *byte == 1)
}

/// A node that reads and writes values by their new names, in the graphs that it holds too.
fn renamed(node: &NodeProto, names: &HashMap<String, String>) -> NodeProto {
    let new = |name: &String| names.get(name).unwrap_or(name).clone();
    let graph = |graph: &GraphProto| {
        let mut graph = graph.clone();
        graph.node = graph.node.iter().map(|node| renamed(node, names)).collect();
        graph.output.iter_mut().for_each(|output| output.name = new(&output.name));
        graph
    };
    let attribute = |attribute: &AttributeProto| AttributeProto {
        g: attribute.g.as_ref().map(graph),
        ..attribute.clone()
    };
    NodeProto {
        input: node.input.iter().map(new).collect(),
        output: node.output.iter().map(new).collect(),
        attribute: node.attribute.iter().map(attribute).collect(),
        ..node.clone()
    }
}

impl Parts<'_> {
    /// A whole number.
    fn scalar(&mut self, number: i64) -> String {
        let (data_type, int64_data) = (Int64 as i32, vec![number]);
        self.tensor(TensorProto { data_type, int64_data, ..TensorProto::default() })
    }

    /// A value with a size of one before its own.
    fn stood(&mut self, x: &str) -> String {
        if self.version() < 13 {
            return self.add_with("Unsqueeze", &[x], vec![wholes("axes", &[0])]);
        }
        let axis = self.row(&[0]);
        self.add("Unsqueeze", &[x, &axis])
    }
}
