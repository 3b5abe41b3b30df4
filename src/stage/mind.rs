//! What a team's agents decide by: the plans of their networks, or options over three of them.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use sortie_core::options::{OptionPolicy, PlanNetworks, Pursuit, Shown};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{DecideError, Decision, Observation, PlanPolicy, Policy, PolicyByAgent};

use crate::error::StageError;
use crate::options::OptionSettings;
use crate::thoughts::{Pursued, rounded};

/// What the agents of a team decide by.
pub(crate) enum Mind<'a> {
    /// A network for each agent, some of them the same.
    Networks(PolicyByAgent<Vec<PlanPolicy<'a>>, Vec<u16>>),
    /// An agent that goes from milestone to milestone.
    Options(Box<OptionPolicy<PlanNetworks<'a>, Vec<f32>>>),
}

impl<'a> Mind<'a> {
    /// Networks of the first so many actions, an arena for each; `plan_of` says whose is which.
    pub(crate) fn of_networks(
        plans: &'a [AlignedBytes],
        arenas: &'a mut [AlignedBytes],
        plan_of: Vec<u16>,
    ) -> Result<Self, PlanError> {
        let policy = |(plan, arena): (&'a AlignedBytes, &'a mut AlignedBytes)| {
            PlanPolicy::new(Plan::load(plan.as_slice())?, arena.as_mut_slice())
        };
        let policies = plans.iter().zip(arenas).map(policy);
        let policies = policies.collect::<Result<Vec<PlanPolicy<'a>>, PlanError>>()?;
        let actions = policies.iter().map(Policy::actions).max().unwrap_or(0);
        Ok(Self::Networks(PolicyByAgent::new(policies, plan_of, actions)))
    }

    /// Options over controller, meta-controller and affordances, which share the only arena.
    pub(crate) fn of_options(
        settings: &OptionSettings,
        plans: &'a [AlignedBytes],
        arenas: &'a mut [AlignedBytes],
    ) -> Result<Self, StageError> {
        let ([controller, meta, affordance], [arena]) = (plans, arenas) else {
            return Err(PlanError::WrongNetwork.into());
        };
        let [controller, meta, affordance] =
            [controller, meta, affordance].map(|plan| Plan::load(plan.as_slice()));
        let networks = PlanNetworks::new([controller?, meta?, affordance?], arena.as_mut_slice())?;
        let rules = settings.rules().ok_or(StageError::NoOptions)?;
        let shown = Shown::new(rules.picture).ok_or(StageError::NoOptions)?;
        let policy = OptionPolicy::new(rules, networks, vec![0.0; shown.columns()]);
        Ok(Self::Options(Box::new(policy.ok_or(StageError::NoOptions)?)))
    }

    /// What an agent with such a memory goes for; none of agents that run no options.
    pub(crate) fn pursued(
        &mut self,
        seen: &Observation<'_>,
        memory: &[f32],
    ) -> Result<Option<Pursued>, DecideError> {
        let Self::Options(policy) = self else { return Ok(None) };
        let Some(Pursuit { goal, steps }) = Pursuit::of(memory) else { return Ok(None) };
        let mut likelihoods = vec![0.0; policy.rules().milestones().len()];
        policy.likelihoods(seen, &mut likelihoods)?;
        let mask = policy.rules().mask(&likelihoods);
        let likelihoods = likelihoods.into_iter().map(rounded).collect();
        Ok(Some(Pursued { goal, step: steps, likelihoods, mask }))
    }

    fn policy(&self) -> &dyn Policy {
        match self {
            Self::Networks(policy) => policy,
            Self::Options(policy) => policy.as_ref(),
        }
    }

    fn policy_mut(&mut self) -> &mut dyn Policy {
        match self {
            Self::Networks(policy) => policy,
            Self::Options(policy) => policy.as_mut(),
        }
    }
}

impl Policy for Mind<'_> {
    fn actions(&self) -> usize {
        self.policy().actions()
    }

    fn utilities(&mut self, seen: &Observation<'_>, to: &mut [f32]) -> Result<(), DecideError> {
        self.policy_mut().utilities(seen, to)
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        self.policy_mut().decide(seen)
    }

    fn hidden(&self) -> usize {
        self.policy().hidden()
    }

    fn utilities_with(
        &mut self,
        seen: &Observation<'_>,
        memory: &mut [f32],
        to: &mut [f32],
    ) -> Result<(), DecideError> {
        self.policy_mut().utilities_with(seen, memory, to)
    }

    fn decide_with(
        &mut self,
        seen: &Observation<'_>,
        memory: &mut [f32],
    ) -> Result<Decision, DecideError> {
        self.policy_mut().decide_with(seen, memory)
    }
}
