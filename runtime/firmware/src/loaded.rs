//! The plan of a program that decides by one, loaded, and what that needs.

use sortie_core::plan::{Plan, PlanError, arena_bytes};

use crate::measure::Needs;
use crate::plan::{OfPlan, PLAN};
use crate::words::word;

/// Numbers that it remembers, of the plan's header.
pub(crate) const HIDDEN: usize = word(PLAN, 10) as usize;

pub(crate) const NEEDS: Needs = Needs {
    plan: PLAN.len(),
    arena: arena_bytes(PLAN),
    states: 4 * HIDDEN,
    loaded: size_of::<Plan<'_, OfPlan>>(),
};

/// Loads the plan; a function of its own, whose code and stack are those of any program that does it.
#[inline(never)]
pub(crate) fn load(plan: &[u8]) -> Result<Plan<'_, OfPlan>, PlanError> {
    Plan::load_with(plan)
}
