//! For programs with a heap: the plans of an allocator that points, and the memory that they work in.

use alloc::vec;
use alloc::vec::Vec;

use super::{PointingAllocator, PointingRules};
use crate::plan::{AlignedBytes, Plan, PlanError};

/// The plans of encoder and decoder, with their memory.
#[derive(Debug)]
pub struct PointingMemory {
    plans: [AlignedBytes; 2],
    rules: PointingRules,
    arena: AlignedBytes,
    memory: Vec<f32>,
}

impl PointingMemory {
    /// Memory for two plans.
    ///
    /// # Errors
    /// The bytes are no plans.
    pub fn new(plans: [AlignedBytes; 2], rules: PointingRules) -> Result<Self, PlanError> {
        let [encoder, decoder] = plans.each_ref().map(|plan| Plan::load(plan.as_slice()));
        let (encoder, decoder) = (encoder?, decoder?);
        let arena = AlignedBytes::zeroed(encoder.arena_bytes().max(decoder.arena_bytes()));
        let memory = vec![0.0; PointingAllocator::memory_floats([&encoder, &decoder])];
        Ok(Self { plans, rules, arena, memory })
    }

    /// The plans of encoder and decoder.
    pub fn plans(&self) -> &[AlignedBytes; 2] {
        &self.plans
    }

    /// What agents can be given.
    pub fn rules(&self) -> PointingRules {
        self.rules
    }

    /// The allocator over this memory.
    ///
    /// # Errors
    /// The plans are other networks'.
    pub fn bind(&mut self) -> Result<PointingAllocator<'_>, PlanError> {
        let Self { plans: [encoder, decoder], rules, arena, memory } = self;
        let plans = [Plan::load(encoder.as_slice())?, Plan::load(decoder.as_slice())?];
        PointingAllocator::new(plans, *rules, arena.as_mut_slice(), memory)
    }
}
