//! What executes a bundle's network: its plan, or tract.

use clap::ValueEnum;
use sortie_bundle::{AgentGraph, Bundle};
use sortie_core::plan::{AlignedBytes, PlanError, Profile};
use sortie_core::{Guarded, Policy, Remembering, limits};
use sortie_plans::{
    AgentPlans, CompileError, Ending, FlatPolicy, GraphEngine, PolicyOptions, TeamPolicy,
    TeamSizes, options_over_graphs, policy_by_agent, roles_of,
};

use crate::failure::{Exit, Failure, Outcome, with_sources};
use crate::tools::{compiler, engines, plans};

/// What executes networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Backend {
    /// The compiled plan
    Plan,
    /// The ONNX graph itself, by tract
    Tract,
}

impl Backend {
    /// Goes on as the program that links the engine, where this one does not: before anything is opened or drawn that
    /// the other would open or draw once more.
    pub fn prepare(self) -> Outcome {
        match self {
            Self::Plan => Ok(()),
            Self::Tract => engines().map(drop),
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Plan => "plan",
            Self::Tract => "tract",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PlanProfile {
    /// The same bits on every target
    Exact,
    /// Fused multiply-add: faster for teams, the same bits on every target that has the instruction
    Fused,
    /// int8 weights: a quarter of the bytes, faster, nearly the same utilities; the same bits on every target
    Int8,
}

impl PlanProfile {
    /// As the plan's header has it.
    pub fn profile(self) -> Profile {
        match self {
            Self::Exact => Profile::Exact,
            Self::Fused => Profile::Fused,
            Self::Int8 => Profile::Int8,
        }
    }
}

/// The memory of a bundle's policy.
pub struct DeployedPolicy {
    engine: Engine,
    /// What the agents of one team remember, `[A, R]`.
    memory: Vec<f32>,
    /// In which their features must lie, `[d, 2]`; empty where they are not guarded.
    ranges: Vec<[f32; 2]>,
}

enum Engine {
    Plans { plans: AgentPlans, arenas: Vec<AlignedBytes> },
    Graph(Box<dyn Policy + Send>),
}

impl DeployedPolicy {
    /// The bundle's plans, which have given its golden answers, or its graphs.
    pub fn open(bundle: &Bundle, backend: Backend) -> Result<Self, Failure> {
        Self::open_as(bundle, backend, Profile::Exact)
    }

    /// As [`Self::open`], the plans in any profile.
    pub fn open_as(bundle: &Bundle, backend: Backend, profile: Profile) -> Result<Self, Failure> {
        let within = |error| Failure::from(error).within(bundle.folder().display());
        let policy = match backend {
            Backend::Plan => plans().agents(bundle, profile).and_then(Self::of_plans),
            Backend::Tract => Self::of_graph(bundle, engines()?.tract()),
        };
        Ok(Self { ranges: bundle.guards().to_vec(), ..policy.map_err(within)? })
    }

    /// The graphs in an engine, once another process has read and run them.
    pub fn of_graph(bundle: &Bundle, engine: &dyn GraphEngine) -> Result<Self, CompileError> {
        let policy = graph_policy(bundle, engine)?;
        let memory = vec![0.0; limits::AGENTS * policy.hidden()];
        Ok(Self { engine: Engine::Graph(policy), memory, ranges: Vec::new() })
    }

    /// The policy of a bundle's plans.
    pub fn of_plans(plans: AgentPlans) -> Result<Self, CompileError> {
        // A process may act for any number of agents.
        let mut arenas = plans.arenas(limits::AGENTS)?;
        let hidden = plans.policy(&mut arenas)?.hidden();
        let memory = vec![0.0; limits::AGENTS * hidden];
        Ok(Self { engine: Engine::Plans { plans, arenas }, memory, ranges: Vec::new() })
    }

    /// The policy over this memory, for callers that keep what agents remember. It is not guarded: what a network answers
    /// is a question of its own.
    pub fn policy(&mut self) -> Result<Box<dyn Policy + Send + '_>, Failure> {
        self.engine.policy()
    }

    /// The policy over this memory, that of one team: it keeps what agents remember, until their episode is over, and
    /// refuses what the bundle's guards do not let in.
    pub fn team(&mut self) -> Result<Box<dyn Policy + Send + '_>, Failure> {
        let Self { engine, memory, ranges } = self;
        let mut policy = engine.policy()?;
        if !memory.is_empty() {
            policy = Box::new(Remembering::new(policy, memory));
        }
        Ok(if ranges.is_empty() { policy } else { Box::new(Guarded::new(policy, ranges)) })
    }
}

/// The graphs of a bundle's agents in an engine, once another process has read and run them.
pub fn graph_policy(
    bundle: &Bundle,
    engine: &dyn GraphEngine,
) -> Result<Box<dyn Policy + Send>, CompileError> {
    let (onnx, contract) = (bundle.agent_onnx(), bundle.contract());
    if let Some(options) = bundle.options() {
        return options_over_graphs(bundle, options, option_graphs(bundle, engine)?);
    }
    if let Some(roles) = roles_of(bundle)? {
        let policy = |graph: &AgentGraph| -> Result<Box<dyn Policy + Send>, CompileError> {
            let onnx = bundle.graph_onnx(graph);
            compiler().rehearse_policy(onnx, &roles)?;
            let policy = engine.flat_policy(onnx, &roles)?;
            Ok(Box::new(TeamPolicy::new(policy, TeamSizes::of(bundle, graph))?))
        };
        let policies = bundle.agent_graphs().iter().map(policy).collect::<Result<_, _>>()?;
        let graph_of = &bundle.manifest().network.graph_of;
        return Ok(policy_by_agent(policies, graph_of, contract.actions.into()));
    }
    let features = contract.features.into();
    compiler().rehearse(onnx, bundle.manifest().limits.n_max.into(), Some(features))?;
    engine.policy(onnx, features)
}

/// Controller, meta-controller and affordances in an engine, once another process has read and run them.
pub fn option_graphs(
    bundle: &Bundle,
    engine: &dyn GraphEngine,
) -> Result<[Box<dyn FlatPolicy>; 3], CompileError> {
    let roles = PolicyOptions::default();
    let graph = |graph: &AgentGraph| {
        let onnx = bundle.graph_onnx(graph);
        compiler().rehearse_policy(onnx, &roles)?;
        engine.flat_policy(onnx, &roles)
    };
    let [controller, meta, affordance] = bundle.option_graphs();
    Ok([graph(&controller)?, graph(&meta)?, graph(&affordance)?])
}

impl Engine {
    fn policy(&mut self) -> Result<Box<dyn Policy + Send + '_>, Failure> {
        match self {
            Self::Plans { plans, arenas } => {
                Ok(plans.policy(arenas).map_err(CompileError::from)?)
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
            CompileError::Wrong { .. } | CompileError::AnswersOtherwise { .. } => Exit::Bug,
            CompileError::NoCompiler { .. } => Exit::NotRunning,
            CompileError::OtherVersion { .. } => Exit::Mismatch,
            CompileError::NoProcess { .. } => Exit::InputOutput,
            // Ctrl-C reaches every process of the terminal.
            CompileError::GivenUp { ending: Ending::Signal(2), .. } => Exit::Interrupted,
            _ => Exit::BadData,
        };
        Self::new(exit, with_sources(&error))
    }
}
