//! A policy's answers beside the truth.

use sortie_plans::{
    CompileError, InputRole, MOST_DISTANCE, MOST_MEAN_DISTANCE, OutputRole, PolicyAnswer,
    PolicyInput, TrueFlatPolicy, TrueNumber, ValueType,
};
use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::TractError;

use super::truth::{RUNS, Runs, runs, truth};
use super::{Reference, Tensor};
use crate::flat::Interface;
use crate::graph::guarded;

/// A policy whose truth is known.
#[derive(Debug)]
pub(crate) struct TruePolicy {
    reference: Reference,
    interface: Interface,
    /// What every run remembers.
    states: Vec<Vec<f64>>,
    calls: u64,
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
        let states = vec![vec![0.0; interface.facts.state_length()]; RUNS];
        Ok(Self { reference, interface, states, calls: 0 })
    }

    /// All true outputs of the file, scores among them.
    pub(crate) fn outputs(
        &self,
        inputs: &[&[f32]],
        states: &[f32],
        seed: u64,
    ) -> Result<Vec<Vec<TrueNumber>>, CompileError> {
        let states: Vec<f64> = states.iter().copied().map(f64::from).collect();
        let runs = self.runs(inputs, |_| states.as_slice(), seed)?;
        self.truth(&runs)
    }

    /// What the runs tell; what must not be chosen has the score that plans give it.
    fn truth(&self, runs: &Runs) -> Result<Vec<Vec<TrueNumber>>, CompileError> {
        let mut found = truth(runs).map_err(|reason| CompileError::Run { reason })?;
        for (at, output) in self.interface.facts.outputs.iter().enumerate() {
            let scores = found.get_mut(self.interface.scores_of(at));
            let scores = scores.filter(|_| matches!(output.role, OutputRole::Discrete(_)));
            for number in scores.into_iter().flatten() {
                if number.value == f64::NEG_INFINITY {
                    number.value = f32::MIN.into();
                }
            }
        }
        Ok(found)
    }

    fn runs<'s>(
        &self,
        inputs: &[&[f32]],
        states: impl Fn(usize) -> &'s [f64],
        seed: u64,
    ) -> Result<Runs, CompileError> {
        let none = vec![0.0; self.interface.facts.state_length()];
        self.interface.facts.check(inputs, &none)?;
        let given = |run: usize| {
            let (mut given, mut remembered) = (inputs.iter(), states(run));
            let facts = self.interface.facts.inputs.iter();
            let tensors = facts.map(|input| {
                let numbers: Vec<f64> = if input.role == InputRole::State {
                    let (own, rest) = remembered.split_at(input.length().min(remembered.len()));
                    remembered = rest;
                    own.to_vec()
                } else {
                    given
                        .next()
                        .into_iter()
                        .flat_map(|numbers| numbers.iter())
                        .map(|x| f64::from(*x))
                        .collect()
                };
                (input.name.clone(), tensor(input, numbers))
            });
            tensors.collect()
        };
        let find = || {
            let found = runs(&self.reference, given, &self.interface.outputs, seed);
            found.map_err(TractError::msg)
        };
        guarded(find).map_err(|reason| CompileError::Run { reason })
    }

    /// The answers, rounded to 32 bits; the next states are written.
    pub(crate) fn answers(
        &self,
        outputs: &[Vec<TrueNumber>],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        let rounded =
            |output: &Vec<TrueNumber>| output.iter().map(|number| number.value as f32).collect();
        let rounded: Vec<Vec<f32>> = outputs.iter().map(rounded).collect();
        self.interface.answers(&rounded, states)
    }

    /// The true numbers that a policy's answers, and behind them its next states, are compared with: scores where an
    /// output chooses among them.
    pub(crate) fn compared(&self, outputs: &[Vec<TrueNumber>]) -> Vec<TrueNumber> {
        self.places().filter_map(|at| outputs.get(at)).flatten().copied().collect()
    }

    /// The places of the facts' outputs, in their order, which has states last; of choices those of their scores.
    fn places(&self) -> impl Iterator<Item = usize> {
        // Wanted outputs stand before all others, so that their places are those of their scores.
        (0..self.interface.facts.outputs.len()).map(|at| self.interface.scores_of(at))
    }
}

impl TrueFlatPolicy for TruePolicy {
    fn begin(&mut self) {
        self.states.iter_mut().for_each(|states| states.fill(0.0));
    }

    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: Option<&[f32]>,
    ) -> Result<Vec<Vec<TrueNumber>>, CompileError> {
        if let Some(known) = states {
            let known: Vec<f64> = known.iter().copied().map(f64::from).collect();
            self.states.iter_mut().for_each(|states| states.clone_from(&known));
        }
        self.calls += 1;
        let runs = self.runs(inputs, |run| self.states[run].as_slice(), self.calls)?;
        let facts = &self.interface.facts.outputs;
        let is_state = |at: &usize| facts[*at].role == OutputRole::State;
        for (states, run) in self.states.iter_mut().zip(&runs) {
            let next = (0..facts.len()).filter(is_state).filter_map(|at| run.get(at));
            *states = next.flatten().copied().collect();
        }
        let found = self.truth(&runs)?;
        Ok(self.places().filter_map(|at| found.get(at).cloned()).collect())
    }
}

impl Distances {
    /// Adds a plan's numbers for an input.
    pub(crate) fn add(&mut self, input: usize, numbers: &[f32], truths: &[TrueNumber]) {
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
fn tensor(input: &PolicyInput, numbers: Vec<f64>) -> Tensor {
    let shape = input.shape.clone();
    match input.kind {
        ValueType::F32 | ValueType::F64 => Tensor::real(shape, numbers),
        ValueType::I64 | ValueType::I32 | ValueType::U8 => {
            Tensor::whole(shape, numbers.iter().map(|x| *x as i64).collect())
        }
        ValueType::Bool => Tensor::truth(shape, numbers.iter().map(|x| *x != 0.0).collect()),
    }
}
