//! What the process does that reads ONNX files for others, facts about such files among it.

use std::collections::BTreeMap;
use std::io::{self, Write};

use sortie_bundle::Recording;
use sortie_plans::{
    AttentionLayers, CompileError, FlatPolicy, InspectedOnnx, NetworkInput, OnnxFacts, PolicyFacts,
    PolicyOptions, ProposalFiles, Request, Rows, random_entities, random_observations_of,
    random_team_queries_of, read_request,
};
use tract_onnx::pb;
use tract_onnx::prelude::*;

use crate::compile::{
    compile, compile_policy, compile_proposals, compile_recorded_policy, compile_rounded,
};
use crate::flat::{FlatGraph, declared, described, remarks};
use crate::graph::{EntityRoles, Graph, Inputs, TeamRoles, guarded, shape};
use crate::matching::match_agent;
use crate::networks::{GraphFlatPolicy, GraphNetwork, Opens, Tract};

/// Answers one request of a [`sortie_plans::CompilerProcess`], from standard input to standard output.
///
/// # Errors
/// The request cannot be read, the answer not be written, or the limits not be set.
pub fn answer_compiler() -> io::Result<()> {
    let (request, onnx) = read_request()?;
    let answer = match request {
        Request::Compile(options) => postcard::to_stdvec(&compile(&onnx, &options)),
        Request::CompileRounded(options, examples) => postcard::to_stdvec(
            &read_examples(&examples)
                .and_then(|examples| compile_rounded(&onnx, &options, &examples)),
        ),
        Request::CompileProposals(options) => postcard::to_stdvec(
            &ProposalFiles::split(&onnx).and_then(|files| compile_proposals(&files, &options)),
        ),
        Request::CompilePolicy(policy, options) => {
            postcard::to_stdvec(&compile_policy(&onnx, &policy, &options))
        }
        Request::CompileRecordedPolicy(policy, options, recorded) => {
            postcard::to_stdvec(&compile_recorded_policy(&onnx, &policy, &options, &recorded))
        }
        Request::Rehearse { n_max, features } => {
            postcard::to_stdvec(&rehearse(&onnx, n_max, features))
        }
        Request::RehearsePolicy(options) => postcard::to_stdvec(&rehearse_policy(&onnx, &options)),
        Request::Inspect(options) => postcard::to_stdvec(&inspect(&onnx, &options)),
        Request::Attention => postcard::to_stdvec(&attention_layers(&onnx)),
    };
    io::stdout().lock().write_all(&answer.map_err(io::Error::other)?)
}

fn read_examples(bytes: &[u8]) -> Result<Recording, CompileError> {
    Recording::from_bytes(bytes)
        .map_err(|error| CompileError::Unreadable { reason: error.to_string() })
}

fn attention_layers(onnx: &[u8]) -> Result<AttentionLayers, CompileError> {
    let layers = match_agent(&Graph::read(onnx)?)?;
    let (embed, heads, query, key) = (layers.embed, layers.heads, layers.query, layers.key);
    Ok(AttentionLayers { embed, heads, query, key })
}

/// Runs a graph on inputs of the largest size. What it computes, or refuses to, does not matter here.
fn rehearse(onnx: &[u8], n_max: usize, features: Option<usize>) -> Result<(), CompileError> {
    const RUNS: usize = 4;
    const SEED: u64 = 1;
    let graph = Graph::read(onnx)?;
    let features = features.unwrap_or(graph.columns);
    let inputs: Vec<NetworkInput> = match graph.inputs {
        Inputs::Agent(_) => {
            let seen = random_observations_of(RUNS, n_max, features, graph.actions, SEED);
            seen.into_iter().map(NetworkInput::from).collect()
        }
        Inputs::TeamValue(TeamRoles { features, relations, .. }) => {
            let queries = random_team_queries_of(RUNS, n_max, features, relations, SEED);
            queries.into_iter().map(NetworkInput::from).collect()
        }
        Inputs::Entities(EntityRoles { group_count, .. }) => {
            let steps = random_entities(RUNS, n_max, graph.columns, group_count, SEED);
            steps.into_iter().map(NetworkInput::Entities).collect()
        }
        // No part runs by itself.
        Inputs::Proposals(_) => return Tract.open(&graph).map(drop),
    };
    let mut network = GraphNetwork::of(&graph, &Tract, features)?;
    for input in &inputs {
        let _ = network.outputs(input, Rows::All);
    }
    Ok(())
}

/// Runs a policy on zeros, its state fed back.
fn rehearse_policy(onnx: &[u8], options: &PolicyOptions) -> Result<PolicyFacts, CompileError> {
    const RUNS: usize = 4;
    let mut policy = GraphFlatPolicy::open(FlatGraph::read(onnx, options)?, &Tract)?;
    let facts = policy.facts().clone();
    let inputs: Vec<Vec<f32>> = facts.given().map(|input| vec![0.0; input.length()]).collect();
    let inputs: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
    let mut states = vec![0.0; facts.state_length()];
    for _ in 0..RUNS {
        policy.run(&inputs, &mut states)?;
    }
    Ok(facts)
}

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
        return Ok(InspectedOnnx {
            facts: facts(&file, values),
            policy: None,
            remarks: Vec::new(),
        });
    }
    let graph = FlatGraph::read(onnx, options);
    let remarks = graph.as_ref().map_or_else(|_| Vec::new(), remarks);
    match graph.map(|graph| graph.interface.facts) {
        Err(error) if !error.asks() && !matches!(error, CompileError::NoPolicy { .. }) => {
            Err(error)
        }
        policy => {
            let values = described(onnx, options).unwrap_or_else(|_| declared(&file));
            Ok(InspectedOnnx { facts: facts(&file, values), policy: Some(policy), remarks })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_cross_the_process_boundary_as_they_are() {
        let error = inspect(b"no network", &PolicyOptions::default()).map(|_| ()).unwrap_err();
        let bytes = postcard::to_stdvec(&error).unwrap();
        let crossed: CompileError = postcard::from_bytes(&bytes).unwrap();
        assert_eq!(format!("{error:?}"), format!("{crossed:?}"));
    }
}
