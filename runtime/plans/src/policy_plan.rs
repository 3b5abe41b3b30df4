//! The plan of a policy, behind the same trait as the engines that run its file, and whether one of few bits acts as the
//! exact one: on recorded observations.

use serde::{Deserialize, Serialize};
use sortie_core::plan::{AlignedBytes, Network, Plan};

use crate::agreement::LEAST_AGREEMENT;
use crate::comparison::cannot_run;
use crate::error::CompileError;
use crate::policy::{FlatPolicy, OutputRole, PolicyAnswer, PolicyFacts, PolicyOutput};
use crate::report::Compiled;

/// Most outputs of a policy that is timed.
const MOST_TIMED: usize = 16;

/// A policy's plan, and what it takes and gives.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CompiledPolicy {
    /// The plan.
    pub compiled: Compiled,
    /// Inputs, outputs and states, in the plan's order.
    pub facts: PolicyFacts,
    /// What nobody refuses and somebody should know, in sentences.
    pub remarks: Vec<String>,
}

/// A policy that runs its plan.
#[derive(Debug)]
pub struct PlanFlatPolicy<'p> {
    plan: Plan<'p>,
    arena: AlignedBytes,
    facts: PolicyFacts,
    /// The states and outputs of [`FlatPolicy::step`].
    states: Vec<f32>,
    outputs: Vec<Vec<f32>>,
}

impl<'p> PlanFlatPolicy<'p> {
    /// Loads a plan, which has to be aligned.
    ///
    /// # Errors
    /// The plan cannot be loaded, or is no policy's.
    pub fn load(plan: &'p [u8], facts: PolicyFacts) -> Result<Self, CompileError> {
        let plan = Plan::load(plan)?;
        plan.check_network(Network::Policy)?;
        let arena = AlignedBytes::zeroed(plan.arena_bytes());
        let states = vec![0.0; plan.hidden()];
        let widths = plan.outputs();
        let outputs = widths.map(|width| vec![0.0; width]).collect();
        Ok(Self { plan, arena, facts, states, outputs })
    }
}

impl FlatPolicy for PlanFlatPolicy<'_> {
    fn facts(&self) -> &PolicyFacts {
        &self.facts
    }

    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        self.facts.check(inputs, states)?;
        let mut numbers = self.outputs.clone();
        let mut places: Vec<&mut [f32]> = numbers.iter_mut().map(Vec::as_mut_slice).collect();
        let arena = self.arena.as_mut_slice();
        self.plan.respond(arena, inputs, states, &mut places).map_err(cannot_run)?;
        Ok(self.facts.wanted().zip(numbers).map(answer).collect())
    }

    fn step(&mut self, inputs: &[&[f32]]) -> Result<(), CompileError> {
        let Self { plan, arena, facts, states, outputs } = self;
        let count = outputs.len();
        let (what, got, max) = ("the number of outputs".into(), count, MOST_TIMED);
        let too_many = CompileError::TooLarge { what, got, max };
        let mut places: [&mut [f32]; MOST_TIMED] = Default::default();
        for (place, output) in places.iter_mut().zip(outputs.iter_mut()) {
            *place = output;
        }
        let places = places.get_mut(..count).ok_or(too_many)?;
        plan.respond(arena.as_mut_slice(), inputs, states, places).map_err(cannot_run)?;
        for (output, numbers) in facts.wanted().zip(&*outputs) {
            if let (OutputRole::Discrete(_), true) = (output.role, output.kind.is_integer()) {
                std::hint::black_box(first_largest(numbers));
            }
        }
        Ok(())
    }
}

/// What a plan's output says of a policy's: a plan gives the scores that a choice is made of.
fn answer((output, numbers): (&PolicyOutput, Vec<f32>)) -> PolicyAnswer {
    match output.role {
        OutputRole::Discrete(actions) if output.kind.is_integer() => {
            let places = choices(&numbers, actions).map(|place| place as f32).collect();
            PolicyAnswer { numbers: places, scores: numbers }
        }
        _ => PolicyAnswer { numbers, scores: Vec::new() },
    }
}

/// The choice that each row of scores makes: the place of the largest, the first of several.
pub fn choices(scores: &[f32], actions: usize) -> impl Iterator<Item = usize> {
    scores.chunks(actions.max(1)).map(first_largest)
}

fn first_largest(scores: &[f32]) -> usize {
    let largest = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    scores.iter().position(|score| *score == largest).unwrap_or(0)
}

/// Largest error of a continuous action, in units of what the action varies by.
pub const LARGEST_DEVIATION: f64 = 0.1;

/// What was recorded of one decision.
#[derive(Clone, Debug)]
pub struct RecordedCase<'a> {
    /// The inputs that are no states, in the policy's order.
    pub inputs: Vec<&'a [f32]>,
    /// All recurrent states; none: those that the case before left behind, zeros in the first.
    pub states: Option<Vec<f32>>,
}

