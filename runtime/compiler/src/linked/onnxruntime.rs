//! onnxruntime as one engine among others, and as the peer of benchmarks.

use sortie_bundle::OwnedObservation;
use sortie_core::allocate::proposals::Draw;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::{AllocateError, AllocationState, DecideError, Observation, Policy};
use sortie_plans::{
    BatchedUtilities, BatchedValues, Comparison, CompileError, DrawnProposals, Family, FlatPolicy,
    GraphEngine, OnnxRuntimeEngine, OwnedTeamQuery, PolicyOptions, ProposalFiles,
};

use crate::flat::FlatGraph;
use crate::judge::{Judge, judge_agent, judge_team_values};
use crate::onnxruntime::{
    BatchedAgents, BatchedTeamValues, OnnxRuntime, OnnxRuntimeFlatPolicy, OnnxRuntimePolicy,
    OnnxRuntimeProposals, OnnxRuntimeTeamValue,
};

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
