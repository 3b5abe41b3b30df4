//! What a policy takes and gives, as calls need it.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use sortie_core::DecideError;
use sortie_core::choose::masked_argmax;
use sortie_core::plan::Plan;
use sortie_ipc::{PolicySchema, Port};
use sortie_plans::{
    Annex, CompileError, InputRole, OutputRole, PolicyFacts, PolicyInput, PolicyOutput,
    PolicyState, ValueType,
};

/// The inputs and outputs of a policy, states apart.
pub(crate) struct Interface {
    pub(crate) facts: PolicyFacts,
    pub(crate) given: Vec<PolicyInput>,
    pub(crate) wanted: Vec<PolicyOutput>,
}

/// Which inputs the caller gives: all, or all but the mask of available actions.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asked {
    Everything,
    AllButMask,
}

impl Interface {
    /// What stands behind a plan, else what the plan itself says.
    ///
    /// # Errors
    /// What stands there is broken, or about another plan.
    pub(crate) fn of(bytes: &[u8], plan: &Plan<'_>) -> Result<Self, CompileError> {
        match Annex::of_plan(bytes)? {
            None => Ok(Self::new(nameless(plan))),
            Some(Annex { facts, .. }) if fits(&facts, plan) => Ok(Self::new(facts)),
            Some(_) => Err(CompileError::Annex { reason: "they are another plan's".to_owned() }),
        }
    }

    /// What a server says of its policy, with the names that the robot's program has where its plan has none.
    pub(crate) fn of_served(
        inputs: &[(String, usize)],
        outputs: &[(String, usize)],
        schema: &PolicySchema,
    ) -> Self {
        let lengths = |ports: &[Port]| ports.iter().map(|port| port.length).collect::<Vec<_>>();
        let PolicySchema { actions, inputs: given, outputs: wanted, states, .. } = schema;
        let mut facts = plain(*actions, &lengths(given), &lengths(wanted), &lengths(states));
        let places = facts.inputs.iter_mut().map(|input| &mut input.name);
        let places = places.chain(facts.outputs.iter_mut().map(|output| &mut output.name));
        let said = inputs.iter().chain(outputs).map(|(name, _)| name);
        for ((place, port), said) in places.zip(given.iter().chain(wanted)).zip(said) {
            let name = if port.name.is_empty() { said } else { &port.name };
            if !name.is_empty() {
                place.clone_from(name);
            }
        }
        Self::new(facts)
    }

    fn new(facts: PolicyFacts) -> Self {
        let given = facts.given().cloned().collect();
        let wanted = facts.wanted().cloned().collect();
        Self { facts, given, wanted }
    }

    /// The inputs that a caller is asked for.
    pub(crate) fn asked(&self, asked: Asked) -> impl Iterator<Item = &PolicyInput> {
        let everything = asked == Asked::Everything;
        self.given.iter().filter(move |input| everything || input.role != InputRole::Available)
    }

    /// What was given for every input: one after the other, by name, or as one dict; nothing for a mask that is not asked for.
    pub(crate) fn collect<'py>(
        &self,
        inputs: &Bound<'py, PyTuple>,
        named: Option<&Bound<'py, PyDict>>,
        asked: Asked,
    ) -> PyResult<Vec<Option<Bound<'py, PyAny>>>> {
        // What is called with `**{}` gets a dict without entries.
        let named = named.filter(|named| !named.is_empty());
        let dict = match inputs.len() {
            1 if named.is_none() => inputs.get_item(0)?.cast_into::<PyDict>().ok(),
            _ => None,
        };
        let (count, named) = match &dict {
            Some(dict) => (0, Some(dict)),
            None => (inputs.len(), named),
        };
        let mut in_order = inputs.iter().take(count);
        let mut collected = Vec::with_capacity(self.given.len());
        let mut by_name = 0;
        for input in &self.given {
            let is_asked = asked == Asked::Everything || input.role != InputRole::Available;
            let mut found = if is_asked { in_order.next() } else { None };
            if found.is_none()
                && let Some(named) = named
            {
                found = named.get_item(&input.name)?;
                by_name += usize::from(found.is_some());
            }
            if found.is_none() && is_asked {
                return Err(self.misfit(asked));
            }
            collected.push(found);
        }
        let is_rest = in_order.next().is_some() || by_name < named.map_or(0, PyDictMethods::len);
        if is_rest { Err(self.misfit(asked)) } else { Ok(collected) }
    }

    /// The output that is an action, or the first of several.
    pub(crate) fn action(&self) -> PyResult<&PolicyOutput> {
        let first = self.wanted.first();
        first.ok_or_else(|| PyTypeError::new_err("the plan gives no outputs, only decisions"))
    }

    /// What is the matter with so many inputs.
    pub(crate) fn misfit(&self, asked: Asked) -> PyErr {
        let names: Vec<String> =
            self.asked(asked).map(|input| format!("`{}`", input.name)).collect();
        let count = names.len();
        let names = names.join(", ");
        let mask = match asked {
            Asked::AllButMask if self.takes_mask() => ", and the mask of actions as `available`",
            _ => "",
        };
        PyTypeError::new_err(format!(
            "expected {count} {}, {names}, one after the other, by name or as one dict{mask}",
            if count == 1 { "input" } else { "inputs" }
        ))
    }

    fn takes_mask(&self) -> bool {
        self.given.iter().any(|input| input.role == InputRole::Available)
    }

    /// In a few words.
    pub(crate) fn summary(&self) -> String {
        let inputs = self.given.iter().map(|input| format!("{} {:?}", input.name, input.shape));
        let outputs =
            self.wanted.iter().map(|output| format!("{} {:?}", output.name, output.shape));
        let (inputs, outputs): (Vec<String>, Vec<String>) = (inputs.collect(), outputs.collect());
        let states = match self.facts.state_length() {
            0 => String::new(),
            length => format!(", state [{length}]"),
        };
        format!("{}{states} -> {}", inputs.join(", "), outputs.join(", "))
    }
}

