//! Many episodes side by side, each from its own seed.

use rand_core::Rng;
use sortie_envs::save_the_city::SaveTheCity;
use sortie_envs::{Environment, Episode};

use super::worlds::Worlds;
use super::{Allocate, EvaluationPlan, Onlooker, Team, Watched};
use sortie_learn::LearnError;
use sortie_learn::random::{Purpose, generator};

/// The worlds of an evaluation and the episodes still to come.
pub(super) struct Play<'a> {
    plan: &'a EvaluationPlan,
    onlooker: &'a mut dyn Onlooker,
    worlds: Worlds,
    /// The number of the episode of each world.
    running: Vec<usize>,
    next_episode: usize,
}

impl<'a> Play<'a> {
    /// Starts as many episodes as there are worlds, from number `first_episode` on.
    pub(super) fn new(
        plan: &'a EvaluationPlan,
        first_episode: usize,
        worlds: usize,
        onlooker: &'a mut dyn Onlooker,
    ) -> Result<Self, LearnError> {
        let mut play = Self {
            plan,
            onlooker,
            worlds: Worlds::new(plan, worlds)?,
            running: vec![0; worlds],
            next_episode: first_episode,
        };
        for world in 0..worlds {
            play.start(world)?;
        }
        Ok(play)
    }

    /// What is played in.
    pub(super) fn worlds(&self) -> &SaveTheCity {
        &self.worlds.city
    }

    /// Starts the next episode in a world, if there is one left.
    fn start(&mut self, index: usize) -> Result<(), LearnError> {
        if self.next_episode == self.plan.episodes {
            return Ok(());
        }
        let episode = self.next_episode;
        self.next_episode += 1;
        let mut own = generator(self.plan.seed, Purpose::Evaluation, episode as u64);
        let mut random = sortie_envs::random::generator(own.next_u64());
        self.worlds.city.reset(index, &mut random);
        self.worlds.begin(index, random, own);
        self.running[index] = episode;
        let watched = Watched { episode, worlds: &self.worlds.city, instance: index };
        self.onlooker.started(watched)
    }

    /// One step in every active world; false when all episodes are finished.
    pub(super) fn step(
        &mut self,
        team: &mut dyn Team,
        allocator: &mut dyn Allocate,
        done: &mut [Option<Episode>],
    ) -> Result<bool, LearnError> {
        self.worlds.choose(team, allocator)?;
        for place in 0..self.worlds.active().len() {
            self.advance(place, done)?;
        }
        self.worlds.retire();
        Ok(!self.worlds.active().is_empty())
    }

    /// Steps the world at a place, and starts its next episode where this one ends.
    fn advance(&mut self, place: usize, done: &mut [Option<Episode>]) -> Result<(), LearnError> {
        let index = self.worlds.active()[place];
        let outcome = self.worlds.advance(place)?;
        let (episode, city) = (self.running[index], &self.worlds.city);
        let watched = Watched { episode, worlds: city, instance: index };
        self.onlooker.stepped(watched, self.worlds.actions(place), &outcome)?;
        if outcome.done() {
            done[episode] = Some(city.episode(index));
            self.start(index)?;
        }
        Ok(())
    }
}
