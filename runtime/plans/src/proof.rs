//! Whether a plan gives the answers that its bundle recorded: asked before anybody acts by it.

use sortie_bundle::{Bundle, GoldenCase, OptionsContract};
use sortie_core::allocate::PlanTeamValue;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile};
use sortie_core::{Allocator, PlanPolicy, Policy, PolicyByAgent, limits};

use crate::comparison::{Comparison, TOLERANCE};
use crate::error::CompileError;
use crate::golden::{compare_pointing, compare_with_golden, compare_with_golden_allocations};
use crate::options::{self, compare_with_golden_episodes};

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
    let found = compare_with_golden(policy.as_mut(), cases, &[]);
    judge(&found, is_int8)
}

/// Asks the plans of an agent that runs options about all golden observations and episodes.
pub(crate) fn prove_options(
    plans: &AgentPlans,
    bundle: &Bundle,
    profile: Profile,
) -> Result<(), CompileError> {
    let mut arenas = plans.arenas(1)?;
    let mut policy = plans.policy(&mut arenas)?;
    let cases = compare_with_golden(policy.as_mut(), &bundle.golden().cases, &[]);
    let episodes = compare_with_golden_episodes(policy.as_mut(), bundle)?;
    judge(&cases, profile == Profile::Int8)?;
    judge(&episodes, profile == Profile::Int8)
}

/// Asks a team-value plan about all golden allocations.
pub(crate) fn prove_allocator(plan: Plan<'_>, bundle: &Bundle) -> Result<(), CompileError> {
    let limits = bundle.manifest().limits;
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(limits::AGENTS));
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, limits.n_max.into())];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows)?;
    let (golden, team_max) = (bundle.golden(), limits.team_max.into());
    judge(&compare_with_golden_allocations(&mut network, golden, team_max, &[])?, false)
}

/// Asks the plans of an allocator that points about all golden allocations.
pub(crate) fn prove_pointing(
    allocator: &mut dyn Allocator,
    bundle: &Bundle,
) -> Result<(), CompileError> {
    judge(&compare_pointing(allocator, bundle.golden()), false)
}

/// Plans of few bits have to answer.
fn judge(found: &Comparison, is_int8: bool) -> Result<(), CompileError> {
    let answers = found.refusals_differ == 0;
    if answers && (is_int8 || found.agrees() && found.action_mismatches == 0) {
        return Ok(());
    }
    Err(CompileError::Unproved {
        error: found.max_rel_error,
        limit: TOLERANCE,
        others: found.action_mismatches,
        cases: found.inputs,
    })
}

/// The plans of a bundle's agents, in the order of [`Bundle::agent_graphs`].
#[derive(Debug)]
pub struct AgentPlans {
    plans: Vec<AlignedBytes>,
    graph_of: Vec<u16>,
    actions: usize,
    options: Option<OptionsContract>,
}

impl AgentPlans {
    /// The plans of a bundle's graphs, in their order.
    pub fn new(bundle: &Bundle, plans: Vec<AlignedBytes>) -> Self {
        let graph_of = bundle.manifest().network.graph_of.clone();
        let (actions, options) = (bundle.contract().actions.into(), bundle.options().cloned());
        Self { plans, graph_of, actions, options }
    }

    /// The plans, in the order of the graphs.
    pub fn plans(&self) -> &[AlignedBytes] {
        &self.plans
    }

    /// The same, to be kept otherwise.
    pub fn into_plans(self) -> Vec<AlignedBytes> {
        self.plans
    }

    /// What decisions write to, where so many agents may be worked on together: an arena for each plan.
    ///
    /// # Errors
    /// A plan cannot be loaded.
    pub fn arenas(&self, agents: usize) -> Result<Vec<AlignedBytes>, PlanError> {
        if let Some(options) = &self.options {
            return options::arenas(options, &self.plans);
        }
        let arena = |plan: &AlignedBytes| {
            let bytes = Plan::load(plan.as_slice())?.batch_arena_bytes(agents);
            Ok(AlignedBytes::zeroed(bytes))
        };
        self.plans.iter().map(arena).collect()
    }

    /// The team's policy, over [`Self::arenas`].
    ///
    /// # Errors
    /// A plan cannot be loaded, is no agent's, or does not fit its arena.
    pub fn policy<'a>(
        &'a self,
        arenas: &'a mut [AlignedBytes],
    ) -> Result<Box<dyn Policy + Send + 'a>, PlanError> {
        if let Some(options) = &self.options {
            return options::over_plans((options, self.actions), &self.plans, arenas);
        }
        let policy = |(plan, arena): (&'a AlignedBytes, &'a mut AlignedBytes)| {
            PlanPolicy::boxed(Plan::load(plan.as_slice())?, arena.as_mut_slice())
        };
        let policies = self.plans.iter().zip(arenas).map(policy).collect::<Result<Vec<_>, _>>()?;
        Ok(policy_by_agent(policies, &self.graph_of, self.actions))
    }
}

/// The policy of a team that decides by these: the only one where it is for all, else for each agent the one that
/// `policy_of` names.
pub fn policy_by_agent<'a>(
    mut policies: Vec<Box<dyn Policy + Send + 'a>>,
    policy_of: &[u16],
    actions: usize,
) -> Box<dyn Policy + Send + 'a> {
    if policy_of.is_empty()
        && let Some(of_all) = policies.pop()
    {
        return of_all;
    }
    Box::new(PolicyByAgent::new(policies, policy_of.to_vec(), actions))
}

#[cfg(test)]
mod tests {
    use sortie_core::{DecideError, Decision, EntityMask, Observation};

    use super::*;

    /// Takes one action, whatever it sees.
    struct Always(u16);

    impl Policy for Always {
        fn actions(&self) -> usize {
            4
        }

        fn utilities(
            &mut self,
            _: &Observation<'_>,
            utilities: &mut [f32],
        ) -> Result<(), DecideError> {
            utilities.fill(0.0);
            Ok(())
        }

        fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
            Ok(Decision { action: self.0, utility: 0.0 })
        }
    }

    #[test]
    fn every_agent_decides_by_the_policy_that_is_named_for_it() {
        let policies =
            || [3, 1].map(|action| Box::new(Always(action)) as Box<dyn Policy + Send>).into();
        let actions = |policy_of: &[u16]| {
            let mut policy = policy_by_agent(policies(), policy_of, 4);
            [0, 1, 2].map(|agent| {
                let seen = Observation {
                    rows: &[0.0; 3],
                    stride: 1,
                    last_actions: &[0; 3],
                    visible: EntityMask::first(3),
                    self_index: agent,
                    available: &[1; 4],
                };
                policy.decide(&seen).unwrap().action
            })
        };
        assert_eq!(actions(&[1, 0, 1]), [1, 3, 1]);
        assert_eq!(actions(&[0, 0, 1]), [3, 3, 1]);
    }
}
