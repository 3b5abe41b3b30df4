//! A policy and an allocator that note what they decide.

use alloc::vec;
use alloc::vec::Vec;

use sortie_attention::AttentionProbe;
use sortie_core::allocate::PlanTeamValue;
use sortie_core::choose::masked_argmax;
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, Observation,
    PlanPolicy, Policy, UNASSIGNED,
};
use sortie_envs::Entry;

use crate::rules::RuleAllocator;
use crate::search::LearnedAllocator;

/// The decision of one agent.
pub(crate) struct Note {
    pub(crate) agent: usize,
    pub(crate) utilities: Vec<f32>,
    /// Weights of every head for each visible entity; empty where nobody asked for them.
    pub(crate) attention: Vec<(usize, Vec<f32>)>,
    pub(crate) visible: EntityMask,
    /// None where no action is available.
    pub(crate) action: Option<u16>,
}

/// A policy that notes its decisions.
pub(crate) struct NotingPolicy<'a> {
    pub(crate) policy: PlanPolicy<'a>,
    /// Whom agents attend to, where that is asked for.
    pub(crate) probe: Option<AttentionProbe>,
    pub(crate) notes: Vec<Note>,
}

impl Policy for NotingPolicy<'_> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.policy.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions()];
        self.policy.utilities(observation, &mut utilities)?;
        let attention =
            self.probe.as_ref().map(|probe| probe.by_entity(observation)).transpose()?;
        let decision = masked_argmax(&utilities, observation.available);
        self.notes.push(Note {
            agent: observation.self_index,
            utilities,
            attention: attention.unwrap_or_default(),
            visible: observation.visible,
            action: decision.ok().map(|decision| decision.action),
        });
        decision
    }
}

/// Whoever is chosen to allocate: what the team has learned, or a rule of the environment.
pub(crate) struct Allocators<'a> {
    pub(crate) learned: LearnedAllocator<'a, PlanTeamValue<'a>>,
    rules: Vec<RuleAllocator>,
    /// 0 is what was learned, the others are rules.
    pub(crate) chosen: usize,
    /// `[A]`: the newest allocation.
    pub(crate) newest: Vec<u8>,
    /// Whether it is of the current frame.
    pub(crate) decided: bool,
}

impl<'a> Allocators<'a> {
    pub(crate) fn new(
        learned: LearnedAllocator<'a, PlanTeamValue<'a>>,
        entry: &Entry,
        agents: usize,
        seed: u64,
    ) -> Self {
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
            None => self.learned.allocate(state, allocation)?,
        }
        self.newest.copy_from_slice(allocation);
        self.decided = true;
        Ok(())
    }
}
