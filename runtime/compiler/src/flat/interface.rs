//! What engines are given for a policy, and what its caller gets of what they give.

use sortie_plans::{CompileError, InputRole, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput};

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
    pub(crate) fn arranged<'a>(
        &'a self,
        inputs: &[&'a [f32]],
        mut states: &'a [f32],
    ) -> Result<Vec<(&'a PolicyInput, &'a [f32])>, CompileError> {
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
        let answer = |((numbers, _), scores): ((&Vec<f32>, _), Option<&Vec<f32>>)| PolicyAnswer {
            numbers: numbers.clone(),
            scores: scores.map_or_else(Vec::new, |scores| scores.iter().map(finite).collect()),
        };
        Ok(wanted.zip(scores).map(answer).collect())
    }
}

/// A score; what must not be chosen often has the score minus infinity.
fn finite(score: &f32) -> f32 {
    if *score == f32::NEG_INFINITY { f32::MIN } else { *score }
}

/// An engine or the reader gave other inputs or outputs than were asked for.
pub(crate) fn other_values() -> CompileError {
    CompileError::Run { reason: "its inputs or outputs are not those of the file".to_owned() }
}
