//! Many episodes side by side, each from its own seed.

use rand_core::Rng;
use sortie_envs::Environment;
use sortie_envs::save_the_city::{DecisionPoints, EpisodeMetrics, SaveTheCity, Split, UNASSIGNED};

use super::{Allocate, EvaluationPlan, Onlooker, Scene, Team, Watched};
use crate::error::LearnError;
use crate::methods::alma::NO_ACTION;
use crate::random::{Generator, Purpose, generator};

/// One world and its running episode.
struct World {
    episode: usize,
    generator: Generator,
    decisions: DecisionPoints,
    tasks_changed: bool,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
}

/// A finished episode: the team's letters and the counts.
pub(super) type Finished = (String, EpisodeMetrics);

/// The worlds of an evaluation and the episodes still to come.
pub(super) struct Play<'a> {
    plan: &'a EvaluationPlan,
    onlooker: &'a mut dyn Onlooker,
    city: SaveTheCity,
    worlds: Vec<World>,
    /// Worlds that still play.
    active: Vec<usize>,
    next_episode: usize,
    actions: Vec<u16>,
}

impl<'a> Play<'a> {
    /// Starts as many episodes as there are worlds, from number `first_episode` on.
    pub(super) fn new(
        plan: &'a EvaluationPlan,
        first_episode: usize,
        worlds: usize,
        onlooker: &'a mut dyn Onlooker,
    ) -> Result<Self, LearnError> {
        let agents = plan.set.max_agents;
        let mut city = SaveTheCity::new(plan.set.clone(), plan.constants, worlds, 0)?;
        city.use_split(Split::Test);
        let world = |_| World {
            episode: 0,
            generator: generator(0, Purpose::Evaluation, 0),
            decisions: DecisionPoints::every(plan.interval),
            tasks_changed: false,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
        };
        let mut play = Self {
            plan,
            onlooker,
            city,
            worlds: (0..worlds).map(world).collect(),
            active: (0..worlds).collect(),
            next_episode: first_episode,
            actions: vec![0; worlds * agents],
        };
        for world in 0..worlds {
            play.start(world)?;
        }
        Ok(play)
    }

    /// Starts the next episode in a world; false when all episodes have begun.
    fn start(&mut self, index: usize) -> Result<bool, LearnError> {
        if self.next_episode == self.plan.episodes {
            return Ok(false);
        }
        let world = &mut self.worlds[index];
        world.episode = self.next_episode;
        world.generator = generator(self.plan.seed, Purpose::Evaluation, self.next_episode as u64);
        world.decisions.restart();
        world.tasks_changed = false;
        world.last_actions.fill(NO_ACTION);
        self.city.seed(index, world.generator.next_u64());
        self.city.reset(index);
        self.next_episode += 1;
        let watched = Watched { episode: world.episode, worlds: &self.city, instance: index };
        self.onlooker.started(watched)?;
        Ok(true)
    }

    /// One step in every active world; false when all episodes are finished.
    pub(super) fn step(
        &mut self,
        team: &mut dyn Team,
        allocator: &mut dyn Allocate,
        done: &mut [Option<Finished>],
    ) -> Result<bool, LearnError> {
        for index in &self.active {
            let world = &mut self.worlds[*index];
            if world.decisions.is_due(world.tasks_changed) {
                let city = self.city.city(*index);
                allocator.allocate(city, &mut world.generator, &mut world.allocation)?;
            }
        }
        let agents = self.plan.set.max_agents;
        let mut actions = std::mem::take(&mut self.actions);
        actions.fill(0);
        let scenes: Vec<Scene<'_>> = self.active.iter().map(|index| self.scene(*index)).collect();
        team.act(&scenes, &mut actions[..scenes.len() * agents], agents)?;
        self.actions = actions;

        let mut active = std::mem::take(&mut self.active);
        let mut place = 0;
        let mut failure = None;
        active.retain(|index| {
            let result = self.advance(*index, place, done);
            place += 1;
            result.unwrap_or_else(|error| {
                failure.get_or_insert(error);
                false
            })
        });
        self.active = active;
        failure.map_or(Ok(!self.active.is_empty()), Err)
    }

    fn scene(&self, index: usize) -> Scene<'_> {
        let world = &self.worlds[index];
        Scene {
            city: self.city.city(index),
            allocation: &world.allocation,
            last_actions: &world.last_actions,
        }
    }

    /// Steps a world with the actions at a place; false when it has no episode left.
    fn advance(
        &mut self,
        index: usize,
        place: usize,
        done: &mut [Option<Finished>],
    ) -> Result<bool, LearnError> {
        let agents = self.plan.set.max_agents;
        let actions = &self.actions[place * agents..][..agents];
        let outcome = self.city.step(index, actions)?;
        let world = &mut self.worlds[index];
        let watched = Watched { episode: world.episode, worlds: &self.city, instance: index };
        self.onlooker.stepped(watched, actions, &outcome)?;
        for (last, action) in world.last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        world.tasks_changed = outcome.tasks_changed;
        if !outcome.done() {
            return Ok(true);
        }
        let letters = self.city.city(index).agents.iter().map(|agent| agent.kind.letter());
        done[world.episode] = Some((letters.collect(), *self.city.metrics(index)));
        self.start(index)
    }
}
