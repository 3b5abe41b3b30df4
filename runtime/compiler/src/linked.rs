//! The engines and the compiler of a program that links this crate.

use std::io;
use std::path::Path;

use sortie_bundle::Recording;
use sortie_core::allocate::TeamValueNetwork;
use sortie_core::allocate::proposals::Draw;
use sortie_core::{AllocateError, AllocationState, Policy};
use sortie_plans::{
    Answer, BatchedUtilities, BatchedValues, CompileError, CompileOptions, Compiled,
    CompiledPolicy, Compiler, DrawnProposals, Engines, FlatPolicy, GraphAnswers, GraphEngine,
    NetworkFiles, NetworkInput, OnnxRuntimeEngine, OnnxRuntimeError, PolicyOptions, ProposalFiles,
    Rows, TrueAnswers, TrueFlatPolicy,
};

use crate::answer::answer_compiler;
use crate::compile::{compile, compile_policy, compile_proposals, compile_rounded};
use crate::engine::Engine;
use crate::flat::FlatGraph;
use crate::graph::Graph;
use crate::networks::{
    BatchedAgents, BatchedTeamValues, GraphFlatPolicy, GraphNetwork, GraphPolicy, GraphTeamValue,
    Graphs, ProposalGraphs, Tract, TrueNetwork, TruePolicy,
};
use crate::onnxruntime::{OnnxRuntime, SessionEngine, find_library};

/// tract's version, as the lock file pins it.
const TRACT_VERSION: &str = "0.23.9";

/// Compiles in this process: for files that it made itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct InProcess;

impl Compiler for InProcess {
    fn compile(&self, onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError> {
        compile(onnx, options)
    }

    fn compile_rounded(
        &self,
        onnx: &[u8],
        options: &CompileOptions,
        examples: &Recording,
    ) -> Result<Compiled, CompileError> {
        compile_rounded(onnx, options, examples)
    }

    fn compile_proposals(
        &self,
        files: &ProposalFiles<'_>,
        options: &CompileOptions,
    ) -> Result<Compiled, CompileError> {
        compile_proposals(files, options)
    }

    fn compile_policy(
        &self,
        onnx: &[u8],
        policy: &PolicyOptions,
        options: &CompileOptions,
    ) -> Result<CompiledPolicy, CompileError> {
        compile_policy(onnx, policy, options)
    }
}

/// All engines of this crate.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinkedEngines;

impl Engines for LinkedEngines {
    fn answer_compiler(&self) -> io::Result<()> {
        answer_compiler()
    }

    fn tract(&self) -> &'static dyn GraphEngine {
        &Tract
    }

    fn onnxruntime(
        &self,
        python: Option<&Path>,
    ) -> Result<&'static dyn OnnxRuntimeEngine, OnnxRuntimeError> {
        let library = OnnxRuntime::load(&find_library(python)?)?;
        Ok(library)
    }

    fn truth(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<Box<dyn TrueFlatPolicy>, CompileError> {
        Ok(Box::new(TruePolicy::open(FlatGraph::read(onnx, options)?)?))
    }

    fn true_network(
        &self,
        files: &NetworkFiles<'_>,
        features: usize,
        seed: u64,
    ) -> Result<Box<dyn TrueAnswers>, CompileError> {
        Ok(Box::new(TrueNetwork::new(&Graphs::read(files)?, features, seed)?))
    }

    fn team_value_columns(&self, onnx: &[u8]) -> Result<(usize, usize), CompileError> {
        GraphTeamValue::by_tract(onnx).map(|network| network.columns())
    }
}

/// What an engine does with graphs, by the ways that [`crate::networks`] has for all of them.
macro_rules! runs_graphs {
    ($engine:ty, $name:literal, $version:expr) => {
        impl GraphEngine for $engine {
            fn name(&self) -> &'static str {
                $name
            }

            fn version(&self) -> &str {
                $version(self)
            }

            fn policy(
                &self,
                onnx: &[u8],
                features: usize,
            ) -> Result<Box<dyn Policy + Send>, CompileError> {
                Ok(Box::new(GraphPolicy::open(&Graph::read(onnx)?, features, self)?))
            }

            fn team_value(
                &self,
                onnx: &[u8],
            ) -> Result<Box<dyn TeamValueNetwork + Send>, CompileError> {
                Ok(Box::new(GraphTeamValue::open(&Graph::read(onnx)?, self)?))
            }

            fn flat_policy(
                &self,
                onnx: &[u8],
                options: &PolicyOptions,
            ) -> Result<Box<dyn FlatPolicy>, CompileError> {
                Ok(Box::new(GraphFlatPolicy::open(FlatGraph::read(onnx, options)?, self)?))
            }

            fn network(
                &self,
                files: &NetworkFiles<'_>,
                features: usize,
            ) -> Result<Box<dyn GraphAnswers>, CompileError> {
                Ok(Box::new(Graphs::read(files)?.open(self, features)?))
            }
        }
    };
}

runs_graphs!(Tract, "tract", |_| TRACT_VERSION);
runs_graphs!(OnnxRuntime, "onnxruntime", OnnxRuntime::version);

impl<E: Engine<Number = f32> + 'static> GraphAnswers for GraphNetwork<E> {
    fn answer(&mut self, input: &NetworkInput, rows: Rows) -> Result<Answer, CompileError> {
        Ok(Answer::of_graph(input, self.outputs(input, rows)?))
    }
}

impl OnnxRuntimeEngine for OnnxRuntime {
    fn policy_of_variant(
        &self,
        onnx: &[u8],
        variant: &[u8],
        features: usize,
    ) -> Result<Box<dyn Policy>, CompileError> {
        Ok(Box::new(GraphPolicy::of_variant(self, onnx, variant, features)?))
    }

    fn batched_agents(
        &self,
        onnx: &[u8],
        features: usize,
    ) -> Result<Box<dyn BatchedUtilities>, CompileError> {
        Ok(Box::new(BatchedAgents::new(self, onnx, features)?))
    }

    fn batched_team_values(&self, onnx: &[u8]) -> Result<Box<dyn BatchedValues>, CompileError> {
        Ok(Box::new(BatchedTeamValues::new(self, onnx)?))
    }

    fn proposals(
        &self,
        files: &ProposalFiles<'_>,
    ) -> Result<Box<dyn DrawnProposals>, CompileError> {
        let Graphs::Proposals(graphs) = Graphs::read(&NetworkFiles::Proposals(*files))? else {
            return Err(CompileError::OtherNetwork { want: "a proposing allocator's".into() });
        };
        Ok(Box::new(ProposalGraphs::new(graphs.each_ref(), self)?))
    }
}

impl DrawnProposals for ProposalGraphs<SessionEngine> {
    fn propose(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut dyn Draw,
        values: &mut [f32],
    ) -> Result<Vec<u8>, AllocateError> {
        self.draw(state, draw, values)
    }
}
