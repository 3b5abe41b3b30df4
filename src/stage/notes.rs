//! A policy and an allocator that note what they decide.

use alloc::vec;
use alloc::vec::Vec;

use sortie_attention::AttentionProbe;
use sortie_core::allocate::PlanTeamValue;
use sortie_core::choose::masked_argmax;
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, Observation,
    Policy, UNASSIGNED,
};
use sortie_envs::Entry;

use crate::mind::Mind;
use crate::rules::RuleAllocator;
use crate::search::LearnedAllocator;
use crate::thoughts::Pursued;

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
