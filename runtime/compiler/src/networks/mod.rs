//! The networks of this trainer over any engine: what tensors an observation, a team query, entities or an allocation
//! become, and what comes of the outputs.

mod agent;
mod batched;
mod entities;
mod policy;
mod proposals;
mod team_value;
mod true_policy;
mod truth;

use prost::Message;
use sortie_plans::{CompileError, NetworkFiles, NetworkInput, Rows, cannot_run};

use crate::engine::Engine;
use crate::engine::reference::ReferenceEngine;
use crate::engine::tract::TractEngine;
use crate::flat::FlatGraph;
use crate::graph::{Graph, Inputs};
use crate::onnxruntime::{OnnxRuntime, SessionEngine};

pub use agent::GraphPolicy;
pub(crate) use agent::{AgentColumns, AgentGraph};
pub use batched::{BatchedAgents, BatchedTeamValues};
pub(crate) use entities::EntityGraph;
pub(crate) use policy::GraphFlatPolicy;
pub(crate) use proposals::ProposalGraphs;
pub use team_value::GraphTeamValue;
pub(crate) use team_value::{TeamGraph, feature_rows};
pub(crate) use true_policy::TruePolicy;
pub(crate) use truth::TrueNetwork;

/// An engine that graphs can be opened in.
pub(crate) trait Opens {
    type Engine: Engine + 'static;

    /// A network of this trainer.
    fn open(&self, graph: &Graph) -> Result<Self::Engine, CompileError>;

    /// A policy whoever exported it.
    fn open_policy(&self, graph: &FlatGraph) -> Result<Self::Engine, CompileError>;
}

/// tract.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tract;

impl Opens for Tract {
    type Engine = TractEngine;

    fn open(&self, graph: &Graph) -> Result<TractEngine, CompileError> {
        TractEngine::new(&graph.model)
    }

    fn open_policy(&self, graph: &FlatGraph) -> Result<TractEngine, CompileError> {
        // What stands at the inputs of a simplified graph may have other names than the file's.
        let names = graph.interface.facts.inputs.iter().map(|input| input.name.clone());
        Ok(TractEngine::new(&graph.model)?.with_inputs(names))
    }
}

impl Opens for OnnxRuntime {
    type Engine = SessionEngine;

    fn open(&self, graph: &Graph) -> Result<SessionEngine, CompileError> {
        SessionEngine::new(self, &graph.file.encode_to_vec())
    }

    fn open_policy(&self, graph: &FlatGraph) -> Result<SessionEngine, CompileError> {
        SessionEngine::new(self, &graph.file.encode_to_vec())
    }
}

/// The reference evaluator.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DoublePrecision;

impl Opens for DoublePrecision {
    type Engine = ReferenceEngine;

    fn open(&self, graph: &Graph) -> Result<ReferenceEngine, CompileError> {
        let outputs = graph.file.graph.iter().flat_map(|graph| &graph.output);
        let outputs = outputs.map(|output| output.name.clone()).collect();
        ReferenceEngine::new(&graph.file, outputs)
    }

    fn open_policy(&self, graph: &FlatGraph) -> Result<ReferenceEngine, CompileError> {
        ReferenceEngine::new(&graph.source, graph.interface.outputs.clone())
    }
}

/// A network of any kind in an engine.
#[derive(Debug)]
pub(crate) enum GraphNetwork<E: Engine> {
    Agent(AgentGraph<E>),
    TeamValue(TeamGraph<E>),
    Entities(EntityGraph<E>),
    Proposals(Box<ProposalGraphs<E>>),
}

/// The graphs of a network.
#[derive(Debug)]
pub(crate) enum Graphs {
    One(Box<Graph>),
    /// Trunk, step and critic of an allocator that proposes.
    Proposals(Box<[Graph; 3]>),
}

impl Graphs {
    pub(crate) fn read(files: &NetworkFiles<'_>) -> Result<Self, CompileError> {
        Ok(match files {
            NetworkFiles::One(onnx) => Self::One(Box::new(Graph::read(onnx)?)),
            NetworkFiles::Proposals(files) => Self::Proposals(Box::new([
                Graph::read(files.trunk)?,
                Graph::read(files.step)?,
                Graph::read(files.critic)?,
            ])),
        })
    }

    pub(crate) fn all(&self) -> &[Graph] {
        match self {
            Self::One(graph) => std::slice::from_ref(graph),
            Self::Proposals(graphs) => graphs.as_slice(),
        }
    }

    /// The one whose metadata says what they are for.
    pub(crate) fn first(&self) -> &Graph {
        match self {
            Self::One(graph) => graph,
            Self::Proposals(graphs) => {
                let [trunk, ..] = graphs.as_ref();
                trunk
            }
        }
    }

    /// The same in an engine; an agent's rows have so many features before the last action's one-hot.
    pub(crate) fn open<O: Opens>(
        &self,
        opener: &O,
        features: usize,
    ) -> Result<GraphNetwork<O::Engine>, CompileError> {
        match self {
            Self::One(graph) => GraphNetwork::of(graph, opener, features),
            Self::Proposals(graphs) => {
                let graphs = ProposalGraphs::new(graphs.each_ref(), opener)?;
                Ok(GraphNetwork::Proposals(Box::new(graphs)))
            }
        }
    }
}

impl<E: Engine + 'static> GraphNetwork<E> {
    /// A network of one graph.
    pub(crate) fn of<O: Opens<Engine = E>>(
        graph: &Graph,
        opener: &O,
        features: usize,
    ) -> Result<Self, CompileError> {
        Ok(match graph.inputs {
            Inputs::Agent(_) => Self::Agent(AgentGraph::new(graph, features, opener.open(graph)?)?),
            Inputs::TeamValue(_) => Self::TeamValue(TeamGraph::new(graph, opener.open(graph)?)?),
            Inputs::Entities(_) => Self::Entities(EntityGraph::new(graph, opener.open(graph)?)?),
            Inputs::Proposals(roles) => {
                return Err(CompileError::PartAlone { part: roles.part.name().into() });
            }
        })
    }

    /// The outputs for an input, of which the graph gets some rows, as plans give them; whatever numbers these are.
    pub(crate) fn outputs(
        &mut self,
        input: &NetworkInput,
        rows: Rows,
    ) -> Result<Vec<Vec<E::Number>>, CompileError> {
        match (self, input) {
            (Self::Agent(graph), NetworkInput::Agent { seen, memory }) => {
                let mut memory = memory.clone();
                memory.resize(graph.memory(), 0.0);
                graph.run(&seen.view(), rows, &memory).map(Vec::from).map_err(cannot_run)
            }
            (Self::TeamValue(graph), NetworkInput::TeamValue(query)) => {
                let state = query.state.view();
                let value = graph.run(&query.view(&state), rows).map_err(cannot_run)?;
                Ok(vec![vec![value]])
            }
            (Self::Entities(graph), NetworkInput::Entities(entities)) => {
                graph.run(&entities.view())
            }
            (Self::Proposals(graphs), NetworkInput::Proposals { state, allocations }) => {
                graphs.judge(&state.view(), allocations)
            }
            _ => Err(CompileError::OtherNetwork { want: "this input's".into() }),
        }
    }

    /// Its engines.
    pub(crate) fn engines(&mut self) -> Vec<&mut E> {
        match self {
            Self::Agent(graph) => vec![&mut graph.engine],
            Self::TeamValue(graph) => vec![&mut graph.engine],
            Self::Entities(graph) => vec![&mut graph.engine],
            Self::Proposals(graphs) => graphs.engines(),
        }
    }
}
