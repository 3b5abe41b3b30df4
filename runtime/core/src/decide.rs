//! Policies that execute a plan.

use crate::plan::{Network, Plan, PlanError};
use crate::policy::{DecideError, Decision, Observation, Policy};

/// A policy over a plan and an arena that the caller gives.
#[derive(Debug)]
pub struct PlanPolicy<'a> {
    plan: Plan<'a>,
    arena: &'a mut [u8],
}

impl<'a> PlanPolicy<'a> {
    /// Binds an agent's plan to its arena, of [`Plan::arena_bytes`] bytes and aligned like the plan; of
    /// [`Plan::batch_arena_bytes`] where several agents are to be worked on together.
    pub fn new(plan: Plan<'a>, arena: &'a mut [u8]) -> Result<Self, PlanError> {
        plan.check_network(Network::Agent)?;
        plan.check_arena(arena)?;
        Ok(Self { plan, arena })
    }

    /// The plan.
    pub fn plan(&self) -> &Plan<'a> {
        &self.plan
    }
}

impl Policy for PlanPolicy<'_> {
    fn actions(&self) -> usize {
        self.plan.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.plan.utilities(self.arena, observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.plan.decide(self.arena, observation)
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
