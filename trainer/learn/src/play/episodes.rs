//! Greedy episodes, and what they come to.

use sortie_envs::{Environment, Episode, Random, Split};

use crate::error::LearnError;
use crate::evaluate::Evaluation;
use crate::method::{Act, Scene, Scenes};
use crate::random::{Purpose, generator};

/// Episodes that are played at the same time.
const WORLDS: usize = 64;

/// Plays so many episodes on starts that training never sees. Episode e of a seed is the same whoever plays it.
///
/// # Errors
/// The team cannot decide, or chose an action that is not available.
pub fn evaluate(
    environment: &dyn Environment,
    team: &mut dyn Act,
    episodes: usize,
    seed: u64,
) -> Result<Evaluation, LearnError> {
    let mut worlds = environment.open(WORLDS.min(episodes), Split::Test);
    let agents = worlds.spec().shape.agents;
    let mut done = vec![Episode::default(); episodes];
    let mut started = 0;
    let mut open = Vec::new();
    for instance in 0..worlds.instances() {
        open.extend(Open::start(&mut *worlds, instance, &mut started, episodes, seed));
    }
    let mut actions = Vec::new();
    while !open.is_empty() {
        actions.clear();
        actions.resize(open.len() * agents, 0);
        let scenes: Vec<Scene<'_>> = open.iter().map(Open::scene).collect();
        team.act(&Scenes { environment: &*worlds, scenes: &scenes }, &mut actions)?;
        for (world, actions) in open.iter_mut().zip(actions.chunks_exact(agents)) {
            let step = worlds.step(world.instance, actions, &mut world.random)?;
            world.begins = false;
            world.state.clear();
            worlds.save(world.instance, &mut world.state);
            world.is_done = step.done();
        }
        for world in open.extract_if(.., |world| world.is_done).collect::<Vec<_>>() {
            done[world.episode] = worlds.episode(world.instance);
            open.extend(Open::start(&mut *worlds, world.instance, &mut started, episodes, seed));
        }
    }
    Ok(Evaluation::of(worlds.spec().metrics.iter().map(|metric| metric.name), &done))
}

/// An episode that is being played.
struct Open {
    episode: usize,
    instance: usize,
    random: Random,
    state: Vec<u8>,
    begins: bool,
    is_done: bool,
}

impl Open {
    /// Starts the next episode, if there is one.
    fn start(
        worlds: &mut dyn Environment,
        instance: usize,
        started: &mut usize,
        episodes: usize,
        seed: u64,
    ) -> Option<Self> {
        let episode = *started;
        if episode == episodes {
            return None;
        }
        *started += 1;
        let mut random = generator(seed, Purpose::Evaluation, episode as u64);
        worlds.reset(instance, &mut random);
        let mut state = Vec::new();
        worlds.save(instance, &mut state);
        Some(Self { episode, instance, random, state, begins: true, is_done: false })
    }

    fn scene(&self) -> Scene<'_> {
        Scene { instance: self.instance, state: &self.state, begins: self.begins }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stays, and counts the episodes that begin.
    struct Begins(usize);

    impl Act for Begins {
        fn act(&mut self, scenes: &Scenes<'_>, actions: &mut [u16]) -> Result<(), LearnError> {
            self.0 += scenes.scenes.iter().filter(|scene| scene.begins).count();
            actions.fill(1);
            Ok(())
        }
    }

    #[test]
    fn an_episode_begins_once() {
        let ring = sortie_envs::open("group-matching/4x3x2", Split::Test, 1, &Default::default());
        let mut begins = Begins(0);
        let evaluation = evaluate(&*ring.unwrap(), &mut begins, 100, 1).unwrap();
        assert_eq!((begins.0, evaluation.episodes), (100, 100));
        assert!(evaluation.length_mean > 2.0, "{evaluation:?}");
    }
}
