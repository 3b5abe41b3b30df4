//! What a team's agents decide by, and a policy and an allocator over it that note what they decide.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use sortie_attention::AttentionProbe;
use sortie_core::allocate::{PlanTeamValue, PointingAllocator};
use sortie_core::choose::masked_argmax;
use sortie_core::options::{OptionPolicy, PlanNetworks, Pursuit, Shown};
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, Observation,
    PlanPolicy, Policy, PolicyByAgent, UNASSIGNED,
};
use sortie_envs::Entry;

use crate::allocation::{LearnedAllocator, RuleAllocator};
use crate::cast::OptionSettings;
use crate::error::StageError;
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
    fn pursued(
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

/// The decision of one agent.
pub(crate) struct Note {
    pub(crate) agent: usize,
    pub(crate) utilities: Vec<f32>,
    /// Weights of every head for each visible entity; empty where nobody asked for them.
    pub(crate) attention: Vec<(usize, Vec<f32>)>,
    /// What it goes for, where it runs options and somebody asked.
    pub(crate) option: Option<Pursued>,
    pub(crate) visible: EntityMask,
    /// None where no action is available.
    pub(crate) action: Option<u16>,
}

/// What the process of an agent remembers: now, and before it decided in the current state.
#[derive(Clone)]
pub(crate) struct Remembered {
    pub(crate) now: Vec<f32>,
    pub(crate) before: Vec<f32>,
}

impl Remembered {
    /// Of a process that has just begun.
    pub(crate) fn nothing(size: usize) -> Self {
        Self { now: vec![0.0; size], before: vec![0.0; size] }
    }
}

/// What the agents of a team decide by, and what they have decided in the current state.
pub(crate) struct Decisions<'a> {
    pub(crate) mind: Mind<'a>,
    /// Whether somebody asks what agents think.
    pub(crate) are_told: bool,
    /// Whom agents attend to, where they do.
    pub(crate) probe: Option<AttentionProbe>,
    pub(crate) notes: Vec<Note>,
}

/// The policy of one process, which notes its decisions.
pub(crate) struct NotingPolicy<'p, 'a> {
    pub(crate) decisions: &'p mut Decisions<'a>,
    pub(crate) memory: &'p mut Remembered,
}

impl Policy for NotingPolicy<'_, '_> {
    fn actions(&self) -> usize {
        self.decisions.mind.actions()
    }

    /// As [`Self::decide`] would find them, without deciding.
    fn utilities(
        &mut self,
        seen: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let mut memory = self.memory.before.clone();
        self.decisions.mind.utilities_with(seen, &mut memory, utilities)
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions()];
        self.utilities(seen, &mut utilities)?;
        let Self { decisions: Decisions { mind, are_told, probe, notes }, memory } = self;
        // What decides by the present alone need not compute it twice.
        let decision = match memory.now.is_empty() {
            true => masked_argmax(&utilities, seen.available),
            false => mind.decide_with(seen, &mut memory.now),
        };
        let probe = probe.as_ref().filter(|_| *are_told);
        let attention = probe.map(|probe| probe.by_entity(seen)).transpose()?;
        let option = if *are_told { mind.pursued(seen, &memory.now)? } else { None };
        notes.push(Note {
            agent: seen.self_index,
            utilities,
            attention: attention.unwrap_or_default(),
            option,
            visible: seen.visible,
            action: decision.ok().map(|decision| decision.action),
        });
        decision
    }

    fn begin_episode(&mut self) -> bool {
        self.memory.now.fill(0.0);
        self.memory.before.fill(0.0);
        !self.memory.now.is_empty()
    }
}

/// What the team has learned.
pub(crate) enum Learned<'a> {
    TeamValue(Box<LearnedAllocator<'a, PlanTeamValue<'a>>>),
    Pointing(Box<PointingAllocator<'a>>),
}

/// Whoever is chosen to allocate: what the team has learned, or a rule of the environment.
pub(crate) struct Allocators<'a> {
    pub(crate) learned: Learned<'a>,
    rules: Vec<RuleAllocator>,
    /// 0 is what was learned, the others are rules.
    pub(crate) chosen: usize,
    /// `[A]`: the newest allocation.
    pub(crate) newest: Vec<u8>,
    /// Whether it is of the current frame.
    pub(crate) decided: bool,
}

impl<'a> Allocators<'a> {
    pub(crate) fn new(learned: Learned<'a>, entry: &Entry, agents: usize, seed: u64) -> Self {
        let rules = (0..entry.rules.len()).filter_map(|rule| RuleAllocator::new(entry, rule, seed));
        Self {
            learned,
            rules: rules.collect(),
            chosen: 0,
            newest: vec![UNASSIGNED; agents],
            decided: false,
        }
    }
}

impl Allocator for Allocators<'_> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        match self.chosen.checked_sub(1).and_then(|rule| self.rules.get_mut(rule)) {
            Some(rule) => rule.allocate(state, allocation)?,
            None => match &mut self.learned {
                Learned::TeamValue(learned) => learned.allocate(state, allocation)?,
                Learned::Pointing(learned) => learned.allocate(state, allocation)?,
            },
        }
        self.newest.copy_from_slice(allocation);
        self.decided = true;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A network of four actions behind one of three, and before it.
    #[test]
    fn a_team_of_several_networks_has_room_for_the_most_actions_of_any() {
        let plan = |name: &str| {
            let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/plans/");
            let bytes = std::fs::read(format!("{root}{name}")).expect("the plan is in the tree");
            AlignedBytes::copy_of(&bytes)
        };
        let plans = [plan("agent-odd-sizes-2.0.plan"), plan("agent-2.3.plan")];
        let actions = |plans: &[AlignedBytes]| {
            let arenas = plans.iter().map(|plan| {
                let plan = Plan::load(plan.as_slice()).expect("a plan");
                AlignedBytes::zeroed(plan.header().arena_bytes as usize)
            });
            let mut arenas: Vec<AlignedBytes> = arenas.collect();
            match Mind::of_networks(plans, &mut arenas, vec![0, 1]) {
                Ok(Mind::Networks(policy)) => policy.actions(),
                _ => panic!("a mind of networks"),
            }
        };
        assert_eq!(actions(&plans), 4);
        let [three, four] = plans;
        assert_eq!(actions(&[four, three]), 4);
    }
}
