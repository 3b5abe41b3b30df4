//! `sortie.Plan`: a policy that is called.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::{PyDict, PyTuple};
use serde_json::{Value, json};
use sortie_core::DecideError;
use sortie_core::plan::{AlignedBytes, GuardFacts, Network, PlanError, RobotFacts};
use sortie_plans::{OutputRole, PolicyOutput, inspect_plan};

use crate::arrays::{Numbers, array, array_as, flags, mask, numbers, slice};
use crate::compiler::{Asked as Options, Source, to_python};
use crate::errors::{exceptions, of_decision, words};
use crate::interface::{Asked, Fit, Interface, choices, choices_shape, fit, mask_shape, shape_as};
use crate::owned_plan::OwnedPlan;
use crate::plan_batch::Batch;

/// A policy as a plan.
#[pyclass(frozen, module = "sortie")]
pub(crate) struct Plan {
    plan: OwnedPlan,
    interface: Interface,
    working: Mutex<Working>,
}

/// What a decision writes to.
struct Working {
    arena: AlignedBytes,
    /// The recurrent states, one behind the other.
    states: Vec<f32>,
    /// The numbers of every wanted output.
    outputs: Vec<Vec<f32>>,
}

/// What was given for the inputs, in the plan's order.
struct Given<'py> {
    numbers: Vec<Part<'py>>,
    fit: Fit,
}

enum Part<'py> {
    Array(Numbers<'py>),
    Mask(Vec<f32>),
}

impl Part<'_> {
    fn slice(&self) -> PyResult<&[f32]> {
        match self {
            Self::Array(numbers) => slice(numbers),
            Self::Mask(numbers) => Ok(numbers),
        }
    }
}

#[pymethods]
impl Plan {
    #[new]
    #[pyo3(signature = (source, profile="exact", *, outputs=Vec::new(), sizes=BTreeMap::new(), states=Vec::new(), available=None))]
    fn new(
        source: &Bound<'_, PyAny>,
        profile: &str,
        outputs: Vec<String>,
        sizes: BTreeMap<String, usize>,
        states: Vec<String>,
        available: Option<String>,
    ) -> PyResult<Self> {
        let py = source.py();
        let options = Options::new(profile, outputs, sizes, states, available)?;
        let source = Source::read(source)?;
        if source.is_plan() {
            options.check_nothing(&source)?;
            return Self::load(&source, &source.bytes);
        }
        Self::load(&source, &options.compile(py, &source)?.bytes)
    }

    /// Answers one case: an array, or a dict where several outputs are wanted.
    #[pyo3(signature = (*inputs, **named))]
    fn __call__<'py>(
        &self,
        inputs: &Bound<'py, PyTuple>,
        named: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = inputs.py();
        let given = self.given(inputs, named, Asked::Everything, None)?;
        let mut working = self.working(py);
        self.respond(&mut working, &given)?;
        let answer = |output: &PolicyOutput, numbers: &[f32]| {
            let shape = shape_as(&output.shape, given.fit);
            match output.role {
                OutputRole::Discrete(actions) if output.kind.is_integer() => {
                    let places = sortie_plans::choices(numbers, actions).map(|place| place as f32);
                    array_as(py, output.kind, shape, &places.collect::<Vec<f32>>())
                }
                _ => array_as(py, output.kind, shape, numbers),
            }
        };
        let wanted = self.interface.wanted.as_slice();
        if let ([output], [numbers]) = (wanted, working.outputs.as_slice())
            && output.kind.is_float()
        {
            return answer(output, numbers);
        }
        // What is made below may run any Python, which may call this plan.
        let outputs = working.outputs.clone();
        drop(working);
        if let ([output], [numbers]) = (wanted, outputs.as_slice()) {
            return answer(output, numbers);
        }
        let named = PyDict::new(py);
        for (output, numbers) in wanted.iter().zip(&outputs) {
            named.set_item(&output.name, answer(output, numbers)?)?;
        }
        Ok(named.into_any())
    }

    /// The action of one case.
    #[pyo3(signature = (*inputs, available=None, **named))]
    fn decide<'py>(
        &self,
        inputs: &Bound<'py, PyTuple>,
        available: Option<&Bound<'py, PyAny>>,
        named: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = inputs.py();
        let output = self.interface.action()?;
        let mask = self.mask(output, available)?;
        let given = self.given(inputs, named, Asked::AllButMask, Some(&mask))?;
        let mut working = self.working(py);
        self.respond(&mut working, &given)?;
        let numbers = working.outputs.first().ok_or_else(no_outputs)?;
        let OutputRole::Discrete(actions) = output.role else {
            let numbers = numbers.clone();
            drop(working);
            return array_as(py, output.kind, shape_as(&output.shape, given.fit), &numbers);
        };
        let chosen = choices(numbers, actions, &mask).map_err(of_decision)?;
        drop(working);
        if let [action] = chosen.as_slice() {
            return Ok(action.into_pyobject(py)?.into_any());
        }
        Ok(array(py, choices_shape(output, given.fit), &chosen)?.into_any())
    }

    /// The actions of many cases, which are worked on while Python's other threads go on.
    #[pyo3(signature = (*observations, available=None, states=None, **named))]
    fn decide_batch<'py>(
        &self,
        observations: &Bound<'py, PyTuple>,
        available: Option<&Bound<'py, PyAny>>,
        states: Option<&Bound<'py, PyAny>>,
        named: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let batch = Batch { plan: &self.plan, interface: &self.interface };
        batch.decide(observations, named, available, states)
    }

    /// The recurrent states, one behind the other: a copy.
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let states = self.working(py).states.clone();
        Ok(array(py, &[states.len()], &states)?.into_any())
    }

    #[setter]
    fn set_state(&self, given: &Bound<'_, PyAny>) -> PyResult<()> {
        let given = numbers("state", given)?;
        let mut working = self.working(given.py());
        fit("state", &[working.states.len()], given.shape())?;
        working.states.copy_from_slice(slice(&given)?);
        Ok(())
    }

    /// Forgets what was before: an episode begins.
    fn reset(&self, py: Python<'_>) {
        self.working(py).states.fill(0.0);
    }

    /// What the plan takes, gives, computes and costs.
    fn inspect<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let facts = inspect_plan(self.plan.bytes());
        let facts = facts.map_err(|error| exceptions::PlanError::new_err(words(&error)))?;
        let mut report = json!(facts);
        if let Value::Object(report) = &mut report {
            let named = || json!({ "facts": self.interface.facts });
            report.entry("policy").or_insert_with(named);
        }
        to_python(py, &report)
    }

    /// What a robot must know of the policy beside the numbers.
    #[getter]
    fn robot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &json!(RobotFacts::of_plan(self.plan.bytes()).unwrap_or_default()))
    }

    /// What is let in and out of the policy, where its plan says.
    #[getter]
    fn guards<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let guards = GuardFacts::of_plan(self.plan.bytes());
        to_python(py, &json!(guards.map_err(|error| PyValueError::new_err(error.to_string()))?))
    }

    fn __repr__(&self) -> String {
        format!("<sortie.Plan {}>", self.interface.summary())
    }
}