/// How a policy of few bits acts beside the exact one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicyAgreement {
    /// Observations that both decided on.
    pub observations: usize,
    /// Each wanted output.
    pub outputs: Vec<OutputAgreement>,
}

/// The same of one output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutputAgreement {
    /// Its name.
    pub name: String,
    /// Observations with the same action, where it is discrete.
    pub equal_actions: Option<usize>,
    /// Largest error of any of its numbers, in standard deviations of that number over all observations.
    pub largest_deviation: f64,
}

/// The same, kept by itself: what a proof goes through beside random inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProofCase {
    /// As [`RecordedCase::inputs`].
    pub inputs: Vec<Vec<f32>>,
    /// As [`RecordedCase::states`].
    pub states: Option<Vec<f32>>,
}

impl From<RecordedCase<'_>> for ProofCase {
    fn from(case: RecordedCase<'_>) -> Self {
        let inputs = case.inputs.into_iter().map(<[f32]>::to_vec).collect();
        Self { inputs, states: case.states }
    }
}

impl PolicyAgreement {
    /// Share of observations with the same actions, of the output where it is least; 1 where nothing is chosen.
    pub fn share(&self) -> f64 {
        let of = |equal: usize| equal as f64 / self.observations.max(1) as f64;
        let shares = self.outputs.iter().filter_map(|output| output.equal_actions).map(of);
        shares.fold(1.0, f64::min)
    }

    /// Largest error of any continuous action; 0 where there is none.
    pub fn largest_deviation(&self) -> f64 {
        let continuous = self.outputs.iter().filter(|output| output.equal_actions.is_none());
        continuous.map(|output| output.largest_deviation).fold(0.0, f64::max)
    }

    /// Whether it acts as the exact one.
    pub fn is_enough(&self) -> bool {
        self.share() >= LEAST_AGREEMENT && self.largest_deviation() <= LARGEST_DEVIATION
    }
}

