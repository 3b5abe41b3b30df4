//! What the inputs and outputs of a simplified graph are for.

use std::collections::BTreeMap;

use sortie_plans::{
    CompileError, InputRole, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput, PolicyOptions,
    PolicyOutput, PolicyState, ValueType, finite_score,
};
use tract_onnx::pb;
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::Cost;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::cnn::Conv;
use tract_onnx::tract_core::ops::einsum::EinSum;
use tract_onnx::tract_core::ops::scan::Scan;
use tract_onnx::tract_hir::internal::DimLike;

use super::nodes::ArgMax;
use super::selection::{NONE, Selection, role, words};
use super::values::{EntityRoles, Value, listed, value_type};
use crate::graph::guarded;

/// The most numbers of one input or output.
const MOST_NUMBERS: usize = 1 << 24;

impl Selection {
    pub(super) fn facts(
        &self,
        file: &pb::ModelProto,
        model: &TypedModel,
        options: &PolicyOptions,
    ) -> Result<PolicyFacts, CompileError> {
        let graph = file.graph.clone().unwrap_or_default();
        let inputs = graph.input.iter().map(|input| &input.name).zip(&model.inputs);
        let inputs = inputs.map(|(name, outlet)| typed(model, name, *outlet));
        let inputs: Vec<Value> = inputs.collect::<Result<_, _>>()?;
        let outputs = graph.output.iter().map(|output| &output.name).zip(&model.outputs);
        let outputs = outputs.map(|(name, outlet)| typed(model, name, *outlet));
        let outputs: Vec<Value> = outputs.collect::<Result<_, _>>()?;
        let outputs = self.output_facts(&inputs, &outputs)?;
        let states = self.state_facts(&inputs, &outputs)?;
        let inputs = self.input_facts(inputs, &outputs, options)?;
        let stored = graph.initializer.iter().map(|tensor| {
            let sizes = tensor.dims.iter().map(|size| u64::try_from(*size).unwrap_or(0));
            sizes.fold(1, u64::saturating_mul)
        });
        Ok(PolicyFacts {
            inputs,
            outputs,
            states,
            operators: operators(model),
            parameters: stored.fold(0, u64::saturating_add),
            multiply_adds: guarded(|| Ok(multiply_adds(model))).unwrap_or_default(),
        })
    }

    fn output_facts(
        &self,
        inputs: &[Value],
        outputs: &[Value],
    ) -> Result<Vec<PolicyOutput>, CompileError> {
        let masks: Vec<&Value> = inputs.iter().filter(|input| is_mask(input)).collect();
        let mut facts = Vec::new();
        for ((place, wanted), choice) in self.wanted.iter().enumerate().zip(&self.choices) {
            let output = outputs.get(place).ok_or_else(other_values)?;
            let choice_of = choice.as_ref().and_then(|choice| {
                let scores = outputs.iter().find(|output| output.name == choice.scores)?;
                let shape = scores.shape.as_ref()?;
                shape.get(axis_of(choice.axis, shape.len())?).copied()
            });
            facts.push(output_fact(output, role(output, wanted.said, choice_of, &masks))?);
        }
        let states = outputs.iter().skip(self.wanted.len()).take(self.states.len());
        for output in states {
            facts.push(output_fact(output, OutputRole::State)?);
        }
        Ok(facts)
    }

    fn state_facts(
        &self,
        inputs: &[Value],
        outputs: &[PolicyOutput],
    ) -> Result<Vec<PolicyState>, CompileError> {
        let mut states = Vec::new();
        for pair in &self.states {
            let input =
                inputs.iter().find(|input| input.name == pair.input).ok_or_else(other_values)?;
            let output = outputs.iter().find(|output| output.name == pair.output);
            let output = output.ok_or_else(other_values)?;
            let length = input.shape.iter().flatten().product();
            if length != output.length() {
                return Err(CompileError::NoPolicy {
                    reason: format!(
                        "{input} cannot be the state that comes back as `{}` {:?}",
                        output.name, output.shape
                    ),
                });
            }
            let (input, output) = (pair.input.clone(), pair.output.clone());
            states.push(PolicyState { input, output, length });
        }
        Ok(states)
    }

