//! Facts about ONNX files, for people and scripts.

use std::collections::BTreeMap;

use sortie_plans::{CompileError, InspectedOnnx, OnnxFacts, PolicyOptions};
use tract_onnx::pb;
use tract_onnx::prelude::*;

use crate::flat::{FlatGraph, declared, described};
use crate::graph::{Graph, guarded, shape};

/// Named values with their types and shapes.
type Named = Vec<(String, String)>;

/// Reads the facts of an ONNX file, whether or not it can be compiled.
pub fn inspect_onnx(onnx: &[u8]) -> Result<OnnxFacts, CompileError> {
    inspect(onnx, &PolicyOptions::default()).map(|inspected| inspected.facts)
}

/// Reads the facts of an ONNX file, and of the policy that it is, if it is no network that plans are made of.
pub fn inspect(onnx: &[u8], options: &PolicyOptions) -> Result<InspectedOnnx, CompileError> {
    let read = || tract_onnx::onnx().proto_model_for_read(&mut &*onnx);
    let file = guarded(read).map_err(|reason| CompileError::Unreadable { reason })?;
    if *options == PolicyOptions::default() && Graph::read(onnx).is_ok() {
        let values = analysed(&file).map_err(|reason| CompileError::Unreadable { reason })?;
        return Ok(InspectedOnnx { facts: facts(&file, values), policy: None });
    }
    let policy = FlatGraph::read(onnx, options).map(|graph| graph.interface.facts);
    match policy {
        Err(error) if !error.asks() && !matches!(error, CompileError::NoPolicy { .. }) => {
            Err(error)
        }
        policy => {
            let values = described(onnx, options).unwrap_or_else(|_| declared(&file));
            Ok(InspectedOnnx { facts: facts(&file, values), policy: Some(policy) })
        }
    }
}

/// Inputs and outputs as tract's analysis has them.
fn analysed(file: &pb::ModelProto) -> Result<[Named; 2], String> {
    guarded(|| {
        let model = tract_onnx::onnx().model_for_proto_model(file)?.into_typed()?;
        let graph = file.graph.clone().unwrap_or_default();
        let named = |values: &[pb::ValueInfoProto], outlets: &[OutletId]| {
            let facts = outlets.iter().map(|&outlet| model.outlet_fact(outlet).map(shape));
            let facts = facts.map(|fact| fact.unwrap_or_default());
            values.iter().map(|value| value.name.clone()).zip(facts).collect()
        };
        Ok([named(&graph.input, &model.inputs), named(&graph.output, &model.outputs)])
    })
}

fn facts(file: &pb::ModelProto, [inputs, outputs]: [Named; 2]) -> OnnxFacts {
    let graph = file.graph.clone().unwrap_or_default();
    let mut operators = BTreeMap::new();
    for node in &graph.node {
        *operators.entry(node.op_type.clone()).or_insert(0) += 1;
    }
    let default_set = |domain: &str| domain.is_empty() || domain == "ai.onnx";
    let opset = file.opset_import.iter().find(|set| default_set(&set.domain));
    let entries = file.metadata_props.iter();
    OnnxFacts {
        ir_version: file.ir_version,
        opset: opset.map_or(0, |set| set.version),
        producer: format!("{} {}", file.producer_name, file.producer_version).trim().to_owned(),
        inputs,
        outputs,
        operators,
        parameters: graph.initializer.iter().map(|t| t.dims.iter().product::<i64>()).sum(),
        metadata: entries.map(|entry| (entry.key.clone(), entry.value.clone())).collect(),
    }
}
