//! A policy's answers beside the truth.

use sortie_plans::{CompileError, OutputRole, PolicyAnswer, TrueFlatPolicy, TrueNumber};

use super::{DoublePrecision, Opens};
use crate::engine::reference::ReferenceEngine;
use crate::engine::{Engine, Named};
use crate::flat::{FlatGraph, Interface};
use crate::reference::{RUNS, Runs, truth};

/// A policy whose truth is known.
#[derive(Debug)]
pub(crate) struct TruePolicy {
    engine: ReferenceEngine,
    interface: Interface,
    /// What every run remembers.
    states: Vec<Vec<f64>>,
    calls: u64,
}

impl TruePolicy {
    /// Of a file whose sizes are fixed, as it stands otherwise.
    pub(crate) fn open(graph: FlatGraph) -> Result<Self, CompileError> {
        let engine = DoublePrecision.open_policy(&graph)?;
        let interface = graph.interface;
        let states = vec![vec![0.0; interface.facts.state_length()]; RUNS];
        Ok(Self { engine, interface, states, calls: 0 })
    }

    /// All true outputs of the file, scores among them.
    pub(crate) fn outputs(
        &mut self,
        inputs: &[&[f32]],
        states: &[f32],
        seed: u64,
    ) -> Result<Vec<Vec<TrueNumber>>, CompileError> {
        self.remember(states);
        let runs = self.runs(inputs, seed)?;
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

    /// Lets every run remember the same.
    fn remember(&mut self, states: &[f32]) {
        let known: Vec<f64> = states.iter().copied().map(f64::from).collect();
        self.states.iter_mut().for_each(|states| states.clone_from(&known));
    }

    fn runs(&mut self, inputs: &[&[f32]], seed: u64) -> Result<Runs, CompileError> {
        let Self { engine, interface, states, .. } = self;
        let double = |numbers: &&[f32]| numbers.iter().copied().map(f64::from).collect();
        let inputs: Vec<Vec<f64>> = inputs.iter().map(double).collect();
        let inputs: Vec<&[f64]> = inputs.iter().map(Vec::as_slice).collect();
        let mut run = |(run, states): (usize, &Vec<f64>)| {
            engine.begin(run, seed);
            let arranged = interface.arranged(&inputs, states)?;
            let named: Vec<Named<'_, f64>> = arranged.into_iter().map(Named::from).collect();
            engine.run(&named)
        };
        states.iter().enumerate().map(&mut run).collect()
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
            self.remember(known);
        }
        self.calls += 1;
        let runs = self.runs(inputs, self.calls)?;
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
