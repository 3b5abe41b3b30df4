//! The plans that a bundle's agents decide by: one for all, or one for each of its graphs.

use sortie_bundle::{Bundle, OptionsContract};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{PlanPolicy, Policy, PolicyByAgent};

use crate::options;

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
    ) -> Result<Box<dyn Policy + 'a>, PlanError> {
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
    mut policies: Vec<Box<dyn Policy + 'a>>,
    policy_of: &[u16],
    actions: usize,
) -> Box<dyn Policy + 'a> {
    if policy_of.is_empty()
        && let Some(of_all) = policies.pop()
    {
        return of_all;
    }
    Box::new(PolicyByAgent::new(policies, policy_of.to_vec(), actions))
}