impl Plan {
    fn load(source: &Source, bytes: &[u8]) -> PyResult<Self> {
        let refused = |words: String| exceptions::PlanError::new_err(source.said(words));
        let plan = OwnedPlan::load(AlignedBytes::copy_of(bytes));
        let plan = plan.map_err(|error: PlanError| refused(words(&error)))?;
        let network = plan.plan().header().network;
        if network != Network::Policy {
            return Err(refused(format!(
                "this plan is no policy's over inputs of fixed sizes (network {}); `sortie.Bundle` runs the teams of bundles",
                network.name()
            )));
        }
        let interface = Interface::of(bytes, plan.plan());
        let interface = interface.map_err(|error| refused(words(&error)))?;
        let widths = plan.plan().outputs();
        let outputs = widths.map(|width| vec![0.0; width]).collect();
        let states = vec![0.0; plan.plan().hidden()];
        let working = Mutex::new(Working { arena: plan.arena(), states, outputs });
        Ok(Self { plan, interface, working })
    }

    fn working(&self, py: Python<'_>) -> MutexGuard<'_, Working> {
        self.working.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }

    /// The mask of available actions in the order of the scores; empty where everything is available.
    fn mask(
        &self,
        output: &PolicyOutput,
        available: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Vec<u16>> {
        let Some(available) = available else { return Ok(Vec::new()) };
        let shape = mask_shape(output)?;
        mask("available", available, &shape)
    }

    /// What was given, in the plan's order.
    fn given<'py>(
        &self,
        inputs: &Bound<'py, PyTuple>,
        named: Option<&Bound<'py, PyDict>>,
        asked: Asked,
        mask: Option<&[u16]>,
    ) -> PyResult<Given<'py>> {
        let given = self.interface.collect(inputs, named, asked)?;
        let (mut parts, mut overall) = (Vec::with_capacity(given.len()), Fit::Exact);
        let mut given = given.into_iter();
        for input in &self.interface.given {
            let Some(array) = given.next().flatten() else {
                parts.push(Part::Mask(flags(mask.unwrap_or_default(), input.length())?));
                continue;
            };
            let array = numbers(&input.name, &array)?;
            if fit(&input.name, &input.shape, array.shape())? == Fit::WithoutBatch {
                overall = Fit::WithoutBatch;
            }
            parts.push(Part::Array(array));
        }
        Ok(Given { numbers: parts, fit: overall })
    }

    /// Runs the plan and writes its outputs.
    fn respond(&self, working: &mut Working, given: &Given<'_>) -> PyResult<()> {
        let Working { arena, states, outputs } = working;
        let plan = self.plan.plan();
        let arena = arena.as_mut_slice();
        let answered = match (given.numbers.as_slice(), outputs.as_mut_slice()) {
            ([input], [output]) => plan.respond(arena, &[input.slice()?], states, &mut [output]),
            (inputs, outputs) => {
                let inputs = inputs.iter().map(Part::slice).collect::<PyResult<Vec<_>>>()?;
                let mut outputs: Vec<&mut [f32]> =
                    outputs.iter_mut().map(Vec::as_mut_slice).collect();
                plan.respond(arena, &inputs, states, &mut outputs)
            }
        };
        answered.map_err(|error| self.refusal(error, given))
    }

    /// Why nothing could be decided, with the input's name where that is known.
    #[cold]
    fn refusal(&self, error: DecideError, given: &Given<'_>) -> PyErr {
        let inputs = self.interface.given.iter().zip(&given.numbers);
        let is_flawed = |part: &Part<'_>| {
            part.slice().is_ok_and(|numbers| !numbers.iter().all(|number| number.is_finite()))
        };
        match inputs.into_iter().find(|(_, part)| is_flawed(part)) {
            Some((input, _)) => {
                exceptions::DecideError::new_err(format!("{error}: look at `{}`", input.name))
            }
            None => of_decision(error),
        }
    }
}

fn no_outputs() -> PyErr {
    PyTypeError::new_err("the plan gives no outputs, only decisions")
}