/// Asks two plans of a policy about the same cases.
///
/// # Errors
/// A plan cannot be loaded, or what was recorded not be decided on.
pub fn policy_agreement(
    few: &CompiledPolicy,
    exact: &CompiledPolicy,
    cases: &[RecordedCase<'_>],
) -> Result<PolicyAgreement, CompileError> {
    let facts = &exact.facts;
    let answers = |policy: &CompiledPolicy| {
        let plan = AlignedBytes::copy_of(&policy.compiled.bytes);
        answers(&mut PlanFlatPolicy::load(plan.as_slice(), facts.clone())?, cases)
    };
    let (got, want) = (answers(few)?, answers(exact)?);
    let outputs = facts.wanted().enumerate().map(|(index, output)| {
        let of = |all: &[Vec<PolicyAnswer>]| -> Vec<PolicyAnswer> {
            all.iter().filter_map(|answers| answers.get(index).cloned()).collect()
        };
        let (got, want) = (of(&got), of(&want));
        let equal_actions = match output.role {
            OutputRole::Discrete(actions) => Some(equal_actions(&got, &want, actions)),
            _ => None,
        };
        let largest_deviation = largest_deviation(&got, &want);
        OutputAgreement { name: output.name.clone(), equal_actions, largest_deviation }
    });
    Ok(PolicyAgreement { observations: cases.len(), outputs: outputs.collect() })
}

/// What a policy answers to all cases. Both policies see the states that the recording holds, else each its own.
fn answers(
    policy: &mut dyn FlatPolicy,
    cases: &[RecordedCase<'_>],
) -> Result<Vec<Vec<PolicyAnswer>>, CompileError> {
    let mut states = vec![0.0; policy.facts().state_length()];
    let answer = |case: &RecordedCase<'_>| {
        if let Some(recorded) = &case.states {
            states.clone_from(recorded);
        }
        policy.run(&case.inputs, &mut states).map_err(cannot_run)
    };
    cases.iter().map(answer).collect()
}

/// Cases in which all rows of scores have their largest in the same place.
fn equal_actions(got: &[PolicyAnswer], want: &[PolicyAnswer], actions: usize) -> usize {
    let chosen = |answer: &PolicyAnswer| -> Vec<usize> {
        if !answer.scores.is_empty() {
            return answer.numbers.iter().map(|place| *place as usize).collect();
        }
        choices(&answer.numbers, actions).collect()
    };
    got.iter().zip(want).filter(|(got, want)| chosen(got) == chosen(want)).count()
}

/// The largest error of any number of an output, in standard deviations of that number; a number that never varies
/// counts as if it varied by the mean deviation of all.
fn largest_deviation(got: &[PolicyAnswer], want: &[PolicyAnswer]) -> f64 {
    fn numbers(answer: &PolicyAnswer) -> &[f32] {
        if answer.scores.is_empty() { &answer.numbers } else { &answer.scores }
    }
    let count = want.first().map_or(0, |answer| numbers(answer).len());
    let column = |answers: &[PolicyAnswer], index: usize| -> Vec<f64> {
        answers.iter().filter_map(|a| numbers(a).get(index)).map(|n| f64::from(*n)).collect()
    };
    let deviations: Vec<f64> = (0..count).map(|index| deviation(&column(want, index))).collect();
    let usual = deviations.iter().sum::<f64>() / count.max(1) as f64;
    let errors = deviations.iter().enumerate().map(|(index, deviation)| {
        let pairs = column(got, index).into_iter().zip(column(want, index));
        let largest = pairs.map(|(got, want)| (got - want).abs()).fold(0.0, f64::max);
        let deviation = if *deviation > 0.0 { *deviation } else { usual };
        if largest == 0.0 { 0.0 } else { largest / deviation }
    });
    errors.fold(0.0, f64::max)
}

/// The standard deviation of some numbers.
fn deviation(numbers: &[f64]) -> f64 {
    let count = numbers.len().max(1) as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    (numbers.iter().map(|number| (number - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::policy::{PolicyFacts, PolicyState};

    fn answer(numbers: &[f32]) -> PolicyAnswer {
        PolicyAnswer { numbers: numbers.to_vec(), scores: Vec::new() }
    }

    #[test]
    fn errors_count_in_what_the_action_varies_by() {
        // The first number varies by 2, the second by 0.5, the third not at all.
        let want = [[1.0, 0.0, 3.0], [5.0, 1.0, 3.0]].map(|numbers| answer(&numbers));
        let got = |change: [f32; 3]| {
            let mut got = want.clone();
            for (number, change) in got[1].numbers.iter_mut().zip(change) {
                *number += change;
            }
            largest_deviation(&got, &want)
        };
        assert_eq!(got([0.0; 3]), 0.0);
        assert_eq!(got([0.5, 0.0, 0.0]), 0.25);
        assert_eq!(got([0.5, 0.25, 0.0]), 0.5);
        assert_eq!(got([0.0, 0.0, 2.5]), 3.0);
    }

    #[test]
    fn actions_are_equal_where_the_largest_score_is() {
        let want = [answer(&[0.0, 1.0, 0.5]), answer(&[2.0, 1.0, 0.5])];
        let got = [answer(&[0.9, 1.0, 0.5]), answer(&[1.0, 1.1, 0.5])];
        assert_eq!(equal_actions(&got, &want, 3), 1);
        // What chose inside the file answers with the place.
        let place = |place: f32| PolicyAnswer { numbers: vec![place], scores: vec![0.0; 3] };
        assert_eq!(equal_actions(&[place(1.0)], &[place(1.0)], 3), 1);
        assert_eq!(equal_actions(&[place(2.0)], &[place(1.0)], 3), 0);
    }

    /// Counts its decisions in its state, and answers with it.
    struct Counter(PolicyFacts);

    impl FlatPolicy for Counter {
        fn facts(&self) -> &PolicyFacts {
            &self.0
        }

        fn run(
            &mut self,
            _: &[&[f32]],
            states: &mut [f32],
        ) -> Result<Vec<PolicyAnswer>, CompileError> {
            states.iter_mut().for_each(|state| *state += 1.0);
            Ok(vec![answer(states)])
        }

        fn step(&mut self, _: &[&[f32]]) -> Result<(), CompileError> {
            Ok(())
        }
    }

    #[test]
    fn states_are_those_recorded_else_those_left_behind() {
        let state = PolicyState { input: "h_in".into(), output: "h_out".into(), length: 1 };
        let facts = PolicyFacts {
            inputs: Vec::new(),
            outputs: Vec::new(),
            states: vec![state],
            operators: BTreeMap::new(),
            parameters: 0,
            multiply_adds: None,
        };
        let case = |states| RecordedCase { inputs: Vec::new(), states };
        let seen = |cases: &[RecordedCase<'_>]| -> Vec<f32> {
            let answers = answers(&mut Counter(facts.clone()), cases).expect("answers");
            answers.iter().map(|answers| answers[0].numbers[0]).collect()
        };
        assert_eq!(seen(&[case(None), case(None), case(None)]), [1.0, 2.0, 3.0]);
        assert_eq!(
            seen(&[case(Some(vec![7.0])), case(Some(vec![0.5])), case(None)]),
            [8.0, 1.5, 2.5]
        );
    }

    #[test]
    fn both_limits_count() {
        let agreement = |equal: Option<usize>, largest_deviation: f64| {
            let name = "q".to_owned();
            let output = OutputAgreement { name, equal_actions: equal, largest_deviation };
            PolicyAgreement { observations: 1000, outputs: vec![output] }.is_enough()
        };
        assert!(agreement(Some(995), 9.0) && !agreement(Some(994), 0.0));
        assert!(agreement(None, 0.1) && !agreement(None, 0.11));
    }
}
