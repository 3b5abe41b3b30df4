//! Many rings at once: resets, steps and states.

use alloc::format;
use alloc::vec;
use alloc::vec::Vec;

use super::bytes::State;
use super::error::ParametersError;
use super::metrics::EpisodeMetrics;
use super::parameters::Parameters;
use super::reset::{draw_cells, draw_groups, has_both};
use super::ring::{Ring, all_agents, member_bytes};
use super::rules::{ACTIONS, moved, reward, slipped};
use super::spec::spec;
use crate::environment::{Split, StateError, Step, StepError};
use crate::random::Random;
use crate::spec::Spec;

/// Group Matching, many instances in one object. Nothing is allocated after construction.
#[derive(Clone, Debug)]
pub struct GroupMatching {
    parameters: Parameters,
    spec: Spec,
    split: Split,
    episodes: Vec<Episode>,
}

/// What an instance has once.
#[derive(Clone, Debug)]
struct Episode {
    cells: Vec<u8>,
    members: Vec<u8>,
    matches: usize,
    steps: u32,
    episode_return: f64,
}

impl Episode {
    /// Everybody in the first cell, and in the last group; the time is over.
    fn new(parameters: &Parameters) -> Self {
        let bytes = member_bytes(parameters.agents);
        let mut members = vec![0; parameters.groups * bytes];
        let all = all_agents(parameters.agents).to_le_bytes();
        let last = members.len() - bytes;
        members[last..].copy_from_slice(&all[..bytes]);
        Self {
            cells: vec![0; parameters.agents],
            members,
            matches: parameters.groups,
            steps: parameters.episode_limit,
            episode_return: 0.0,
        }
    }

    fn ring(&self) -> Ring<'_> {
        Ring { cells: &self.cells, members: &self.members }
    }

    /// Counts from here on.
    fn begin(&mut self, steps: u32, episode_return: f64) {
        self.matches = self.ring().matches();
        self.steps = steps;
        self.episode_return = episode_return;
    }
}

impl GroupMatching {
    /// Sets up `instances` rings whose episodes are over.
    pub fn new(parameters: Parameters, instances: usize) -> Result<Self, ParametersError> {
        parameters.check()?;
        if parameters.holds_out() && !has_both(&parameters) {
            return Err(ParametersError::HeldOut);
        }
        let episodes = vec![Episode::new(&parameters); instances];
        Ok(Self { episodes, spec: spec(&parameters), split: Split::Train, parameters })
    }

    /// What the rules leave open.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The same rules with so many instances, whose episodes are over, and other starts.
    pub(super) fn with_instances(&self, instances: usize, split: Split) -> Self {
        let episodes = vec![Episode::new(&self.parameters); instances];
        Self { episodes, spec: self.spec.clone(), split, parameters: self.parameters }
    }

    pub(super) fn own_spec(&self) -> &Spec {
        &self.spec
    }

    pub(super) fn count(&self) -> usize {
        self.episodes.len()
    }

    /// Who stands where, and who belongs together.
    pub fn ring(&self, instance: usize) -> Ring<'_> {
        self.episodes[instance].ring()
    }

    /// The values of the episode so far.
    pub fn metrics(&self, instance: usize) -> EpisodeMetrics {
        let episode = &self.episodes[instance];
        EpisodeMetrics {
            solved: self.is_solved(instance),
            episode_return: episode.episode_return,
            steps: episode.steps,
            matches: episode.matches,
            timed_out: episode.steps >= self.parameters.episode_limit,
        }
    }

    /// Whether the episode is over and the instance waits for a reset.
    pub fn is_done(&self, instance: usize) -> bool {
        self.is_solved(instance) || self.episodes[instance].steps >= self.parameters.episode_limit
    }

    /// A start may be solved already; only the first step decides.
    fn is_solved(&self, instance: usize) -> bool {
        let episode = &self.episodes[instance];
        episode.steps > 0 && episode.matches == self.parameters.groups
    }

    /// Starts a new episode.
    pub(super) fn start(&mut self, instance: usize, random: &mut Random) {
        let (parameters, episode) = (&self.parameters, &mut self.episodes[instance]);
        draw_groups(parameters, self.split, random, &mut episode.members);
        draw_cells(parameters, random, &mut episode.cells);
        episode.begin(0, 0.0);
    }

    /// Asks every agent for its action, which chance may replace.
    pub(super) fn step_with_noise(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let parameters = self.parameters;
        self.step_with(instance, actions, |action| slipped(&parameters, action, random))
    }

    /// Steps with the actions that happened, for replays.
    pub fn step_executed(&mut self, instance: usize, executed: &[u16]) -> Result<Step, StepError> {
        self.step_with(instance, executed, |action| action)
    }

    fn step_with(
        &mut self,
        instance: usize,
        actions: &[u16],
        mut execute: impl FnMut(u16) -> u16,
    ) -> Result<Step, StepError> {
        let Parameters { agents, cells, groups, episode_limit, .. } = self.parameters;
        if self.is_done(instance) {
            return Err(StepError::EpisodeOver);
        }
        let given = actions.len();
        let actions =
            actions.get(..agents).ok_or(StepError::TooFewActions { agents, actions: given })?;
        let unknown = actions.iter().position(|action| usize::from(*action) >= ACTIONS);
        if let Some(agent) = unknown {
            return Err(StepError::Unavailable { agent, action: actions[agent] });
        }
        let episode = &mut self.episodes[instance];
        for (cell, action) in episode.cells.iter_mut().zip(actions) {
            *cell = moved(*cell, execute(*action), cells);
        }
        let before = episode.matches;
        episode.matches = episode.ring().matches();
        episode.steps += 1;
        let reward = reward(before, episode.matches);
        episode.episode_return += reward;
        // What ends at the limit counts as cut off there, solved or not.
        let (solved, timed_out) = (episode.matches == groups, episode.steps >= episode_limit);
        Ok(Step { reward, terminated: solved && !timed_out, timed_out, tasks_changed: false })
    }

    /// Puts an agent in another cell; what the groups came to so far counts from there.
    pub(super) fn put(
        &mut self,
        instance: usize,
        agent: usize,
        cell: u8,
    ) -> Result<(), StateError> {
        let Parameters { agents, cells, groups, .. } = self.parameters;
        if agent >= agents || usize::from(cell) >= cells {
            return Err(StateError::Impossible(format!("the ring has {cells} cells")));
        }
        let episode = &mut self.episodes[instance];
        let before = core::mem::replace(&mut episode.cells[agent], cell);
        let matches = episode.ring().matches();
        if matches == groups {
            episode.cells[agent] = before;
            return Err(StateError::Impossible("the last group gathers by itself only".into()));
        }
        episode.matches = matches;
        Ok(())
    }

    pub(super) fn write_state(&self, instance: usize, bytes: &mut Vec<u8>) {
        let Episode { steps, episode_return, .. } = self.episodes[instance];
        State { steps, episode_return, ring: self.ring(instance) }.write(bytes);
    }

    pub(super) fn read_state(&mut self, instance: usize, bytes: &[u8]) -> Result<(), StateError> {
        let state = State::read(&self.parameters, bytes)?.check(&self.parameters)?;
        let episode = &mut self.episodes[instance];
        episode.cells.copy_from_slice(state.ring.cells);
        episode.members.copy_from_slice(state.ring.members);
        episode.begin(state.steps, state.episode_return);
        Ok(())
    }
}
