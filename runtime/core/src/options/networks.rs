//! The three networks of an agent that runs options.

use crate::ops::{AllOperators, OperatorSet};
use crate::plan::{Plan, PlanError};
use crate::policy::DecideError;

/// Controller, meta-controller and affordance network, over the columns that they are shown.
pub trait OptionNetworks {
    /// Writes the value of every action for a goal.
    fn actions(
        &mut self,
        shown: &[f32],
        goal: usize,
        values: &mut [f32],
    ) -> Result<(), DecideError>;

    /// Writes the value of every goal.
    fn goals(&mut self, shown: &[f32], values: &mut [f32]) -> Result<(), DecideError>;

    /// Writes how likely each milestone can be reached next.
    fn affordances(&mut self, shown: &[f32], likelihoods: &mut [f32]) -> Result<(), DecideError>;
}

/// Plans of the three networks, over one arena: they do not work at once.
#[derive(Debug)]
pub struct PlanNetworks<'a, S: OperatorSet = AllOperators> {
    controller: Plan<'a, S>,
    meta: Plan<'a, S>,
    affordance: Plan<'a, S>,
    arena: &'a mut [u8],
}

impl<'a, S: OperatorSet> PlanNetworks<'a, S> {
    /// Binds controller, meta-controller and affordance network to an arena that is large enough for each.
    pub fn new(plans: [Plan<'a, S>; 3], arena: &'a mut [u8]) -> Result<Self, PlanError> {
        for plan in &plans {
            plan.check_arena(arena)?;
        }
        let [controller, meta, affordance] = plans;
        Ok(Self { controller, meta, affordance, arena })
    }
}

impl<S: OperatorSet> OptionNetworks for PlanNetworks<'_, S> {
    fn actions(
        &mut self,
        shown: &[f32],
        goal: usize,
        values: &mut [f32],
    ) -> Result<(), DecideError> {
        // Goals are few enough to be exact.
        let inputs = [shown, &[goal as f32]];
        self.controller.respond(self.arena, &inputs, &mut [], &mut [values])
    }

    fn goals(&mut self, shown: &[f32], values: &mut [f32]) -> Result<(), DecideError> {
        self.meta.respond(self.arena, &[shown], &mut [], &mut [values])
    }

    fn affordances(&mut self, shown: &[f32], likelihoods: &mut [f32]) -> Result<(), DecideError> {
        self.affordance.respond(self.arena, &[shown], &mut [], &mut [likelihoods])
    }
}
