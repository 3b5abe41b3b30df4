//! What runs on the microcontroller: a plan, the memory that it needs, and one call for every step of the control loop.
//!
//! The policy brings a cart to rest at 0 by its position alone, and so has to remember; `examples/embed_c/cart.py` learned
//! it, `sortie compile cart.onnx -o cart.plan` made the plan.
#![no_std]

use sortie_core::DecideError;
use sortie_core::operators::Policies;
use sortie_core::plan::{Aligned, Plan, PlanError, arena_bytes};

const PLAN: &[u8] = sortie_core::include_plan!("../../embed_c/cart.plan");

/// Numbers that the policy remembers; `sortie inspect cart.onnx` shows them.
const STATE: usize = 16;

/// The cart's controller: all of its memory is here.
pub struct Controller {
    /// With the operators of policies alone, so that no others are in the image.
    plan: Plan<'static, Policies>,
    arena: Aligned<[u8; arena_bytes(PLAN)]>,
    state: [f32; STATE],
}

impl Controller {
    /// Checks the plan; an episode begins.
    pub fn new() -> Result<Self, PlanError> {
        let (plan, arena) = (Plan::load_with(PLAN)?, Aligned([0; arena_bytes(PLAN)]));
        Ok(Self { plan, arena, state: [0.0; STATE] })
    }

    /// The force, from -1 to 1, at a measured position. An error leaves what the policy remembers as it was.
    pub fn force(&mut self, position: f32) -> Result<f32, DecideError> {
        let mut force = [0.0];
        let (inputs, outputs): (&[&[f32]], _) = (&[&[position]], &mut [force.as_mut_slice()]);
        self.plan.respond(&mut self.arena.0, inputs, &mut self.state, outputs)?;
        let [force] = force;
        Ok(force)
    }
}
