//! Agents and allocators that act and learn nothing, for tests.

use sortie_envs::{ActionSet, Environment, Observation, Split};
use sortie_learn::play::{Play, RandomTeam};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{EpisodeCounts, Rates};
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};
use sortie_nn::random::Generator as Random;

use super::config::Config;
use super::history::Returns;
use super::observer::Observer;
use super::replay::Replay;
use super::rollout::{Behaviour, Memory, Rollout};
use super::team_value::Segments;
use crate::alma::ALMA;
use crate::alma::agents::UtilityNetwork;

/// Agents and an allocator that learn nothing; the allocator decides from a step on.
pub(super) struct Fixed {
    pub(super) rollout: Rollout,
    pub(super) agents: UtilityNetwork,
    pub(super) epsilon: f32,
    pub(super) allocator: UtilityNetwork,
    pub(super) decides_from: u64,
    pub(super) records: Replay,
    pub(super) segments: Option<Segments>,
    pub(super) decisions: u64,
    /// The actions that were available to whoever acted, and what was done, by instance.
    pub(super) acted: Vec<(usize, ActionSet, u16)>,
}

impl Method for Fixed {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        self.rollout.begin(instance, random);
    }

    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let allocator = (now.env_steps >= self.decides_from).then_some(&self.allocator);
        let behaviour = Behaviour { agents: &self.agents, epsilon: self.epsilon, allocator };
        let memory = Memory { records: &mut self.records, segments: self.segments.as_mut() };
        self.decisions += self.rollout.act(scenes, random, behaviour, memory, actions)?;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let mut seen = Observation::default();
        transition.environment.observe(transition.state, 0, 0, &mut seen);
        let acted = seen.available[..seen.agents()].iter().zip(transition.actions);
        let instance = transition.instance;
        self.acted.extend(acted.map(|(available, action)| (instance, *available, *action)));
        let memory = Memory { records: &mut self.records, segments: self.segments.as_mut() };
        self.rollout.remember(transition, memory);
        Ok(())
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: self.epsilon, learning_rate: 0.0 }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(RandomTeam::new(1))
    }

    fn state(&mut self, _: &mut State<'_>) -> Result<(), LearnError> {
        Ok(())
    }
}

/// The preset `fast`.
pub(super) fn usual() -> Config {
    Config::of(&ALMA.preset("fast").unwrap()).unwrap()
}

/// Where a run learns.
fn city(config: &Config) -> Box<dyn Environment> {
    let settings = &config.environment.settings;
    sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, settings).unwrap()
}

/// Greedy agents with the first weights of seed 1, with room for records, and for so many segments.
pub(super) fn fixed(config: &Config, segments: usize) -> Fixed {
    let network =
        |shape| UtilityNetwork::initialise(shape, 8.0, &mut generator(1, Purpose::Weights, 0));
    let environment = city(config);
    let spec = environment.spec();
    let lag = Returns::from(&config.returns).lag(config.environment.instances);
    Fixed {
        rollout: Rollout::new(config, spec),
        agents: network(config.network.shape(spec)),
        epsilon: 0.0,
        allocator: network(config.allocator.shape(spec)),
        decides_from: 0,
        records: Replay::new(10_000, lag, spec),
        segments: Some(Segments::new(segments)),
        decisions: 0,
        acted: Vec::new(),
    }
}

/// Starts an episode in every instance.
pub(super) fn begin(config: &Config, seed: u64, method: &mut Fixed) -> Play {
    let city = city(config);
    let stream = |index| generator(seed, Purpose::Rollout, index as u64);
    let random = (0..config.environment.instances).map(stream).collect();
    Play::new(&*city, method, random)
}

/// Steps all instances so many times; what ended, and how often it was decided.
pub(super) fn play(play: &mut Play, method: &mut Fixed, steps: u64) -> (EpisodeCounts, u64) {
    let (mut counts, before) = (EpisodeCounts::default(), method.decisions);
    for env_steps in 0..steps {
        play.round(method, Now { env_steps, of: steps }, &mut counts).unwrap();
    }
    (counts, method.decisions - before)
}

/// What observes the states of a run.
pub(super) fn observer(config: &Config) -> Observer {
    Observer::of(&*city(config))
}
