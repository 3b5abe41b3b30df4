//! Nodes that hold graphs: branches and loops.

use std::sync::Arc;

use tract_onnx::pb::{GraphProto, NodeProto};

use super::tensor::{Tensor, axis_of};
use super::{Call, Run, Values, moves, stored};

/// Turns of a loop after which a file is taken for one that never ends.
const MOST_TURNS: usize = 100_000;

impl Run<'_> {
    /// Evaluates a node that holds graphs; nothing where it holds none.
    pub(super) fn control(
        &mut self,
        node: &NodeProto,
        values: &Values,
    ) -> Result<Option<Vec<Tensor>>, String> {
        match node.op_type.as_str() {
            "If" => self.branch(node, values).map(Some),
            "Loop" => self.repeat(node, values).map(Some),
            "Scan" => self.scan(node, values).map(Some),
            _ => Ok(None),
        }
    }

    fn branch(&mut self, node: &NodeProto, values: &Values) -> Result<Vec<Tensor>, String> {
        let call = Call::of(node, self.version, values)?;
        let branch = if is_true(call.input(0)?)? { "then_branch" } else { "else_branch" };
        self.inner(graph(node, branch)?, values, Vec::new())
    }

    /// A graph as often as it says itself, at most as often as the first input says.
    fn repeat(&mut self, node: &NodeProto, values: &Values) -> Result<Vec<Tensor>, String> {
        let call = Call::of(node, self.version, values)?;
        let most = call.given(0).map(Tensor::single).transpose()?;
        let most = most.map_or(MOST_TURNS, |most| most.max(0.0) as usize);
        let mut goes_on = call.given(1).map_or(Ok(true), is_true)?;
        let states = node.input.len().saturating_sub(2);
        let carried = (2..node.input.len()).map(|index| call.input(index).cloned());
        let mut carried: Vec<Tensor> = carried.collect::<Result<_, _>>()?;
        let mut turns: Vec<Vec<Tensor>> = Vec::new();
        while goes_on && turns.len() < most {
            let mut inputs = vec![
                Tensor::whole(Vec::new(), vec![turns.len() as i64]),
                Tensor::truth(Vec::new(), vec![true]),
            ];
            inputs.append(&mut carried);
            let mut found = self.inner(graph(node, "body")?, values, inputs)?.into_iter();
            goes_on = found.next().map_or(Ok(false), |holds| is_true(&holds))?;
            carried = found.by_ref().take(states).collect();
            turns.push(found.collect());
            if turns.len() == MOST_TURNS {
                return Err(format!("node `{}` does not end", node.name));
            }
        }
        for scan in 0..node.output.len().saturating_sub(states) {
            let parts: Vec<&Tensor> = turns.iter().filter_map(|turn| turn.get(scan)).collect();
            carried.push(moves::stacked(&parts, 0)?);
        }
        Ok(carried)
    }

    /// A graph along one size of some inputs.
    fn scan(&mut self, node: &NodeProto, values: &Values) -> Result<Vec<Tensor>, String> {
        let call = Call::of(node, self.version, values)?;
        let scanned = call.int("num_scan_inputs", 1) as usize;
        let states = node.input.len().saturating_sub(scanned);
        // Along which axis, and whether backwards, each input is read and each output written.
        let number = |name: &str, index: usize| {
            call.ints(name).and_then(|given| given.get(index)).copied().unwrap_or(0)
        };
        let input_axis =
            |index: usize| call.input(states + index)?.axis(number("scan_input_axes", index));
        let length = call.input(states)?.shape[input_axis(0)?];
        let carried = (0..states).map(|index| call.input(index).cloned());
        let mut carried: Vec<Tensor> = carried.collect::<Result<_, _>>()?;
        let mut turns: Vec<Vec<Tensor>> = Vec::new();
        for turn in 0..length {
            let mut inputs = std::mem::take(&mut carried);
            for index in 0..scanned {
                let is_backwards = number("scan_input_directions", index) == 1;
                let at = if is_backwards { length - 1 - turn } else { turn };
                inputs.push(moves::row(call.input(states + index)?, input_axis(index)?, at)?);
            }
            let mut found = self.inner(graph(node, "body")?, values, inputs)?.into_iter();
            carried = found.by_ref().take(states).collect();
            turns.push(found.collect());
        }
        for scan in 0..node.output.len().saturating_sub(states) {
            let mut parts: Vec<&Tensor> = turns.iter().filter_map(|turn| turn.get(scan)).collect();
            if number("scan_output_directions", scan) == 1 {
                parts.reverse();
            }
            let rank = parts.first().map_or(0, |part| part.rank()) + 1;
            carried.push(moves::stacked(&parts, axis_of(number("scan_output_axes", scan), rank)?)?);
        }
        Ok(carried)
    }

    /// The outputs of a graph inside a node, which sees what is around it.
    fn inner(
        &mut self,
        graph: &GraphProto,
        around: &Values,
        inputs: Vec<Tensor>,
    ) -> Result<Vec<Tensor>, String> {
        let mut values = stored(graph, around)?;
        let names = graph.input.iter().map(|input| input.name.clone());
        values.extend(names.zip(inputs.into_iter().map(Arc::new)));
        self.nodes(&graph.node, &mut values)?;
        let output = |name: &String| {
            let value = values.get(name).ok_or_else(|| format!("no node computes `{name}`"))?;
            Ok(Tensor::clone(value))
        };
        graph.output.iter().map(|info| output(&info.name)).collect()
    }
}

fn graph<'a>(node: &'a NodeProto, name: &str) -> Result<&'a GraphProto, String> {
    let attribute = node.attribute.iter().find(|attribute| attribute.name == name);
    let graph = attribute.and_then(|attribute| attribute.g.as_ref());
    graph.ok_or_else(|| format!("node `{}` has no graph `{name}`", node.name))
}

fn is_true(tensor: &Tensor) -> Result<bool, String> {
    Ok(tensor.single()? != 0.0)
}