/// What a plan says that has no names.
fn nameless(plan: &Plan<'_>) -> PolicyFacts {
    let program = plan.program();
    let actions = program.utilities().map_or(0, |_| plan.actions());
    let inputs: Vec<usize> = program.inputs().map(|input| input.to.len as usize).collect();
    let outputs: Vec<usize> = program.outputs().map(|output| output.width as usize).collect();
    let states: Vec<usize> = program.states().map(|state| state.from.len as usize).collect();
    plain(actions, &inputs, &outputs, &states)
}

/// Inputs, outputs and states of these lengths, named by their places; the first output is the scores of so many actions,
/// where there are any.
fn plain(actions: usize, inputs: &[usize], outputs: &[usize], states: &[usize]) -> PolicyFacts {
    let input = |(index, length): (usize, &usize)| PolicyInput {
        name: format!("input_{index}"),
        kind: ValueType::F32,
        shape: vec![*length],
        role: InputRole::Observation,
        normals: Vec::new(),
    };
    let output = |(index, length): (usize, &usize)| PolicyOutput {
        name: format!("output_{index}"),
        kind: ValueType::F32,
        shape: vec![*length],
        role: match actions {
            1.. if index == 0 => OutputRole::Discrete(actions),
            _ => OutputRole::Continuous(*length),
        },
    };
    let state = |(index, length): (usize, &usize)| PolicyState {
        input: format!("state_{index}"),
        output: format!("state_{index}_next"),
        length: *length,
    };
    PolicyFacts {
        inputs: inputs.iter().enumerate().map(input).collect(),
        outputs: outputs.iter().enumerate().map(output).collect(),
        states: states.iter().enumerate().map(state).collect(),
        operators: Default::default(),
        parameters: 0,
        multiply_adds: None,
    }
}

/// Whether names and sizes are those of a plan: anybody may have written them.
fn fits(facts: &PolicyFacts, plan: &Plan<'_>) -> bool {
    let length =
        |shape: &[usize]| shape.iter().try_fold(1_usize, |length, size| length.checked_mul(*size));
    let width = |output: &PolicyOutput| match output.role {
        // A plan gives the scores of a choice that is made inside.
        OutputRole::Discrete(actions) if output.kind.is_integer() => {
            length(&output.shape)?.checked_mul(actions)
        }
        OutputRole::Discrete(actions) => {
            length(&output.shape).filter(|length| actions > 0 && length.is_multiple_of(actions))
        }
        _ => length(&output.shape),
    };
    let program = plan.program();
    let inputs = program.inputs().map(|input| Some(input.to.len as usize));
    let outputs = program.outputs().map(|output| Some(output.width as usize));
    let states = program.states().map(|state| state.from.len as usize);
    facts.given().map(|input| length(&input.shape)).eq(inputs)
        && facts.wanted().map(width).eq(outputs)
        && facts.states.iter().map(|state| state.length).eq(states)
}

/// How an array stands to the sizes in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fit {
    /// As the file has it.
    Exact,
    /// Without the file's leading 1.
    WithoutBatch,
}

/// Whether an array has the sizes that the file has, or all but a leading 1.
pub(crate) fn fit(name: &str, want: &[usize], got: &[usize]) -> PyResult<Fit> {
    match want {
        _ if got == want => Ok(Fit::Exact),
        [1, rest @ ..] if got == rest => Ok(Fit::WithoutBatch),
        [1, rest @ ..] => Err(PyValueError::new_err(format!(
            "`{name}` has the shape {got:?}, needed is {rest:?} or {want:?}"
        ))),
        _ => Err(PyValueError::new_err(format!(
            "`{name}` has the shape {got:?}, needed is {want:?}"
        ))),
    }
}

/// The sizes of an output where inputs were given so.
pub(crate) fn shape_as(shape: &[usize], fit: Fit) -> &[usize] {
    match (fit, shape) {
        (Fit::WithoutBatch, [1, rest @ ..]) => rest,
        _ => shape,
    }
}

/// The sizes of a mask of one case.
pub(crate) fn mask_shape(output: &PolicyOutput) -> PyResult<Vec<usize>> {
    let OutputRole::Discrete(actions) = output.role else {
        let message =
            format!("`{}` is no choice of actions: `available` is of no use", output.name);
        return Err(PyTypeError::new_err(message));
    };
    let mut shape = choices_shape(output, Fit::WithoutBatch).to_vec();
    shape.push(actions);
    Ok(shape)
}

/// The sizes of the choices that an output is: one for each row of scores.
pub(crate) fn choices_shape(output: &PolicyOutput, fit: Fit) -> &[usize] {
    let shape = match output.shape.split_last() {
        // Scores; of an `ArgMax` inside, the file has one place for each row.
        Some((_, rows)) if !output.kind.is_integer() => rows,
        _ => &output.shape,
    };
    let shape = shape_as(shape, fit);
    // One choice is a number.
    if shape.iter().product::<usize>() == 1 { &[] } else { shape }
}

/// The choice of every row of scores. An empty mask leaves everything available.
pub(crate) fn choices(
    scores: &[f32],
    actions: usize,
    mask: &[u16],
) -> Result<Vec<i64>, DecideError> {
    let everything = vec![1; if mask.is_empty() { actions } else { 0 }];
    let mut masks = mask.chunks(actions.max(1));
    let choice = |scores: &[f32]| {
        let mask = masks.next().unwrap_or(&everything);
        masked_argmax(scores, mask).map(|decision| decision.action.into())
    };
    scores.chunks(actions.max(1)).map(choice).collect()
}
