//! A run: episodes are played, remembered and learned from.

use sortie_envs::{EntitySet, Environment, Observation, Random, Split};
use sortie_nn::random::stream;
use sortie_nn::schedule::linear;

use super::acting::Acting;
use super::config::Config;
use super::learner::Learner;
use super::replay::{End, Replay};
use super::temporal_difference::{Losses, Network};

/// The generators of a run: first weights, records, roll-out.
const STREAMS: [u64; 3] = [1, 2, 3];

/// How far a run is.
#[derive(Debug)]
pub struct Progress<'a> {
    /// Environment steps taken.
    pub steps: u64,
    /// Updates made.
    pub updates: u64,
    /// The losses of the last update.
    pub losses: Losses,
    /// The network to evaluate.
    pub network: &'a Network,
}

/// Trains for so many environment steps and tells `onlooker` after every round of all instances.
///
/// Learning begins when every instance has played long enough for its records to have a future.
pub fn train(
    environment: &dyn Environment,
    config: &Config,
    steps: u64,
    seed: u64,
    mut onlooker: impl FnMut(Progress<'_>),
) -> Network {
    let [mut weights, mut records, mut chances] = STREAMS.map(|number| stream(seed, number, 0));
    let network = Network::initialise(config.shape(environment.spec()), &mut weights);
    let mut learner = Learner::new(config.clone(), network);
    let mut play = Play::new(environment, config.instances, &mut chances);
    let spec = environment.spec();
    let capacity = config.capacity / config.instances;
    let agents = spec.shape.agents;
    let mut replay = Replay::new(config.instances, capacity, agents, spec.state_bytes);
    let (mut taken, mut updates, mut losses) = (0, 0, Losses::default());
    let first = (4 * config.steps * config.instances).max(config.batch) as u64;
    while taken < steps {
        let [start, end] = config.exploration;
        let chance = linear(start, end, config.exploration_steps, taken);
        let spread = config.exploration_spread.iter().cycle();
        let spread = spread.map(|factor| (chance * factor).min(1.0));
        play.round(learner.online(), spread, &mut chances, &mut replay);
        taken += config.instances as u64;
        let due = taken.saturating_sub(first) / config.steps_per_update;
        while updates < due {
            updates += 1;
            let progress = taken as f32 / steps as f32;
            losses = learner.update(&replay, environment, progress, &mut records);
        }
        onlooker(Progress { steps: taken, updates, losses, network: learner.average() });
    }
    learner.average().clone()
}

/// Instances that are played at once, each started anew when it is done.
struct Play {
    worlds: Box<dyn Environment>,
    acting: Acting,
    seen: Observation,
    actions: Vec<u16>,
    states: Vec<Vec<u8>>,
}

impl Play {
    fn new(environment: &dyn Environment, instances: usize, random: &mut Random) -> Self {
        let mut worlds = environment.open(instances, Split::Train);
        (0..instances).for_each(|instance| worlds.reset(instance, random));
        Self {
            worlds,
            acting: Acting::default(),
            seen: Observation::default(),
            actions: Vec::new(),
            states: vec![Vec::new(); instances],
        }
    }

    /// Steps every instance once.
    fn round(
        &mut self,
        network: &Network,
        chances: impl Iterator<Item = f32>,
        random: &mut Random,
        replay: &mut Replay,
    ) {
        self.acting.clear();
        for (instance, state) in self.states.iter_mut().enumerate() {
            state.clear();
            self.worlds.save(instance, state);
            self.worlds.observe(state, 0, EntitySet::MAX, &mut self.seen);
            self.acting.push(&self.seen);
        }
        self.acting.act(network, chances, random, &mut self.actions);
        let agents = self.worlds.spec().shape.agents;
        let teams = self.states.iter_mut().zip(self.actions.chunks_exact(agents));
        for (instance, (state, actions)) in teams.enumerate() {
            let step = self.worlds.step(instance, actions, random);
            let step = step.expect("the actions were drawn from the available ones");
            let end = match (step.terminated, step.timed_out) {
                (true, _) => End::Over,
                (_, true) => End::TimedOut,
                _ => End::Open,
            };
            replay.push(instance, state, actions, step.reward as f32, end);
            if step.done() {
                state.clear();
                self.worlds.save(instance, state);
                replay.push_last(instance, state);
                self.worlds.reset(instance, random);
            }
        }
    }
}

/// What greedy episodes came to, on average.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Result {
    /// Share of the episodes that were solved.
    pub success: f64,
    /// Steps.
    pub length: f64,
    /// Sum of the team's rewards.
    pub episode_return: f64,
}

/// Plays so many episodes greedily.
pub fn evaluate(
    environment: &dyn Environment,
    network: &Network,
    episodes: usize,
    random: &mut Random,
) -> Result {
    const TEAMS: usize = 100;
    let mut result = Result::default();
    let (mut acting, mut seen) = (Acting::default(), Observation::default());
    let (mut state, mut actions) = (Vec::new(), Vec::new());
    let mut worlds = environment.open(TEAMS.min(episodes), Split::Test);
    let agents = worlds.spec().shape.agents;
    let mut left = episodes;
    while left > 0 {
        let teams = worlds.instances().min(left);
        (0..teams).for_each(|instance| worlds.reset(instance, random));
        let mut open: Vec<usize> = (0..teams).collect();
        while !open.is_empty() {
            acting.clear();
            for instance in &open {
                state.clear();
                worlds.save(*instance, &mut state);
                worlds.observe(&state, 0, EntitySet::MAX, &mut seen);
                acting.push(&seen);
            }
            acting.act(network, std::iter::repeat(0.0), random, &mut actions);
            for (instance, actions) in open.iter().zip(actions.chunks_exact(agents)) {
                let step = worlds.step(*instance, actions, random);
                step.expect("the actions were drawn from the available ones");
            }
            open.retain(|instance| !worlds.episode(*instance).done);
        }
        for episode in (0..teams).map(|instance| worlds.episode(instance)) {
            result.success += f64::from(u8::from(episode.solved)) / episodes as f64;
            result.length += f64::from(episode.steps) / episodes as f64;
            result.episode_return += episode.episode_return / episodes as f64;
        }
        left -= teams;
    }
    result
}
