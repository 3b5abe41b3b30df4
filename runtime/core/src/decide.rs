//! Policies that execute a plan.

#[cfg(feature = "std")]
use std::boxed::Box;

use crate::kernels::pause::Pause;
use crate::ops::{AllOperators, OperatorSet};
use crate::plan::{Plan, PlanError, Profile};
use crate::policy::{DecideError, Decision, Observation, Policy};

/// A policy over a plan and an arena that the caller gives.
#[derive(Debug)]
pub struct PlanPolicy<'a, S: OperatorSet = AllOperators> {
    plan: Plan<'a, S>,
    arena: &'a mut [u8],
    pause: Pause,
}

impl<'a, S: OperatorSet> PlanPolicy<'a, S> {
    /// Binds the plan of an agent, or of a policy whose inputs an agent observes, to its arena, of [`Plan::arena_bytes`] bytes and aligned like the plan; of
    /// [`Plan::batch_arena_bytes`] where several agents are to be worked on together.
    pub fn new(plan: Plan<'a, S>, arena: &'a mut [u8]) -> Result<Self, PlanError> {
        plan.check_agent()?;
        plan.check_arena(arena)?;
        Ok(Self { plan, arena, pause: Pause::default() })
    }

    /// A decision begins: the plan, and its arena.
    fn begin(&mut self) -> (&Plan<'a, S>, &mut [u8]) {
        // Weights of one byte lie in many short pieces, which loops would wait for one after the other. Those of f32 are
        // asked for ahead by the processor itself.
        if self.plan.header().profile == Profile::Int8 && self.pause.end() {
            self.plan.warm();
        }
        (&self.plan, self.arena)
    }

    /// The plan.
    pub fn plan(&self) -> &Plan<'a, S> {
        &self.plan
    }
}

#[cfg(feature = "std")]
impl<'a> PlanPolicy<'a> {
    /// As [`Self::new`], behind a trait object that is compiled with this crate: the executor of all operators is
    /// large, and a crate that names its type compiles it once more.
    pub fn boxed(
        plan: Plan<'a>,
        arena: &'a mut [u8],
    ) -> Result<Box<dyn Policy + Send + 'a>, PlanError> {
        Ok(Box::new(Self::new(plan, arena)?))
    }
}

impl<S: OperatorSet> Policy for PlanPolicy<'_, S> {
    fn actions(&self) -> usize {
        self.plan.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let (plan, arena) = self.begin();
        plan.utilities(arena, observation, None, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let (plan, arena) = self.begin();
        plan.decide(arena, observation, None)
    }

    fn hidden(&self) -> usize {
        self.plan.hidden()
    }

    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let (plan, arena) = self.begin();
        plan.utilities(arena, observation, Some(hidden), utilities)
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let (plan, arena) = self.begin();
        plan.decide(arena, observation, Some(hidden))
    }

    fn decide_batch(
        &mut self,
        observations: &[Observation<'_>],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        let (plan, arena) = self.begin();
        plan.decide_batch(arena, observations, None, decisions);
    }

    fn decide_batch_with(
        &mut self,
        observations: &[Observation<'_>],
        hidden: &mut [f32],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        let (plan, arena) = self.begin();
        plan.decide_batch(arena, observations, Some(hidden), decisions);
    }

    fn warm(&self) {
        self.plan.warm();
    }
}
