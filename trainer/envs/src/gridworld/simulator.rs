//! Many episodes on one map at once.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use super::ACTION_NAMES;
use super::bytes::State;
use super::chance::{Chance, Drawn, Normals};
use super::episode::{Episode, Rules};
use super::map::{MAX_AGENTS, SIDE};
use super::pits::Pit;
use super::spec::spec;
use crate::environment::{StateError, Step, StepError};
use crate::random::Random;
use crate::spec::Spec;

/// The gridworld, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Gridworld {
    rules: Arc<Rules>,
    normals: Normals,
    spec: Spec,
    episodes: Vec<Episode>,
}

impl Gridworld {
    /// Sets up so many instances, whose episodes are over.
    pub fn new(rules: Rules, instances: usize) -> Self {
        let spec = spec(&rules);
        Self { rules: Arc::new(rules), normals: Normals::new(), spec, episodes: Vec::new() }
            .with_instances(instances)
    }

    pub(super) fn with_instances(&self, instances: usize) -> Self {
        let mut episode = Episode {
            cells: [0; MAX_AGENTS],
            found: [0; MAX_AGENTS],
            tiers: 0,
            steps: 0,
            episode_return: 0.0,
            pits: vec![Pit::default(); self.rules.map.pits().len()],
        };
        episode.start(&self.rules);
        episode.steps = self.rules.episode_limit;
        Self { episodes: vec![episode; instances], ..self.clone() }
    }

    /// What all episodes have in common.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    pub(super) fn own_spec(&self) -> &Spec {
        &self.spec
    }

    pub(super) fn count(&self) -> usize {
        self.episodes.len()
    }

    pub(super) fn running(&self, instance: usize) -> &Episode {
        &self.episodes[instance]
    }

    /// Where the agents are.
    pub fn cells(&self, instance: usize) -> &[u16] {
        &self.running(instance).cells[..self.rules.agents()]
    }

    /// What each agent found: kinds of treasures as bits.
    pub fn found(&self, instance: usize) -> &[u8] {
        &self.running(instance).found[..self.rules.agents()]
    }

    /// Tiers that are finished.
    pub fn tiers(&self, instance: usize) -> u8 {
        self.running(instance).tiers
    }

    /// The pits in their order, each as it was when somebody last looked.
    pub fn pits(&self, instance: usize) -> &[Pit] {
        &self.running(instance).pits
    }

    /// Starts an episode.
    pub fn start(&mut self, instance: usize) {
        self.episodes[instance].start(&self.rules);
    }

    /// Plays one step of chance out of a generator.
    pub(super) fn step_by(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let (noise, normals) = (self.rules.noise, self.normals.clone());
        self.step_with(instance, actions, &mut Drawn { random, noise, normals: &normals })
    }

    /// Plays one step of any chance, as for replays.
    ///
    /// # Errors
    /// As [`Environment::step`](crate::Environment::step).
    #[inline]
    pub fn step_with(
        &mut self,
        instance: usize,
        actions: &[u16],
        chance: &mut impl Chance,
    ) -> Result<Step, StepError> {
        let Self { rules, episodes, .. } = self;
        let (episode, agents) = (&mut episodes[instance], rules.agents());
        if episode.is_done(rules) {
            return Err(StepError::EpisodeOver);
        }
        let given = actions.len();
        let actions =
            actions.get(..agents).ok_or(StepError::TooFewActions { agents, actions: given })?;
        let unknown = actions.iter().position(|action| usize::from(*action) >= ACTION_NAMES.len());
        if let Some(agent) = unknown {
            return Err(StepError::Unavailable { agent, action: actions[agent] });
        }
        let reward = episode.play(rules, actions, chance);
        let terminated = episode.is_solved(rules);
        let timed_out = !terminated && episode.steps >= rules.episode_limit;
        Ok(Step { reward, terminated, timed_out, ..Step::default() })
    }

    /// Lets all pits of an instance make the steps that they are behind, so that all of them can be looked at.
    pub fn settle(&mut self, instance: usize, chance: &mut impl Chance) {
        let Self { rules, episodes, .. } = self;
        let episode = &mut episodes[instance];
        if !episode.is_solved(rules) {
            episode.settle(rules.tier(episode.tiers).0.magnitude(), chance);
        }
    }

    /// Puts an agent in another cell.
    pub(super) fn put(
        &mut self,
        instance: usize,
        agent: usize,
        [column, row]: [usize; 2],
    ) -> Result<(), StateError> {
        let Self { rules, episodes, .. } = self;
        let episode = &mut episodes[instance];
        let is_inside = agent < rules.agents() && column.max(row) < SIDE;
        let cell = is_inside.then(|| (row * SIDE + column) as u16);
        let open = cell.filter(|cell| rules.map.is_open(*cell, episode.tiers));
        let Some(cell) = open else {
            return Err(StateError::Impossible("a wall or a shut door is there".into()));
        };
        episode.cells[agent] = cell;
        Ok(())
    }

    pub(super) fn write_state(&self, instance: usize, bytes: &mut Vec<u8>) {
        State::write(self.running(instance), self.rules.agents(), bytes);
    }

    pub(super) fn read_state(&mut self, instance: usize, bytes: &[u8]) -> Result<(), StateError> {
        let state = State::read(self.rules.counts(), bytes)?.check(&self.rules)?;
        state.continue_in(&mut self.episodes[instance]);
        Ok(())
    }
}
