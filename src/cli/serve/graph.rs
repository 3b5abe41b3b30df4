//! A policy's graph, run by tract: for files of which no plan can be made.

use sortie_core::wire::Reason;
use sortie_ipc::{Engine, PolicySchema, Port};
use sortie_plans::{CompileError, FlatPolicy, OutputRole, PolicyAnswer};

/// A graph that decides as a plan does: what is not finite is refused, and then no state has changed.
pub(super) struct Graph {
    policy: Box<dyn FlatPolicy>,
    /// First 16 bytes of the file's SHA-256.
    model: [u8; 16],
    /// Numbers of every output.
    widths: Vec<usize>,
    /// The states that an answer would leave.
    next: Vec<f32>,
}

impl Graph {
    /// A policy that has run on zeros in another process, and does so here.
    ///
    /// # Errors
    /// It does not.
    pub(super) fn new(
        mut policy: Box<dyn FlatPolicy>,
        model: [u8; 16],
    ) -> Result<Self, CompileError> {
        let mut next = vec![0.0; policy.facts().state_length()];
        let zeros: Vec<Vec<f32>> =
            policy.facts().given().map(|input| vec![0.0; input.length()]).collect();
        let zeros: Vec<&[f32]> = zeros.iter().map(Vec::as_slice).collect();
        let answers = policy.run(&zeros, &mut next)?;
        let widths = answers.iter().map(|answer| numbers(answer).len()).collect();
        Ok(Self { policy, model, widths, next })
    }

    /// What it takes and gives: the same as the file's plan, if there were one.
    pub(super) fn schema(&self) -> PolicySchema {
        let facts = self.policy.facts();
        let port = |name: &str, length: usize| Port { name: name.to_owned(), length };
        let states = facts.states.iter().map(|state| port(&state.input, state.length));
        let outputs: Vec<_> = facts.wanted().zip(&self.widths).collect();
        // Several choices side by side are left to the caller.
        let actions = match outputs.first() {
            Some((output, width)) if output.role == OutputRole::Discrete(**width) => **width,
            _ => 0,
        };
        PolicySchema {
            actions,
            inputs: facts.given().map(|input| port(&input.name, input.length())).collect(),
            outputs: outputs.iter().map(|(output, width)| port(&output.name, **width)).collect(),
            states: states.collect(),
        }
    }
}

impl Engine for Graph {
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason> {
        check(inputs.iter().copied().flatten())?;
        check(states.iter())?;
        self.next.copy_from_slice(states);
        // What the engine says of it would be said at every step.
        let answers = self.policy.run(inputs, &mut self.next);
        let answers = answers.map_err(|_| Reason::Policy)?;
        let answers = answers.iter().map(numbers);
        check(self.next.iter().chain(answers.clone().flatten()))?;
        for (to, from) in outputs.iter_mut().zip(answers) {
            let fits = to.len() == from.len();
            fits.then(|| to.copy_from_slice(from)).ok_or(Reason::Length)?;
        }
        states.copy_from_slice(&self.next);
        Ok(())
    }

    fn model(&self) -> [u8; 16] {
        self.model
    }

    fn is_graph(&self) -> bool {
        true
    }
}

fn check<'a>(mut numbers: impl Iterator<Item = &'a f32>) -> Result<(), Reason> {
    match numbers.all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err(Reason::NonFinite),
    }
}

/// An output's numbers: of a choice that is made inside, its scores, which the caller chooses from.
fn numbers(answer: &PolicyAnswer) -> &[f32] {
    if answer.scores.is_empty() { &answer.numbers } else { &answer.scores }
}
