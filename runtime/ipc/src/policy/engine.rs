//! What runs a policy that is served.

use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::wire::Reason;

/// What runs a policy: its plan, or whatever else gives the same outputs.
pub trait Engine {
    /// Writes all outputs, in the schema's order, and replaces the recurrent states, which lie one behind the other.
    ///
    /// # Errors
    /// Why it cannot: the states are as before then. [`Reason::NonFinite`] where an input, a state or an output is no
    /// finite number.
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason>;

    /// First 16 bytes of its network's id.
    fn model(&self) -> [u8; 16];

    /// Whether it runs the network's graph: it allocates, and promises nothing about bits or time.
    fn is_graph(&self) -> bool {
        false
    }

    /// Brings near what it reads.
    fn warm(&mut self) {}
}

/// A plan with its arena. A decision takes nothing from the heap.
pub(super) struct PlanEngine<'p> {
    plan: &'p Plan<'p>,
    arena: AlignedBytes,
}

impl<'p> PlanEngine<'p> {
    pub(super) fn new(plan: &'p Plan<'p>) -> Self {
        Self { plan, arena: AlignedBytes::zeroed(plan.arena_bytes()) }
    }
}

impl Engine for PlanEngine<'_> {
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason> {
        self.plan.respond(self.arena.as_mut_slice(), inputs, states, outputs).map_err(Reason::from)
    }

    fn model(&self) -> [u8; 16] {
        self.plan.header().source.first_chunk().copied().unwrap_or_default()
    }

    fn warm(&mut self) {
        self.plan.warm();
    }
}
