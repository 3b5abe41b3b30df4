//! What executes a bundle's network: its plan, or tract.

use clap::ValueEnum;
use sortie_bundle::Bundle;
use sortie_core::decide::PlanPolicy;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile};
use sortie_core::{Policy, Remembering, limits};
use sortie_plans::{CompileError, Ending, GraphEngine, TeamPolicy, TeamSizes, roles_of};

use crate::compiler::{compiler, plans};
use crate::engines::engines;
use crate::failure::{Exit, Failure, Outcome, with_sources};

/// What executes networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Backend {
    /// The compiled plan
    Plan,
    /// The ONNX graph itself, by tract
    Tract,
}

impl Backend {
    /// Goes on as the program that links the engine, where this one does not: before anything is opened or drawn that
    /// the other would open or draw once more.
    pub(crate) fn prepare(self) -> Outcome {
        match self {
            Self::Plan => Ok(()),
            Self::Tract => engines().map(drop),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Plan => "plan",
            Self::Tract => "tract",
        }
    }
}

/// An arithmetic profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PlanProfile {
    /// The same bits on every target
    Exact,
    /// Fused multiply-add: faster for teams, the same bits on every target that has the instruction
    Fused,
    /// int8 weights: a quarter of the bytes, faster, nearly the same utilities; the same bits on every target
    Int8,
}

impl PlanProfile {
    /// As the plan's header has it.
    pub(crate) fn profile(self) -> Profile {
        match self {
            Self::Exact => Profile::Exact,
            Self::Fused => Profile::Fused,
            Self::Int8 => Profile::Int8,
        }
    }
}

/// The memory of a bundle's policy.
pub(crate) struct DeployedPolicy {
    engine: Engine,
    /// What the agents of one team remember, `[A, R]`.
    memory: Vec<f32>,
}

enum Engine {
    Plan { plan: AlignedBytes, arena: AlignedBytes },
    Graph(Box<dyn Policy>),
}

impl DeployedPolicy {
    /// The bundle's plan, which has given its golden answers, or its graph.
    pub(crate) fn open(bundle: &Bundle, backend: Backend) -> Result<Self, Failure> {
        Self::open_as(bundle, backend, Profile::Exact)
    }

    /// As [`Self::open`], the plan in any profile.
    pub(crate) fn open_as(
        bundle: &Bundle,
        backend: Backend,
        profile: Profile,
    ) -> Result<Self, Failure> {
        let within = |error| Failure::from(error).within(bundle.folder().display());
        match backend {
            Backend::Plan => plans().agent(bundle, profile).and_then(Self::of_plan).map_err(within),
            Backend::Tract => Self::of_graph(bundle, engines()?.tract()).map_err(within),
        }
    }

    /// The graph in an engine, once another process has read and run it.
    pub(crate) fn of_graph(
        bundle: &Bundle,
        engine: &dyn GraphEngine,
    ) -> Result<Self, CompileError> {
        let policy = graph_policy(bundle, engine)?;
        let memory = vec![0.0; limits::AGENTS * policy.hidden()];
        Ok(Self { engine: Engine::Graph(policy), memory })
    }

    /// The policy of a plan.
    pub(crate) fn of_plan(plan: AlignedBytes) -> Result<Self, CompileError> {
        // A process may act for any number of agents.
        let loaded = Plan::load(plan.as_slice())?;
        let arena = AlignedBytes::zeroed(loaded.batch_arena_bytes(limits::AGENTS));
        let memory = vec![0.0; limits::AGENTS * loaded.hidden()];
        Ok(Self { engine: Engine::Plan { plan, arena }, memory })
    }

    /// The policy over this memory, for callers that keep what agents remember.
    pub(crate) fn policy(&mut self) -> Result<Box<dyn Policy + '_>, Failure> {
        self.engine.policy()
    }

    /// The policy over this memory, that of one team: it keeps what agents remember, until their episode is over.
    pub(crate) fn team(&mut self) -> Result<Box<dyn Policy + '_>, Failure> {
        let Self { engine, memory } = self;
        if memory.is_empty() {
            return engine.policy();
        }
        Ok(match engine {
            Engine::Plan { plan, arena } => {
                let plan = Plan::load(plan.as_slice()).map_err(CompileError::from)?;
                let policy = PlanPolicy::new(plan, arena.as_mut_slice());
                Box::new(Remembering::new(policy.map_err(CompileError::from)?, memory))
            }
            Engine::Graph(policy) => Box::new(Remembering::new(policy.as_mut(), memory)),
        })
    }
}

/// The graph of a bundle's agent in an engine, once another process has read and run it.
pub(crate) fn graph_policy(
    bundle: &Bundle,
    engine: &dyn GraphEngine,
) -> Result<Box<dyn Policy>, CompileError> {
    let (onnx, contract) = (bundle.agent_onnx(), bundle.contract());
    if let Some(roles) = roles_of(bundle)? {
        compiler().rehearse_policy(onnx, &roles)?;
        let policy = engine.flat_policy(onnx, &roles)?;
        return Ok(Box::new(TeamPolicy::new(
            policy,
            TeamSizes::of(contract, bundle.manifest().limits.n_max),
        )?));
    }
    let features = contract.features.into();
    compiler().rehearse(onnx, bundle.manifest().limits.n_max.into(), Some(features))?;
    engine.policy(onnx, features)
}

impl Engine {
    fn policy(&mut self) -> Result<Box<dyn Policy + '_>, Failure> {
        match self {
            Self::Plan { plan, arena } => {
                let policy = Plan::load(plan.as_slice())
                    .and_then(|plan| PlanPolicy::boxed(plan, arena.as_mut_slice()))
                    .map_err(CompileError::from)?;
                Ok(policy)
            }
            Self::Graph(policy) => Ok(Box::new(policy.as_mut())),
        }
    }
}

impl From<CompileError> for Failure {
    fn from(error: CompileError) -> Self {
        let exit = match &error {
            CompileError::Plan(PlanError::Version { .. }) => Exit::Mismatch,
            CompileError::Size { .. } | CompileError::NoAgent { .. } => Exit::Mismatch,
            error if error.asks() => Exit::Usage,
            CompileError::Differs { .. } => Exit::Bug,
            CompileError::NoCompiler { .. } => Exit::NotRunning,
            CompileError::NoProcess { .. } => Exit::InputOutput,
            // Ctrl-C reaches every process of the terminal.
            CompileError::GivenUp { ending: Ending::Signal(2), .. } => Exit::Interrupted,
            _ => Exit::BadData,
        };
        Self::new(exit, with_sources(&error))
    }
}
