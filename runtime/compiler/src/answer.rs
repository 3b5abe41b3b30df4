//! What the process does that reads ONNX files for others.

use std::io::{self, Write};

use sortie_plans::{
    AttentionLayers, CompileError, ProposalFiles, Request, Rows, random_entities,
    random_observations_of, random_team_queries_of, read_request,
};

use crate::compile::{compile, compile_proposals};
use crate::engine::TeamValueEngine;
use crate::graph::{EntityRoles, Graph, Inputs, TeamRoles};
use crate::inspect::inspect_onnx;
use crate::matching::match_agent;
use crate::tract::{TractEntities, TractPolicy, TractTeamValue};

/// Answers one request of a [`sortie_plans::CompilerProcess`], from standard input to standard output.
///
/// # Errors
/// The request cannot be read, the answer not be written, or the limits not be set.
pub fn answer_compiler() -> io::Result<()> {
    let (request, onnx) = read_request()?;
    let answer = match request {
        Request::Compile(options) => postcard::to_stdvec(&compile(&onnx, &options)),
        Request::CompileProposals(options) => postcard::to_stdvec(
            &ProposalFiles::split(&onnx).and_then(|files| compile_proposals(&files, &options)),
        ),
        Request::Rehearse { n_max, features } => {
            postcard::to_stdvec(&rehearse(&onnx, n_max, features))
        }
        Request::Inspect => postcard::to_stdvec(&inspect_onnx(&onnx)),
        Request::Attention => postcard::to_stdvec(&attention_layers(&onnx)),
    };
    io::stdout().lock().write_all(&answer.map_err(io::Error::other)?)
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
    match graph.inputs {
        Inputs::Agent(roles) => {
            let features = features.unwrap_or(graph.columns);
            let mut engine = TractPolicy::from_graph(&graph, features)?;
            let mut state = vec![0.0; roles.memory.map_or(0, |memory| memory.size)];
            let mut utilities = vec![0.0; graph.actions];
            for seen in random_observations_of(RUNS, n_max, features, graph.actions, SEED) {
                let _ = engine.step(&seen.view(), Rows::All, &mut state, &mut utilities);
            }
        }
        Inputs::TeamValue(TeamRoles { features, relations, .. }) => {
            let mut engine = TractTeamValue::from_graph(&graph)?;
            for query in random_team_queries_of(RUNS, n_max, features, relations, SEED) {
                let state = query.state.view();
                let _ = engine.run(&query.view(&state), Rows::All);
            }
        }
        // No part runs by itself.
        Inputs::Proposals(_) => {
            graph.runnable()?;
        }
        Inputs::Entities(EntityRoles { group_count, .. }) => {
            let mut engine = TractEntities::from_graph(&graph)?;
            for step in random_entities(RUNS, n_max, graph.columns, group_count, SEED) {
                let _ = engine.run(&step.view());
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_cross_the_process_boundary_as_they_are() {
        let error = inspect_onnx(b"no network").map(|_| ()).unwrap_err();
        let bytes = postcard::to_stdvec(&error).unwrap();
        let crossed: CompileError = postcard::from_bytes(&bytes).unwrap();
        assert_eq!(format!("{error:?}"), format!("{crossed:?}"));
    }
}
