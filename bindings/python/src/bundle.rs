//! `sortie.Bundle`: a team, its agents and its allocator.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use serde_json::{Value, json};
use sortie_bundle::hex;
use sortie_core::allocate::PointingMemory;
use sortie_core::allocate::proposals::PROPOSALS;
use sortie_core::plan::{AlignedBytes, Network, PlanError, Profile};
use sortie_core::{DecideError, Decision, Guarded, Observation, PlanPolicy, Policy, limits};
use sortie_plans::{BundlePlans, CompileError, CompilerProcess, policy_by_agent, user_cache};

use crate::arrays::array;
use crate::bundle_allocator::{Asked, How, Observations, allocate, point};
use crate::compiler::{carried, program, to_python};
use crate::errors::{exceptions, within, words};
use crate::owned_plan::OwnedPlan;

/// A team: its agents, and the allocator that it learned.
#[pyclass(frozen, module = "sortie")]
pub(crate) struct Bundle {
    bundle: sortie_bundle::Bundle,
    /// The plan of all agents, or one for each of the bundle's graphs.
    agents: Vec<OwnedPlan>,
    allocator: Option<OwnedPlan>,
    /// An allocator that points, in place of one plan.
    pointing: Option<Mutex<PointingMemory>>,
    working: Mutex<Working>,
}

/// What decisions write to.
struct Working {
    /// An arena for each plan.
    arenas: Vec<AlignedBytes>,
    /// The recurrent state of every agent there may be, `[AGENTS, R]`.
    memory: Vec<f32>,
}

#[pymethods]
impl Bundle {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let compiler = CompilerProcess::new(program(py)?, ["compiler"]);
        py.detach(|| Self::open(&folder, compiler)).map_err(|failure| match failure {
            Failure::NoCompiler => carried(py).err().unwrap_or_else(|| {
                exceptions::CompileError::new_err("the compiler cannot be started")
            }),
            Failure::Words(words) => exceptions::BundleError::new_err(within(Some(&folder), words)),
        })
    }

    /// What the team was trained for, and what its parts are.
    fn inspect<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mut report = json!(self.bundle.manifest());
        if let Value::Object(report) = &mut report {
            report.insert("id".to_owned(), hex(self.bundle.id()).into());
        }
        to_python(py, &report)
    }

    /// The action of every agent `[A]`, -1 where none is available.
    #[pyo3(signature = (entities, visible, available, last_actions=None))]
    fn decide<'py>(
        &self,
        entities: &Bound<'py, PyAny>,
        visible: &Bound<'py, PyAny>,
        available: &Bound<'py, PyAny>,
        last_actions: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = entities.py();
        let contract = self.bundle.contract();
        let seen = Observations::read(contract, entities, visible, available, last_actions)?;
        let decisions = py.detach(|| self.decisions(&seen.views()));
        let action = |(agent, decision): (usize, Result<Decision, DecideError>)| match decision {
            Ok(decision) => Ok(i64::from(decision.action)),
            Err(DecideError::NoAvailableAction) => Ok(-1),
            Err(error) => Err(exceptions::DecideError::new_err(format!("agent {agent}: {error}"))),
        };
        let actions = decisions.into_iter().enumerate().map(action);
        let actions = actions.collect::<PyResult<Vec<i64>>>()?;
        Ok(array(py, &[actions.len()], &actions)?.into_any())
    }

    /// The subtask of every agent `[A]` that the team's allocator gives it, -1 for none.
    #[pyo3(signature = (
        entities, agents, entity_tasks, open_tasks, *, present=None, available=None, relation=None, proposals=None,
        seed=0
    ))]
    #[expect(clippy::too_many_arguments, reason = "they are Python's, most by name")]
    fn allocate<'py>(
        &self,
        entities: &Bound<'py, PyAny>,
        agents: usize,
        entity_tasks: &Bound<'py, PyAny>,
        open_tasks: &Bound<'py, PyAny>,
        present: Option<&Bound<'py, PyAny>>,
        available: Option<&Bound<'py, PyAny>>,
        relation: Option<&Bound<'py, PyAny>>,
        proposals: Option<usize>,
        seed: u64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let asked =
            Asked { entities, agents, entity_tasks, open_tasks, present, available, relation };
        if let Some(pointing) = &self.pointing {
            if relation.is_some() || proposals.is_some() {
                let words = "the allocator points at subtasks by entities alone: without `relation` and `proposals`";
                return Err(self.refusal(words));
            }
            return point(&self.bundle, pointing, &asked);
        }
        let Some(plan) = &self.allocator else {
            return Err(self.refusal("the team has learned no allocator"));
        };
        let proposes = plan.plan().header().network == Network::Proposals;
        let how = match (proposes, proposals) {
            (true, Some(0)) => return Err(PyValueError::new_err("`proposals` is at least 1")),
            (true, Some(count)) if count > limits::PROPOSALS => {
                let most = limits::PROPOSALS;
                return Err(PyValueError::new_err(format!("`proposals` is at most {most}")));
            }
            (true, proposals) => How::Propose { proposals: proposals.unwrap_or(PROPOSALS), seed },
            (false, None) => How::Search,
            (false, Some(_)) => {
                return Err(self
                    .refusal("`proposals` is for an allocator that proposes; this one does not"));
            }
        };
        allocate(&self.bundle, plan, &asked, how)
    }

    /// Forgets what was before: an episode begins.
    fn reset(&self, py: Python<'_>) {
        let working = self.working.lock_py_attached(py);
        working.unwrap_or_else(PoisonError::into_inner).memory.fill(0.0);
    }

    fn __repr__(&self) -> String {
        let environment = &self.bundle.manifest().contract.environment.name;
        format!("<sortie.Bundle {} of {environment}>", self.bundle.folder().display())
    }
}

