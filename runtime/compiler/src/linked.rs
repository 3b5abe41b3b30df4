//! The engines and the compiler of a program that links this crate.

use std::io;
use std::path::Path;

use sortie_bundle::{OwnedAllocationState, OwnedObservation, Recording};
use sortie_core::allocate::proposals::Draw;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::{AllocateError, AllocationState, DecideError, Observation, Policy};
use sortie_plans::{
    BatchedUtilities, BatchedValues, Comparison, CompileError, CompileOptions, Compiled,
    CompiledPolicy, Compiler, DrawnProposals, Engines, Family, FlatPolicy, GraphEngine,
    OnnxRuntimeEngine, OnnxRuntimeError, OwnedEntities, OwnedTeamQuery, PolicyOptions,
    ProposalFiles, TrueFlatPolicy,
};

use crate::answer::answer_compiler;
use crate::compile::{
    compare_entities_with_graph, compare_proposals_with_graphs, compile, compile_policy,
    compile_proposals, compile_rounded,
};
use crate::flat::FlatGraph;
use crate::judge::{Judge, judge_agent, judge_team_values};
use crate::onnxruntime::{
    BatchedAgents, BatchedTeamValues, OnnxRuntime, OnnxRuntimeFlatPolicy, OnnxRuntimePolicy,
    OnnxRuntimeProposals, OnnxRuntimeTeamValue, find_library,
};
use crate::reference::TruePolicy;
use crate::tract::{TractFlatPolicy, TractPolicy, TractTeamValue};

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
        let FlatGraph { source, interface, .. } = FlatGraph::read(onnx, options)?;
        Ok(Box::new(TruePolicy::new(&source, interface)?))
    }

    fn team_value_columns(&self, onnx: &[u8]) -> Result<(usize, usize), CompileError> {
        TractTeamValue::new(onnx).map(|network| network.columns())
    }

    fn compare_entities(
        &self,
        plan: &[u8],
        onnx: &[u8],
        steps: &[OwnedEntities],
    ) -> Result<Comparison, CompileError> {
        compare_entities_with_graph(plan, onnx, steps)
    }

    fn compare_proposals(
        &self,
        plan: &[u8],
        files: &ProposalFiles<'_>,
        states: &[OwnedAllocationState],
        seed: u64,
    ) -> Result<Comparison, CompileError> {
        compare_proposals_with_graphs(plan, files, states, seed)
    }
}

struct Tract;

impl GraphEngine for Tract {
    fn name(&self) -> &'static str {
        Judge::Tract.name()
    }

    fn version(&self) -> &str {
        TRACT_VERSION
    }

    fn policy(&self, onnx: &[u8], features: usize) -> Result<Box<dyn Policy>, CompileError> {
        Ok(Box::new(TractPolicy::new(onnx, features)?))
    }

    fn team_value(&self, onnx: &[u8]) -> Result<Box<dyn TeamValueNetwork>, CompileError> {
        Ok(Box::new(TractTeamValue::new(onnx)?))
    }

    fn flat_policy(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<Box<dyn FlatPolicy>, CompileError> {
        let graph = FlatGraph::read(onnx, options)?;
        Ok(Box::new(TractFlatPolicy::from_graph(graph)?))
    }

    fn judge_agent(
        &self,
        plan: &[u8],
        onnx: &[u8],
        families: &[Family<OwnedObservation>],
    ) -> Result<Vec<Comparison>, CompileError> {
        judge_agent(plan, onnx, Judge::Tract, families)
    }

    fn judge_team_values(
        &self,
        plan: &[u8],
        onnx: &[u8],
        families: &[Family<OwnedTeamQuery>],
    ) -> Result<Vec<Comparison>, CompileError> {
        judge_team_values(plan, onnx, Judge::Tract, families)
    }
}

impl GraphEngine for OnnxRuntime {
    fn name(&self) -> &'static str {
        "onnxruntime"
    }

    fn version(&self) -> &str {
        self.version()
    }

    fn policy(&self, onnx: &[u8], features: usize) -> Result<Box<dyn Policy>, CompileError> {
        Ok(Box::new(OnnxRuntimePolicy::new(self, onnx, features)?))
    }

    fn team_value(&self, onnx: &[u8]) -> Result<Box<dyn TeamValueNetwork>, CompileError> {
        Ok(Box::new(OnnxRuntimeTeamValue::new(self, onnx)?))
    }

    fn flat_policy(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<Box<dyn FlatPolicy>, CompileError> {
        let graph = FlatGraph::read(onnx, options)?;
        Ok(Box::new(OnnxRuntimeFlatPolicy::from_graph(self, graph)?))
    }

    fn judge_agent(
        &self,
        plan: &[u8],
        onnx: &[u8],
        families: &[Family<OwnedObservation>],
    ) -> Result<Vec<Comparison>, CompileError> {
        judge_agent(plan, onnx, Judge::OnnxRuntime(self), families)
    }

    fn judge_team_values(
        &self,
        plan: &[u8],
        onnx: &[u8],
        families: &[Family<OwnedTeamQuery>],
    ) -> Result<Vec<Comparison>, CompileError> {
        judge_team_values(plan, onnx, Judge::OnnxRuntime(self), families)
    }
}

impl OnnxRuntimeEngine for OnnxRuntime {
    fn policy_of_variant(
        &self,
        onnx: &[u8],
        variant: &[u8],
        features: usize,
    ) -> Result<Box<dyn Policy>, CompileError> {
        Ok(Box::new(OnnxRuntimePolicy::of_variant(self, onnx, variant, features)?))
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
        entities: usize,
    ) -> Result<Box<dyn DrawnProposals>, CompileError> {
        Ok(Box::new(OnnxRuntimeProposals::new(self, files, entities)?))
    }
}

impl BatchedUtilities for BatchedAgents {
    fn utilities(
        &mut self,
        frame: &[Observation<'_>],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.utilities(frame, utilities)
    }
}

impl BatchedValues for BatchedTeamValues {
    fn values(
        &mut self,
        queries: &[TeamQuery<'_>],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        self.values(queries, values)
    }
}

impl DrawnProposals for OnnxRuntimeProposals {
    fn propose(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut dyn Draw,
        values: &mut [f32],
    ) -> Result<Vec<u8>, AllocateError> {
        self.propose(state, draw, values)
    }
}
