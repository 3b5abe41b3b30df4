//! The same policy without any server.

use sortie_core::DecideError;
use sortie_core::plan::{AlignedBytes, Plan, PlanError};

const PLAN: &[u8] = sortie_core::include_plan!("../../embed_c/cart.plan");

/// The policy in this process.
pub(crate) struct Direct {
    plan: Plan<'static>,
    arena: AlignedBytes,
    state: Vec<f32>,
}

impl Direct {
    pub(crate) fn new() -> Result<Self, PlanError> {
        let plan = Plan::load(PLAN)?;
        let (arena, state) = (AlignedBytes::zeroed(plan.arena_bytes()), vec![0.0; plan.hidden()]);
        Ok(Self { plan, arena, state })
    }

    pub(crate) fn begin_episode(&mut self) {
        self.state.fill(0.0);
    }

    pub(crate) fn force(&mut self, position: f32) -> Result<f32, DecideError> {
        let mut force = [0.0];
        let (inputs, outputs): (&[&[f32]], _) = (&[&[position]], &mut [force.as_mut_slice()]);
        self.plan.respond(self.arena.as_mut_slice(), inputs, &mut self.state, outputs)?;
        Ok(force[0])
    }
}
