//! Greedy episodes, and what they come to.

use std::ops::Range;

use sortie_envs::{Environment, Episode, Random, Split, Step};

use crate::act::{Act, Ask, Scene, Scenes};
use crate::error::Result;
use crate::evaluate::Evaluation;

/// Episodes that are played at the same time.
pub const WORLDS: usize = 64;

/// Plays so many episodes on starts that training never sees. Episode e of a seed is the same whoever plays it.
///
/// # Errors
/// The team cannot decide, or chose an action that is not available.
pub fn evaluate(
    environment: &dyn Environment,
    team: &mut dyn Act,
    episodes: usize,
    seed: u64,
) -> Result<Evaluation> {
    evaluate_watched(environment, team, episodes, seed, &mut ())
}

/// The same while somebody watches.
///
/// # Errors
/// As before, or who watches cannot go on.
pub fn evaluate_watched(
    environment: &dyn Environment,
    team: &mut dyn Act,
    episodes: usize,
    seed: u64,
    onlooker: &mut dyn Onlooker,
) -> Result<Evaluation> {
    let mut worlds = environment.open(WORLDS.min(episodes), Split::Test);
    let done = watch(&mut *worlds, team, 0..episodes, seed, onlooker)?;
    Ok(Evaluation::of(worlds.spec(), &done))
}

/// An instance of an environment in which an episode is watched.
#[derive(Clone, Copy)]
pub struct Watched<'a> {
    /// Number of the episode.
    pub episode: usize,
    /// All instances.
    pub worlds: &'a dyn Environment,
    /// The one that is meant.
    pub instance: usize,
}

/// Watches episodes, which are played side by side.
pub trait Onlooker {
    /// An episode shows its first state.
    fn started(&mut self, _watched: Watched<'_>) -> Result<()> {
        Ok(())
    }

    /// A step was taken; the instance has not started anew.
    fn stepped(&mut self, _watched: Watched<'_>, _actions: &[u16], _step: &Step) -> Result<()> {
        Ok(())
    }
}

/// Nobody watches.
impl Onlooker for () {}

/// Plays these episodes of a seed, as many at a time as there are instances, while somebody watches.
///
/// # Errors
/// The team cannot decide, chose an action that is not available, or who watches cannot go on.
pub fn watch(
    worlds: &mut dyn Environment,
    team: &mut dyn Act,
    episodes: Range<usize>,
    seed: u64,
    onlooker: &mut dyn Onlooker,
) -> Result<Vec<Episode>> {
    let first = episodes.start;
    let mut done = vec![Episode::default(); episodes.len()];
    let mut starts = episodes.map(|episode| Start::of(seed, episode));
    // What the team leaves to chance in each instance.
    let mut random = vec![sortie_envs::random::generator(0); worlds.instances()];
    let mut open: Vec<Open> = (0..worlds.instances())
        .zip(&mut starts)
        .map(|(instance, start)| start.begin(worlds, instance, &mut random))
        .collect();
    open.iter().try_for_each(|world| onlooker.started(world.watched(worlds)))?;
    while !open.is_empty() {
        round(worlds, team, &mut open, &mut random, onlooker)?;
        for world in open.iter_mut().filter(|world| world.is_done) {
            done[world.episode - first] = worlds.episode(world.instance);
            if let Some(start) = starts.next() {
                *world = start.begin(worlds, world.instance, &mut random);
                onlooker.started(world.watched(worlds))?;
            }
        }
        open.retain(|world| !world.is_done);
    }
    Ok(done)
}

/// Plays instances from the states that they are in to the end of their episodes; returns what each earned meanwhile, in
/// their order.
///
/// Every instance comes with a generator for what the world leaves to chance; `random` holds one for what the team does,
/// for every instance by its number.
pub(super) fn finish(
    worlds: &mut dyn Environment,
    team: &mut dyn Act,
    instances: Vec<(usize, Random)>,
    random: &mut [Random],
) -> Result<Vec<f64>> {
    let mut earned = vec![0.0; instances.len()];
    let go_on = |(place, (instance, random))| Open::at(worlds, (place, instance), random);
    let mut open: Vec<Open> = instances.into_iter().enumerate().map(go_on).collect();
    while !open.is_empty() {
        round(worlds, team, &mut open, random, &mut ())?;
        open.iter().for_each(|world| earned[world.episode] += world.reward);
        open.retain(|world| !world.is_done);
    }
    Ok(earned)
}

