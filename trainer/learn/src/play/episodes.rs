//! Greedy episodes, and what they come to.

use rand_core::Rng;
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
    let mut starts = (0..episodes).map(|episode| Start::of(seed, episode));
    // What the team leaves to chance in each instance.
    let mut random = vec![sortie_envs::random::generator(0); worlds.instances()];
    let mut open: Vec<Open> = (0..worlds.instances())
        .zip(&mut starts)
        .map(|(instance, start)| start.begin(&mut *worlds, instance, &mut random))
        .collect();
    let mut actions = Vec::new();
    while !open.is_empty() {
        actions.clear();
        actions.resize(open.len() * agents, 0);
        let scenes: Vec<Scene<'_>> = open.iter().map(Open::scene).collect();
        let scenes = Scenes { environment: &*worlds, scenes: &scenes };
        team.act(&scenes, &mut random, &mut actions)?;
        for (world, actions) in open.iter_mut().zip(actions.chunks_exact(agents)) {
            worlds.note_allocation(world.instance, team.allocation(world.instance));
            let step = worlds.step(world.instance, actions, &mut world.random)?;
            world.begins = false;
            world.tasks_changed = step.tasks_changed;
            world.state.clear();
            worlds.save(world.instance, &mut world.state);
            world.is_done = step.done();
        }
        for world in open.iter_mut().filter(|world| world.is_done) {
            done[world.episode] = worlds.episode(world.instance);
            if let Some(start) = starts.next() {
                *world = start.begin(&mut *worlds, world.instance, &mut random);
            }
        }
        open.retain(|world| !world.is_done);
    }
    Ok(Evaluation::of(worlds.spec(), &done))
}

/// An episode to be measured on.
#[derive(Clone, Debug)]
pub struct Start {
    /// Its number.
    pub episode: usize,
    /// Draws the start, and what the steps leave to chance.
    pub world: Random,
    /// Draws what the team leaves to chance.
    pub team: Random,
}

impl Start {
    /// An episode of a seed, by its number.
    pub fn of(seed: u64, episode: usize) -> Self {
        let mut team = generator(seed, Purpose::Evaluation, episode as u64);
        Self { episode, world: sortie_envs::random::generator(team.next_u64()), team }
    }

    fn begin(self, worlds: &mut dyn Environment, instance: usize, teams: &mut [Random]) -> Open {
        let Self { episode, world: mut random, team } = self;
        worlds.reset(instance, &mut random);
        teams[instance] = team;
        let mut state = Vec::new();
        worlds.save(instance, &mut state);
        let (begins, tasks_changed, is_done) = (true, false, false);
        Open { episode, instance, random, state, begins, tasks_changed, is_done }
    }
}

/// An episode that is being played.
struct Open {
    episode: usize,
    instance: usize,
    random: Random,
    state: Vec<u8>,
    begins: bool,
    tasks_changed: bool,
    is_done: bool,
}

impl Open {
    fn scene(&self) -> Scene<'_> {
        let Self { instance, ref state, begins, tasks_changed, .. } = *self;
        Scene { instance, state, begins, tasks_changed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stays, and counts the episodes that begin.
    struct Begins(usize);

    impl Act for Begins {
        fn act(
            &mut self,
            scenes: &Scenes<'_>,
            _: &mut [Random],
            actions: &mut [u16],
        ) -> Result<(), LearnError> {
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
