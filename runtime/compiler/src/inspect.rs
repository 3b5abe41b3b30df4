//! Facts about ONNX files, for people and scripts.

use std::collections::BTreeMap;

use sortie_plans::{CompileError, OnnxFacts};
use tract_onnx::prelude::*;

use crate::graph::{guarded, shape};

/// Reads the facts of an ONNX file, whether or not it can be compiled.
pub fn inspect_onnx(onnx: &[u8]) -> Result<OnnxFacts, CompileError> {
    let read = || {
        let reader = tract_onnx::onnx();
        let file = reader.proto_model_for_read(&mut &*onnx)?;
        let model = reader.model_for_proto_model(&file)?.into_typed()?;
        let graph = file.graph.clone().unwrap_or_default();
        let mut operators = BTreeMap::new();
        for node in &graph.node {
            *operators.entry(node.op_type.clone()).or_insert(0) += 1;
        }
        let parameters = graph.initializer.iter().map(|t| t.dims.iter().product::<i64>()).sum();
        let entries = file.metadata_props.iter();
        let default_set = |domain: &str| domain.is_empty() || domain == "ai.onnx";
        let opset = file.opset_import.iter().find(|set| default_set(&set.domain));
        let names = |values: &[tract_onnx::pb::ValueInfoProto], outlets: &[OutletId]| {
            let facts = outlets.iter().map(|&outlet| model.outlet_fact(outlet).map(shape));
            let facts = facts.map(|fact| fact.unwrap_or_default());
            values.iter().map(|value| value.name.clone()).zip(facts).collect()
        };
        Ok(OnnxFacts {
            ir_version: file.ir_version,
            opset: opset.map_or(0, |set| set.version),
            producer: format!("{} {}", file.producer_name, file.producer_version).trim().to_owned(),
            inputs: names(&graph.input, &model.inputs),
            outputs: names(&graph.output, &model.outputs),
            operators,
            parameters,
            metadata: entries.map(|entry| (entry.key.clone(), entry.value.clone())).collect(),
        })
    };
    guarded(read).map_err(|reason| CompileError::Unreadable { reason })
}
