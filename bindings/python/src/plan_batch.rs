//! Decisions on many cases in one call, while Python's other threads go on.

use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use sortie_core::DecideError;
use sortie_plans::{OutputRole, PolicyInput};

use crate::arrays::{array, array_as, flags, mask, numbers, slice};
use crate::errors::exceptions;
use crate::interface::{Asked, Fit, Interface, choices, choices_shape, fit, mask_shape, shape_as};
use crate::owned_plan::OwnedPlan;

/// Copies of all that is given, so that other threads may write to the arrays meanwhile.
struct Cases {
    count: usize,
    /// The numbers of every input, case by case.
    inputs: Vec<Column>,
    /// Availability, case by case; empty where everything is available.
    available: Vec<u16>,
    states: Vec<f32>,
}

/// An input over all cases.
struct Column {
    numbers: Vec<f32>,
    width: usize,
}

/// What was decided: places of actions, or numbers.
#[derive(Default)]
struct Decided {
    chosen: Vec<i64>,
    numbers: Vec<f32>,
    /// The states afterwards.
    states: Vec<f32>,
}

/// A policy that is asked about many cases.
pub(crate) struct Batch<'a> {
    pub(crate) plan: &'a OwnedPlan,
    pub(crate) interface: &'a Interface,
}

impl Batch<'_> {
    pub(crate) fn decide<'py>(
        &self,
        observations: &Bound<'py, PyTuple>,
        named: Option<&Bound<'py, PyDict>>,
        available: Option<&Bound<'py, PyAny>>,
        states: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = observations.py();
        let output = self.interface.action()?;
        let given = self.interface.collect(observations, named, Asked::AllButMask)?;
        let cases = self.read(&given, available, states)?;
        let actions = match output.role {
            OutputRole::Discrete(actions) => Some(actions),
            _ => None,
        };
        let count = cases.count;
        let decided = py.detach(|| cases.decide(self.plan, actions));
        let decided = decided.map_err(|(case, error)| {
            exceptions::DecideError::new_err(format!("case {case}: {error}"))
        })?;
        if let Some(states) = states {
            let mut states = states.cast::<PyArrayDyn<f32>>()?.try_readwrite()?;
            states.as_slice_mut()?.copy_from_slice(&decided.states);
        }
        let shape = |rest: &[usize]| [&[count], rest].concat();
        if actions.is_some() {
            let shape = shape(choices_shape(output, Fit::WithoutBatch));
            return Ok(array(py, &shape, &decided.chosen)?.into_any());
        }
        let shape = shape(shape_as(&output.shape, Fit::WithoutBatch));
        array_as(py, output.kind, &shape, &decided.numbers)
    }

    /// What was given for every input, and beside.
    fn read(
        &self,
        given: &[Option<Bound<'_, PyAny>>],
        available: Option<&Bound<'_, PyAny>>,
        states: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Cases> {
        let (mut count, mut columns) = (None, Vec::with_capacity(given.len()));
        for (input, given) in self.interface.given.iter().zip(given) {
            let Some(given) = given else {
                columns.push(None);
                continue;
            };
            let array = numbers(&input.name, given)?;
            let (cases, sizes) =
                array.shape().split_first().ok_or_else(|| no_cases(&input.name))?;
            fit(&input.name, &input.shape, sizes)?;
            if *count.get_or_insert(*cases) != *cases {
                return Err(PyValueError::new_err(format!(
                    "`{}` has {cases} cases, the inputs before have others",
                    input.name
                )));
            }
            columns.push(Some(slice(&array)?.to_vec()));
        }
        let count = count.ok_or_else(|| self.interface.misfit(Asked::AllButMask))?;
        let available = match available {
            Some(available) => {
                let shape = mask_shape(self.interface.action()?)?;
                mask("available", available, &[&[count], shape.as_slice()].concat())?
            }
            None => Vec::new(),
        };
        let column = |(input, column): (&PolicyInput, Option<Vec<f32>>)| {
            let width = input.length();
            let numbers = match column {
                Some(numbers) => numbers,
                None => flags(&available, count * width)?,
            };
            Ok(Column { numbers, width })
        };
        let inputs = self.interface.given.iter().zip(columns).map(column);
        let inputs = inputs.collect::<PyResult<_>>()?;
        let states = read_states(states, [count, self.plan.plan().hidden()])?;
        Ok(Cases { count, inputs, available, states })
    }
}

impl Cases {
    /// Decides on one case after the other; the error names the first on which nothing could be decided.
    fn decide(
        self,
        plan: &OwnedPlan,
        actions: Option<usize>,
    ) -> Result<Decided, (usize, DecideError)> {
        let (mut arena, plan) = (plan.arena(), plan.plan());
        let widths = plan.outputs();
        let mut outputs: Vec<Vec<f32>> = widths.map(|width| vec![0.0; width]).collect();
        let hidden = plan.hidden();
        let masks = self.available.len().checked_div(self.count).unwrap_or(0);
        let mut decided = Decided { states: self.states, ..Decided::default() };
        for case in 0..self.count {
            let failed = |error| (case, error);
            let inputs =
                self.inputs.iter().map(|column| of_case(&column.numbers, case, column.width));
            let inputs: Vec<&[f32]> = inputs.collect();
            let mut to: Vec<&mut [f32]> = outputs.iter_mut().map(Vec::as_mut_slice).collect();
            let states = decided.states.get_mut(case * hidden..(case + 1) * hidden);
            let states = states.unwrap_or_default();
            plan.respond(arena.as_mut_slice(), &inputs, states, &mut to).map_err(failed)?;
            let first = outputs.first().map(Vec::as_slice).unwrap_or_default();
            match actions {
                Some(actions) => {
                    let mask = of_case(&self.available, case, masks);
                    decided.chosen.extend(choices(first, actions, mask).map_err(failed)?);
                }
                None => decided.numbers.extend_from_slice(first),
            }
        }
        Ok(decided)
    }
}

/// The numbers of one case.
fn of_case<T>(numbers: &[T], case: usize, width: usize) -> &[T] {
    numbers.get(case * width..(case + 1) * width).unwrap_or_default()
}

/// A copy of the states, which are written to afterwards.
fn read_states(states: Option<&Bound<'_, PyAny>>, want: [usize; 2]) -> PyResult<Vec<f32>> {
    let needed = || {
        PyTypeError::new_err(format!(
            "the policy is recurrent: give `states`, a C-contiguous float32 array {want:?} that is written to, zero where episodes begin"
        ))
    };
    match (states, want) {
        (None, [_, 0]) => Ok(Vec::new()),
        (None, _) => Err(needed()),
        (Some(_), [_, 0]) => {
            Err(PyTypeError::new_err("the policy is not recurrent: it takes no `states`"))
        }
        (Some(states), _) => {
            let states = states.cast::<PyArrayDyn<f32>>().map_err(|_| needed())?;
            fit("states", &want, states.shape())?;
            let states = states.try_readwrite()?;
            if !states.is_c_contiguous() {
                return Err(needed());
            }
            Ok(states.as_slice()?.to_vec())
        }
    }
}

fn no_cases(name: &str) -> PyErr {
    PyValueError::new_err(format!("`{name}` needs a first axis that counts the cases"))
}
