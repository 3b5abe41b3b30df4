//! Greedy episodes, and what they come to.

use std::collections::BTreeMap;

use sortie_envs::{Environment, Episode, Random, Split};

use crate::error::LearnError;
use crate::evaluate::{Evaluation, TeamSuccess, wilson_interval};
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
    Ok(summary(worlds.spec().metrics.iter().map(|metric| metric.name), &done))
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

fn summary(metrics: impl Iterator<Item = &'static str>, episodes: &[Episode]) -> Evaluation {
    let count = episodes.len();
    let mean = |value: &dyn Fn(&Episode) -> f64| {
        episodes.iter().map(value).sum::<f64>() / count.max(1) as f64
    };
    let share =
        |holds: &dyn Fn(&Episode) -> bool| mean(&|episode| f64::from(u8::from(holds(episode))));
    let return_mean = mean(&|episode| episode.episode_return);
    let spread: f64 = episodes.iter().map(|e| (e.episode_return - return_mean).powi(2)).sum();
    let mut by_team = BTreeMap::<String, TeamSuccess>::new();
    for episode in episodes {
        let entry = by_team.entry(episode.group.clone()).or_default();
        entry.episodes += 1;
        entry.solved += usize::from(episode.solved);
    }
    let metric = |(index, name): (usize, &str)| {
        let values = episodes.iter().filter_map(|e| e.metrics.get(index).copied().flatten());
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (!values.is_empty()).then(|| (name.to_owned(), mean))
    };
    Evaluation {
        episodes: count,
        success: share(&|episode| episode.solved),
        success_ci95: wilson_interval(by_team.values().map(|team| team.solved).sum(), count),
        return_mean,
        return_sd: (spread / count.saturating_sub(1).max(1) as f64).sqrt(),
        length_mean: mean(&|episode| f64::from(episode.steps)),
        timeouts: share(&|episode| episode.timed_out),
        metrics: metrics.enumerate().filter_map(metric).collect(),
        failures: BTreeMap::new(),
        by_team,
    }
}
