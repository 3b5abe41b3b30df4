//! Whether a plan gives the answers that its bundle recorded: asked before anybody acts by it.

use sortie_bundle::Bundle;
use sortie_core::allocate::PlanTeamValue;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{PlanPolicy, limits};

use crate::comparison::{Comparison, TOLERANCE, compare_with_golden};
use crate::error::CompileError;
use crate::golden_allocations::compare_with_golden_allocations;

/// Asks an agent's plan about all golden observations.
///
/// A plan of profile `int8` has to answer them; how far it may be off is a matter of [`crate::agreement`].
pub(crate) fn prove_agent(plan: Plan<'_>, bundle: &Bundle) -> Result<(), CompileError> {
    let is_int8 = plan.header().profile == Profile::Int8;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::boxed(plan, arena.as_mut_slice())?;
    let found = compare_with_golden("plan", policy.as_mut(), bundle.golden())?;
    if is_int8 { Ok(()) } else { judge(&found) }
}

/// Asks a team-value plan about all golden allocations.
pub(crate) fn prove_allocator(plan: Plan<'_>, bundle: &Bundle) -> Result<(), CompileError> {
    let limits = bundle.manifest().limits;
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(limits::AGENTS));
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, limits.n_max.into())];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows)?;
    let (golden, team_max) = (bundle.golden(), limits.team_max.into());
    judge(&compare_with_golden_allocations("plan", &mut network, golden, team_max)?)
}

fn judge(found: &Comparison) -> Result<(), CompileError> {
    if found.agrees() && found.action_mismatches == 0 {
        return Ok(());
    }
    Err(CompileError::Unproved {
        error: found.max_rel_error,
        limit: TOLERANCE,
        others: found.action_mismatches,
        cases: found.inputs,
    })
}
