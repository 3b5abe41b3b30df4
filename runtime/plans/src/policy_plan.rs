//! The plan of a policy, behind the same trait as the engines that run its file.

use serde::{Deserialize, Serialize};
use sortie_core::plan::{AlignedBytes, Network, Plan};

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
