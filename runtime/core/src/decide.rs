//! Policies that execute a plan.

use crate::ops::{AllOperators, OperatorSet};
use crate::plan::{Network, Plan, PlanError};
use crate::policy::{DecideError, Decision, Observation, Policy};

/// A policy over a plan and an arena that the caller gives.
#[derive(Debug)]
pub struct PlanPolicy<'a, S: OperatorSet = AllOperators> {
    plan: Plan<'a, S>,
    arena: &'a mut [u8],
}

impl<'a, S: OperatorSet> PlanPolicy<'a, S> {
    /// Binds an agent's plan to its arena, of [`Plan::arena_bytes`] bytes and aligned like the plan; of
    /// [`Plan::batch_arena_bytes`] where several agents are to be worked on together.
    pub fn new(plan: Plan<'a, S>, arena: &'a mut [u8]) -> Result<Self, PlanError> {
        plan.check_network(Network::Agent)?;
        plan.check_arena(arena)?;
        Ok(Self { plan, arena })
    }

    /// The plan.
    pub fn plan(&self) -> &Plan<'a, S> {
        &self.plan
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
        self.plan.utilities(self.arena, observation, None, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.plan.decide(self.arena, observation, None)
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
        self.plan.utilities(self.arena, observation, Some(hidden), utilities)
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        self.plan.decide(self.arena, observation, Some(hidden))
    }

    fn decide_batch(
        &mut self,
        observations: &[Observation<'_>],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        self.plan.decide_batch(self.arena, observations, decisions);
    }

    fn warm(&self) {
        self.plan.warm();
    }
}