impl Bundle {
    fn open(folder: &std::path::Path, compiler: CompilerProcess) -> Result<Self, Failure> {
        let bundle = sortie_bundle::Bundle::open(folder)?;
        if bundle.options().is_some() {
            let words =
                "agents that run options are not bound; `sortie run` and Rust programs run them";
            return Err(Failure::Words(within(Some(folder), words.to_owned())));
        }
        let plans = BundlePlans::new(compiler, user_cache(), warn);
        let found = plans.agents(&bundle, Profile::Exact)?;
        let mut arenas = found.arenas(limits::AGENTS)?;
        let hidden = found.policy(&mut arenas)?.hidden();
        let agents = found.into_plans().into_iter().map(OwnedPlan::load);
        let agents = agents.collect::<Result<Vec<_>, _>>()?;
        let allocator = match bundle.proposal_graphs() {
            Some(_) => plans.proposals(&bundle, Profile::Exact)?,
            None => plans.allocator(&bundle, Profile::Exact)?,
        };
        let allocator = allocator.map(OwnedPlan::load).transpose()?;
        let pointing = plans.pointing(&bundle)?.map(Mutex::new);
        let memory = vec![0.0; limits::AGENTS * hidden];
        Ok(Self {
            bundle,
            agents,
            allocator,
            pointing,
            working: Mutex::new(Working { arenas, memory }),
        })
    }

    fn refusal(&self, words: &str) -> PyErr {
        PyValueError::new_err(within(Some(self.bundle.folder()), words.to_owned()))
    }

    /// A decision for every agent; where one gets an error, nobody's state changes.
    fn decisions(&self, seen: &[Observation<'_>]) -> Vec<Result<Decision, DecideError>> {
        let mut decisions = vec![Err(DecideError::BadLength); seen.len()];
        let mut working = self.working.lock().unwrap_or_else(PoisonError::into_inner);
        let Working { arenas, memory } = &mut *working;
        let policies = self.agents.iter().zip(arenas);
        let policies = policies
            .map(|(plan, arena)| PlanPolicy::boxed(plan.plan().clone(), arena.as_mut_slice()))
            .collect::<Result<Vec<_>, _>>();
        // They were bound to these arenas when the bundle was opened.
        let Ok(policies) = policies else { return decisions };
        let (graph_of, actions) =
            (&self.bundle.manifest().network.graph_of, self.bundle.contract().actions);
        let mut policy = policy_by_agent(policies, graph_of, actions.into());
        if !self.bundle.guards().is_empty() {
            policy = Box::new(Guarded::new(policy, self.bundle.guards()));
        }
        let mut states = memory.clone();
        let of_these = states.get_mut(..seen.len() * policy.hidden()).unwrap_or_default();
        policy.decide_batch_with(seen, of_these, &mut decisions);
        let is_error = |decision: &Result<Decision, DecideError>| {
            !matches!(decision, Ok(_) | Err(DecideError::NoAvailableAction))
        };
        if !decisions.iter().any(is_error) {
            *memory = states;
        }
        decisions
    }
}

/// Why a bundle cannot be opened.
enum Failure {
    NoCompiler,
    Words(String),
}

impl From<sortie_bundle::BundleError> for Failure {
    fn from(error: sortie_bundle::BundleError) -> Self {
        Self::Words(words(&error))
    }
}

impl From<CompileError> for Failure {
    fn from(error: CompileError) -> Self {
        match error {
            CompileError::NoCompiler { .. } => Self::NoCompiler,
            error => Self::Words(words(&error)),
        }
    }
}

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Self {
        Self::Words(words(&error))
    }
}

/// A note as a warning of Python's.
fn warn(note: &str) {
    Python::attach(|py| {
        let warnings = py.import("warnings");
        let warned = warnings.and_then(|warnings| warnings.call_method1("warn", (note,)));
        // Where warnings are errors this one has nobody to go to.
        if let Err(error) = warned {
            error.write_unraisable(py, None);
        }
    });
}