    fn input_facts(
        &self,
        inputs: Vec<Value>,
        outputs: &[PolicyOutput],
        options: &PolicyOptions,
    ) -> Result<Vec<PolicyInput>, CompileError> {
        let entities = EntityRoles::of(&inputs, options)?;
        let is_of_entities = |name: &str| entities.as_ref().and_then(|roles| roles.role(name));
        let others: Vec<&Value> =
            inputs.iter().filter(|input| is_of_entities(&input.name).is_none()).collect();
        let available = available(&others, outputs, options.available.as_deref())?;
        let has_floats = inputs.iter().any(|input| {
            input.is_float() && !self.states.iter().any(|pair| pair.input == input.name)
        });
        let sees_others = inputs.iter().any(|input| {
            let is_state = self.states.iter().any(|pair| pair.input == input.name);
            input.is_float() && !is_state && !is_mask(input)
        });
        let mut facts = Vec::new();
        for input in inputs {
            let found = || match &input {
                _ if self.states.iter().any(|pair| pair.input == input.name) => InputRole::State,
                _ if available.as_ref() == Some(&input.name) => InputRole::Available,
                _ if is_mask(&input) && input.is_float() && sees_others => InputRole::Extra,
                _ if input.is_float() => InputRole::Observation,
                // Pictures and discrete observations, unless they stand beside an observation of floats.
                _ if !has_floats && input.is_whole() => InputRole::Observation,
                _ => InputRole::Extra,
            };
            let role = is_of_entities(&input.name).unwrap_or_else(found);
            let (kind, shape) = known(&input)?;
            facts.push(PolicyInput { name: input.name, kind, shape, role, normals: Vec::new() });
        }
        let observes = |input: &PolicyInput| {
            matches!(input.role, InputRole::Observation | InputRole::Entities { .. })
        };
        if !facts.iter().any(observes) {
            let found = listed(facts.iter().map(|input| {
                format!("`{}` {} ({})", input.name, input.kind.name(), input.role.name())
            }));
            let reason = format!("it needs an observation, an input of numbers, and has {found}");
            return Err(CompileError::NoPolicy { reason });
        }
        Ok(facts)
    }

    /// The places of scores among the cut file's outputs, where the choice is along their last axis.
    pub(super) fn scores(&self, outputs: &[String], model: &TypedModel) -> Vec<Option<usize>> {
        let place = |choice: &Option<ArgMax>| {
            let choice = choice.as_ref()?;
            let place = outputs.iter().position(|name| *name == choice.scores)?;
            let rank = model.outlet_fact(*model.outputs.get(place)?).ok()?.rank();
            (axis_of(choice.axis, rank)? + 1 == rank).then_some(place)
        };
        self.choices.iter().map(place).collect()
    }
}

/// The mask of available actions: as long as there are actions.
fn available(
    inputs: &[&Value],
    outputs: &[PolicyOutput],
    asked: Option<&str>,
) -> Result<Option<String>, CompileError> {
    let actions: Vec<usize> = outputs
        .iter()
        .filter_map(|output| match output.role {
            OutputRole::Discrete(actions) => Some(actions),
            _ => None,
        })
        .collect();
    // What is asked for by its name may be any that fits.
    let may_be = |input: &Value| is_mask(input) || asked.is_some() && input.is_float();
    let fits =
        |input: &&&Value| may_be(input) && input.last_size().is_some_and(|n| actions.contains(&n));
    let masks: Vec<&Value> = inputs.iter().filter(fits).copied().collect();
    match (asked, masks.as_slice()) {
        (Some(NONE), _) | (None, []) => Ok(None),
        (None, [one]) => Ok(Some(one.name.clone())),
        (Some(name), masks) if masks.iter().any(|mask| mask.name == name) => {
            Ok(Some(name.to_owned()))
        }
        (Some(name), masks) => Err(CompileError::NotInFile {
            what: "mask of available actions".into(),
            name: name.to_owned(),
            found: listed(masks.iter().map(ToString::to_string)),
        }),
        (None, several) => Err(CompileError::Unclear {
            what: "which input says what actions are available".into(),
            candidates: listed(several.iter().map(ToString::to_string)),
            flag: "`--available NAME` or `--available none`".into(),
        }),
    }
}

/// Whether its type or, of floats, its name or its use says that it is a mask.
fn is_mask(value: &Value) -> bool {
    let is_word = |word: &String| word == "mask" || word == "masks" || word.starts_with("avail");
    let is_named = || words(&value.name).iter().any(is_word);
    value.kind.is_some_and(ValueType::is_mask) || value.is_float() && (value.is_flag || is_named())
}

/// An axis that may count from the end.
fn axis_of(axis: i64, rank: usize) -> Option<usize> {
    let axis = if axis < 0 { axis.checked_add(i64::try_from(rank).ok()?)? } else { axis };
    usize::try_from(axis).ok().filter(|axis| *axis < rank)
}

/// An input or output of the simplified graph.
fn typed(model: &TypedModel, name: &str, outlet: OutletId) -> Result<Value, CompileError> {
    let fact = model
        .outlet_fact(outlet)
        .map_err(|error| CompileError::Unreadable { reason: error.to_string() })?;
    let shape = fact.shape.as_concrete().map(<[usize]>::to_vec);
    let kind = value_type(fact.datum_type);
    let value = Value { name: name.to_owned(), kind, shape, is_flag: is_flag(model, outlet) };
    let all = value.shape.iter().flatten();
    match all.copied().try_fold(1, usize::checked_mul).is_some_and(|all| all <= MOST_NUMBERS) {
        true => Ok(value),
        false => {
            let reason = format!("{value} has more than {MOST_NUMBERS} numbers");
            Err(CompileError::NoPolicy { reason })
        }
    }
}