/// Has the team act once in every open world.
fn round(
    worlds: &mut dyn Environment,
    team: &mut dyn Act,
    open: &mut [Open],
    random: &mut [Random],
    onlooker: &mut dyn Onlooker,
) -> Result<()> {
    let agents = worlds.spec().shape.agents;
    let mut actions = vec![0; open.len() * agents];
    let scenes: Vec<Scene<'_>> = open.iter().map(Open::scene).collect();
    let scenes = &Scenes { environment: worlds, scenes: &scenes };
    team.act(Ask { scenes, random, actions: &mut actions })?;
    for (world, actions) in open.iter_mut().zip(actions.chunks_exact(agents)) {
        worlds.note_allocation(world.instance, team.allocation(world.instance));
        let step = worlds.step(world.instance, actions, &mut world.random)?;
        onlooker.stepped(world.watched(worlds), actions, &step)?;
        world.begins = false;
        world.tasks_changed = step.tasks_changed;
        world.state.clear();
        worlds.save(world.instance, &mut world.state);
        world.reward = step.reward;
        world.is_done = step.done();
    }
    Ok(())
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
        let (world, team) = sortie_envs::random::episode(seed, episode);
        Self { episode, world, team }
    }

    fn begin(self, worlds: &mut dyn Environment, instance: usize, teams: &mut [Random]) -> Open {
        let Self { episode, world: mut random, team } = self;
        worlds.reset(instance, &mut random);
        teams[instance] = team;
        Open { begins: true, ..Open::at(worlds, (episode, instance), random) }
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
    /// Of the last step.
    reward: f64,
    is_done: bool,
}

impl Open {
    /// An episode that goes on in an instance from the state that it is in.
    fn at(worlds: &dyn Environment, (episode, instance): (usize, usize), random: Random) -> Self {
        let mut state = Vec::new();
        worlds.save(instance, &mut state);
        let (begins, tasks_changed, reward, is_done) = (false, false, 0.0, false);
        Self { episode, instance, random, state, begins, tasks_changed, reward, is_done }
    }

    fn watched<'a>(&self, worlds: &'a dyn Environment) -> Watched<'a> {
        Watched { episode: self.episode, worlds, instance: self.instance }
    }

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
        fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<()> {
            self.0 += scenes.scenes.iter().filter(|scene| scene.begins).count();
            actions.fill(1);
            Ok(())
        }
    }

    /// Goes wherever its instance's generator says.
    struct Wanders;

    impl Act for Wanders {
        fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>) -> Result<()> {
            let actions = actions.chunks_exact_mut(actions.len() / scenes.scenes.len());
            for (random, actions) in scenes.generators(random).zip(actions) {
                actions.fill_with(|| sortie_envs::random::below(random, 3) as u16);
            }
            Ok(())
        }
    }

    /// One after the other in one instance, side by side, or the last of them alone.
    #[test]
    fn an_episode_is_the_same_whatever_is_played_beside_and_before_it() {
        let ring = sortie_envs::open("group-matching/4x3x2", Split::Test, 1, &Default::default());
        let ring = ring.unwrap();
        let play = |instances: usize, episodes: Range<usize>| {
            let mut worlds = ring.open(instances, Split::Test);
            watch(&mut *worlds, &mut Wanders, episodes, 1, &mut ()).unwrap()
        };
        let apart = play(1, 0..6);
        assert_eq!(play(4, 0..6), apart);
        assert_eq!(play(2, 3..6), apart[3..]);
    }

    #[test]
    fn an_episode_begins_once() {
        let ring = sortie_envs::open("group-matching/4x3x2", Split::Test, 1, &Default::default());
        let mut begins = Begins(0);
        let evaluation = evaluate(&*ring.unwrap(), &mut begins, 100, 1).unwrap();
        assert_eq!((begins.0, evaluation.episodes), (100, 100));
        assert!(evaluation.length_mean > 2.0, "{evaluation:?}");
    }
    /// Whatever starts the environment was opened for.
    #[test]
    fn a_team_is_measured_on_starts_that_training_never_sees() {
        let settings = [("held_out".to_owned(), 3_i64.into())].into();
        let ring = sortie_envs::open("group-matching/8x6x3", Split::Train, 1, &settings).unwrap();
        let measured = evaluate(&*ring, &mut Begins(0), 40, 1).unwrap();
        let has_three = |group: &String| group.split('+').any(|size| size == "3");
        assert!(measured.by_team.len() > 3 && measured.by_team.keys().all(has_three));
    }
}
