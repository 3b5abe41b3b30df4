//! A policy's answers beside the truth.

use sortie_plans::{CompileError, OutputRole, PolicyAnswer, PolicyInput, ValueType};
use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::TractError;

use super::{Reference, Tensor, True, truth};
use crate::flat::Interface;
use crate::graph::guarded;

/// So many times its scatter a right engine's number may be from the truth: the worst of the right ones measured was
/// six, a weight matrix in 16 bits moves some number by twenty and more.
pub(crate) const MOST_DISTANCE: f64 = 16.0;

/// So large the root mean square of an output number's distances may be; right engines stay below one.
pub(crate) const MOST_MEAN_DISTANCE: f64 = 3.0;

/// A policy whose truth is known.
#[derive(Debug)]
pub(crate) struct TruePolicy {
    reference: Reference,
    interface: Interface,
}

/// How far a plan's numbers are from the truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Distances {
    /// The largest of all, with the input of it and both numbers.
    pub(crate) worst: Option<Worst>,
    /// Sums of squares of every output number, over how many inputs.
    squares: Vec<(f64, usize)>,
}

/// The number that is furthest from the truth.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Worst {
    pub(crate) distance: f64,
    pub(crate) input: usize,
    pub(crate) number: f32,
    pub(crate) value: f64,
}

impl TruePolicy {
    /// Of a file whose sizes are fixed, as it stands otherwise.
    pub(crate) fn new(file: &ModelProto, interface: Interface) -> Result<Self, CompileError> {
        let read = || Reference::new(file).map_err(TractError::msg);
        let reference = guarded(read).map_err(|reason| CompileError::Run { reason })?;
        Ok(Self { reference, interface })
    }

    /// All true outputs of the file, scores among them.
    pub(crate) fn outputs(
        &self,
        inputs: &[&[f32]],
        states: &[f32],
        seed: u64,
    ) -> Result<Vec<Vec<True>>, CompileError> {
        let given = self.interface.arranged(inputs, states)?.into_iter();
        let given: Vec<_> =
            given.map(|(input, numbers)| (input.name.clone(), tensor(input, numbers))).collect();
        let find = || {
            let found = truth(&self.reference, &given, &self.interface.outputs, seed);
            found.map_err(TractError::msg)
        };
        guarded(find).map_err(|reason| CompileError::Run { reason })
    }

    /// The answers, rounded to 32 bits; the next states are written.
    pub(crate) fn answers(
        &self,
        outputs: &[Vec<True>],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        let rounded =
            |output: &Vec<True>| output.iter().map(|number| number.value as f32).collect();
        let rounded: Vec<Vec<f32>> = outputs.iter().map(rounded).collect();
        self.interface.answers(&rounded, states)
    }

    /// The true numbers that a policy's answers, and behind them its next states, are compared with: scores where an
    /// output chooses among them.
    pub(crate) fn compared(&self, outputs: &[Vec<True>]) -> Vec<True> {
        let facts = &self.interface.facts.outputs;
        let wanted = (0..facts.len()).filter(|at| facts[*at].role != OutputRole::State);
        let states = (0..facts.len()).filter(|at| facts[*at].role == OutputRole::State);
        // Wanted outputs stand before all others, so that their places are those of their scores.
        let places = wanted.map(|at| self.interface.scores_of(at));
        places.chain(states).filter_map(|at| outputs.get(at)).flatten().copied().collect()
    }
}

impl Distances {
    /// Adds a plan's numbers for an input.
    pub(crate) fn add(&mut self, input: usize, numbers: &[f32], truths: &[True]) {
        self.squares.resize(truths.len().max(self.squares.len()), (0.0, 0));
        for ((number, truth), (square, count)) in numbers.iter().zip(truths).zip(&mut self.squares)
        {
            if !truth.is_finite() {
                continue;
            }
            let distance = truth.distance(*number);
            *square += distance * distance;
            *count += 1;
            if self
                .worst
                .as_ref()
                .is_none_or(|worst| distance.is_nan() || distance > worst.distance)
            {
                self.worst = Some(Worst { distance, input, number: *number, value: truth.value });
            }
        }
    }

    /// The largest root mean square of any output number's distances.
    pub(crate) fn mean(&self) -> f64 {
        let mean = |(square, count): &(f64, usize)| (square / (*count).max(1) as f64).sqrt();
        self.squares.iter().map(mean).fold(0.0, f64::max)
    }

    /// What is wrong with a plan that is too far.
    pub(crate) fn error(&self, seed: u64) -> CompileError {
        let none = Worst { distance: 0.0, input: 0, number: 0.0, value: 0.0 };
        let Worst { distance, input, number, value } = self.worst.clone().unwrap_or(none);
        CompileError::Wrong {
            number,
            truth: value,
            distance,
            limit: MOST_DISTANCE,
            mean: self.mean(),
            mean_limit: MOST_MEAN_DISTANCE,
            input,
            seed,
        }
    }

    /// Whether a right engine may be so far.
    pub(crate) fn is_right(&self) -> bool {
        let worst = self.worst.as_ref().map_or(0.0, |worst| worst.distance);
        worst <= MOST_DISTANCE && self.mean() <= MOST_MEAN_DISTANCE
    }
}

/// What the policy sees of an input, in the type that the file gives it.
fn tensor(input: &PolicyInput, numbers: &[f32]) -> Tensor {
    let shape = input.shape.clone();
    match input.kind {
        ValueType::F32 | ValueType::F64 => {
            Tensor::real(shape, numbers.iter().map(|x| f64::from(*x)).collect())
        }
        ValueType::I64 | ValueType::I32 | ValueType::U8 => {
            Tensor::whole(shape, numbers.iter().map(|x| *x as i64).collect())
        }
        ValueType::Bool => Tensor::truth(shape, numbers.iter().map(|x| *x != 0.0).collect()),
    }
}