fn is_flag(model: &TypedModel, outlet: OutletId) -> bool {
    let output = model.node(outlet.node).outputs.get(outlet.slot);
    let readers = output.map_or(&[][..], |output| output.successors.as_slice());
    let asks = |reader: &InletId| {
        let cast = model.node(reader.node).op_as::<Cast>();
        cast.is_some_and(|cast| cast.to == bool::datum_type())
    };
    !readers.is_empty() && readers.iter().all(asks)
}

fn output_fact(output: &Value, role: OutputRole) -> Result<PolicyOutput, CompileError> {
    let (kind, shape) = known(output)?;
    Ok(PolicyOutput { name: output.name.clone(), kind, shape, role })
}

/// The type and the sizes of what an engine is given or gives.
fn known(value: &Value) -> Result<(ValueType, Vec<usize>), CompileError> {
    match (value.kind, &value.shape) {
        (Some(kind), Some(shape)) => Ok((kind, shape.clone())),
        _ => {
            let reason = format!(
                "{value} must have fixed sizes and be one of f32, f64, i64, i32, u8 and bool"
            );
            Err(CompileError::NoPolicy { reason })
        }
    }
}

/// Nodes per operator, but for inputs and constants.
pub(super) fn operators(model: &TypedModel) -> BTreeMap<String, usize> {
    let mut operators = BTreeMap::new();
    let computing = model.nodes.iter().filter(|node| !node.inputs.is_empty());
    for node in computing {
        *operators.entry(node.op.name().into_owned()).or_insert(0) += 1;
    }
    operators
}

/// Multiply-adds of products and convolutions in one run; none where it is not known how often a loop turns.
pub(super) fn multiply_adds(model: &TypedModel) -> Option<u64> {
    let mut sum = 0_u64;
    for node in &model.nodes {
        let inputs = model.node_input_facts(node.id).ok()?;
        if let Some(turns) = node.op_as::<Scan>() {
            let count = turns.iteration_count(&inputs)?.to_usize().ok()? as u64;
            sum = sum.saturating_add(count.saturating_mul(multiply_adds(&turns.body)?));
        } else if node.op_is::<EinSum>() || node.op_is::<Conv>() {
            for (cost, count) in node.op.cost(&inputs).ok()? {
                if matches!(cost, Cost::FMA(_)) {
                    sum = sum.saturating_add(count.to_usize().ok()? as u64);
                }
            }
        }
    }
    Some(sum)
}

/// What goes into the cut file and comes out of it.
#[derive(Clone, Debug)]
pub(crate) struct Interface {
    pub(crate) facts: PolicyFacts,
    /// The cut file's outputs: those of the facts, then scores.
    pub(crate) outputs: Vec<String>,
    /// The place among them of the scores that each wanted output chooses from.
    pub(super) scores: Vec<Option<usize>>,
}

impl Interface {
    /// The output of the cut file that an output's numbers are to be taken from: the scores that a choice is made of.
    pub(crate) fn scores_of(&self, output: usize) -> usize {
        self.scores.get(output).copied().flatten().unwrap_or(output)
    }

    /// The numbers of every input of the cut file, in its order.
    pub(crate) fn arranged<'a, N>(
        &'a self,
        inputs: &[&'a [N]],
        mut states: &'a [N],
    ) -> Result<Vec<(&'a PolicyInput, &'a [N])>, CompileError> {
        self.facts.check(inputs, states)?;
        let mut given = inputs.iter().copied();
        let mut numbers = |input: &PolicyInput| {
            if input.role != InputRole::State {
                return given.next();
            }
            let (state, rest) = states.split_at_checked(input.length())?;
            states = rest;
            Some(state)
        };
        let arranged = self.facts.inputs.iter().map(|input| Some((input, numbers(input)?)));
        arranged.collect::<Option<_>>().ok_or_else(other_values)
    }

    /// The answers among what the cut file gave, and the next states.
    pub(crate) fn answers(
        &self,
        given: &[Vec<f32>],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        let outputs = || given.iter().zip(&self.facts.outputs);
        if given.len() != self.outputs.len()
            || outputs().any(|(n, output)| n.len() != output.length())
        {
            return Err(other_values());
        }
        let wanted = outputs().filter(|(_, output)| output.role != OutputRole::State);
        let next = outputs().filter(|(_, output)| output.role == OutputRole::State);
        let next: Vec<f32> = next.flat_map(|(numbers, _)| numbers).copied().collect();
        for (state, next) in states.iter_mut().zip(next) {
            *state = next;
        }
        let scores = self.scores.iter().map(|place| place.and_then(|place| given.get(place)));
        let finite = |numbers: &[f32]| numbers.iter().copied().map(finite_score).collect();
        let answers = wanted.zip(scores).map(|((numbers, output), scores)| PolicyAnswer {
            numbers: match output.role {
                OutputRole::Discrete(_) => finite(numbers),
                _ => numbers.clone(),
            },
            scores: scores.map_or_else(Vec::new, |scores| finite(scores)),
        });
        Ok(answers.collect())
    }
}

/// An engine or the reader gave other inputs or outputs than were asked for.
pub(crate) fn other_values() -> CompileError {
    CompileError::Run { reason: "its inputs or outputs are not those of the file".to_owned() }
}
