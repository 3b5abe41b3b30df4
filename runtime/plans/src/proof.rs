//! Whether a plan gives the answers that its bundle recorded: asked before anybody acts by it.

use sortie_bundle::{Bundle, GoldenCase};
use sortie_core::allocate::PlanTeamValue;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{PlanPolicy, limits};

use crate::agent_plans::{AgentPlans, policy_by_agent};
use crate::comparison::{Comparison, TOLERANCE, compare_with_golden};
use crate::error::CompileError;
use crate::golden_allocations::compare_with_golden_allocations;
use crate::options::compare_with_golden_episodes;

/// Asks the plan of a bundle's graph about all golden observations of agents that decide by it.
///
/// A plan of profile `int8` has to answer them; how far it may be off is a matter of [`crate::agreement`].
pub(crate) fn prove_agents(
    plan: Plan<'_>,
    bundle: &Bundle,
    graph: usize,
) -> Result<(), CompileError> {
    let is_int8 = plan.header().profile == Profile::Int8;
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let policies = [PlanPolicy::boxed(plan, arena.as_mut_slice())?];
    // Whoever decides by the graph decides by the only plan here.
    let graph_of = bundle.manifest().network.graph_of.iter().map(|of| usize::from(*of));
    let graph_of: Vec<usize> = graph_of.collect();
    let none = vec![0; graph_of.len()];
    let mut policy = policy_by_agent(policies.into(), &none, bundle.contract().actions.into());
    let decides = |case: &&GoldenCase| {
        graph_of.get(case.observation.self_index).is_none_or(|of| *of == graph)
    };
    let cases = bundle.golden().cases.iter().filter(decides);
    let found = compare_with_golden("plan", policy.as_mut(), cases)?;
    if is_int8 { Ok(()) } else { judge(&found) }
}

/// Asks the plans of an agent that runs options about all golden observations and episodes.
pub(crate) fn prove_options(
    plans: &AgentPlans,
    bundle: &Bundle,
    profile: Profile,
) -> Result<(), CompileError> {
    let mut arenas = plans.arenas(1)?;
    let mut policy = plans.policy(&mut arenas)?;
    let cases = compare_with_golden("plan", policy.as_mut(), &bundle.golden().cases)?;
    let episodes = compare_with_golden_episodes("plan", policy.as_mut(), bundle)?;
    if profile == Profile::Int8 {
        return Ok(());
    }
    judge(&cases)?;
    judge(&episodes)
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
