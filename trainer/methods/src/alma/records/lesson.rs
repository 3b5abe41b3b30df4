//! The loss of the low level: value decomposition per subtask, on samples of single states.
//!
//! A mixer makes the value of a team from the utilities of its agents' actions; the simplest is their sum
//! (dissertation section 7.3). Target: `reward + discount * mixed target utilities`, each of the action
//! that the online network likes best among the available ones (double Q-learning), with the team of the
//! sample's own step. Loss: squared difference.
//!
//! Where subtasks are marked in the input, the marks of each sample are exchanged at random, so that no
//! subtask is special by its number.

use rand_core::SeedableRng;
use sortie_envs::random::shuffle;
use sortie_envs::{ActionSet, EntitySet, Environment, Observation, Random, Spec, members};
use sortie_learn::learner::{Loss, Shard};
use sortie_learn::networks::{Hypernetworks, LookShape, Mixer, MixerShape, WeightsSum, best};
use sortie_learn::trajectory::Place;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Parameters, Pass, Var};

use super::config::Config;
use super::replay::{Moment, Replay, Sample};
use crate::alma::agents::{
    Columns, Conditioning, NO_ACTION, TeamBatch, UtilityLayers, UtilityShape,
};

/// Samples of a shard: few enough for their activations to stay in cache.
pub(super) const SAMPLES: usize = 128;

/// A sample to learn from, and how it is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Its state and its subtask.
    pub sample: (Place, u8),
    /// Number of the environment's symmetry; 0 changes nothing.
    pub turn: usize,
    /// Exchanges the marks of subtasks; 0 leaves each its own.
    pub marks: u64,
}

/// The networks of the agents' level.
#[derive(Clone, Debug)]
pub struct Networks {
    /// The sizes of the agents' network, whose parameters come first.
    pub shape: UtilityShape,
    conditioning: Conditioning,
    reward_factor: f32,
    agents: UtilityLayers,
    mixer: Mixer,
}

/// What samples are read from.
#[derive(Clone, Copy)]
pub struct Experience<'a> {
    /// What observes the states.
    pub environment: &'a dyn Environment,
    /// The states.
    pub replay: &'a Replay,
}

/// Samples that are learned from together, and the memory for it.
#[derive(Debug, Default)]
pub struct Lesson {
    now: Side,
    next: Side,
    rewards: Vec<f32>,
    discounts: Vec<f32>,
    /// Available actions of each agent of `next`.
    available: Vec<ActionSet>,
    targets: Vec<f32>,
    /// The subtask that each subtask of a sample is marked as.
    marks: Vec<u8>,
    seen: Observation,
    /// Floating-point operations of the last use.
    pub operations: u64,
}

/// One of the two states of the samples: the rows of the teams, and what is done there.
#[derive(Debug, Default)]
struct Side {
    batch: TeamBatch,
    /// Each agent's action: the one taken, or the best of the next state.
    actions: Vec<u32>,
}

impl Networks {
    /// Draws all weights, the agents' first.
    pub fn new(config: &Config, spec: &Spec, random: &mut Random) -> (Self, Parameters) {
        let (shape, active) = (config.network.shape(spec), config.network.active_inputs);
        let mut parameters = Parameters::default();
        shape.draw(&mut parameters, active, random);
        let mixer = Mixer::new(&mut parameters, config.mixer_shape(spec), random);
        let networks = Self {
            shape,
            conditioning: config.network.subtask,
            reward_factor: config.mixer.reward_factor(),
            agents: UtilityLayers::of(shape),
            mixer,
        };
        (networks, parameters)
    }

    /// The part that some samples have in the mean loss over so many.
    pub fn loss(
        &self,
        shard: &mut Shard<'_, Lesson>,
        experience: Experience<'_>,
        drawn: &[Drawn],
        samples: usize,
    ) -> Loss {
        shard.space.gather(self, experience, drawn);
        self.find_targets(shard);
        let Shard { pass, space: lesson, .. } = shard;
        let Lesson { now, targets, operations, .. } = &mut **lesson;
        let utilities = self.agents.utilities(pass, now.batch.input());
        let values = self.values(pass, utilities, now);
        let loss = Loss::mean_square(pass, values, targets, samples);
        *operations += pass.operations(true);
        loss
    }

    /// The values of teams by the utilities of what they do.
    fn values(&self, pass: &mut Pass<'_>, utilities: Var, side: &Side) -> Var {
        let chosen = pass.pick(utilities, &side.actions);
        self.mixer.mix(pass, side.batch.teams(), chosen).real
    }

    fn find_targets(&self, shard: &mut Shard<'_, Lesson>) {
        let Shard { spare, online, target, space: lesson, .. } = shard;
        let Lesson { next, rewards, discounts, available, targets, operations, .. } = &mut **lesson;
        targets.clone_from(rewards);
        *operations = 0;
        if available.is_empty() {
            return;
        }
        let mut pass = spare.begin_forward(online);
        let utilities = self.agents.utilities(&mut pass, next.batch.input());
        let agents = pass.values(utilities).chunks_exact(self.shape.actions).zip(available);
        next.actions.clear();
        next.actions.extend(agents.map(|(utilities, open)| best(utilities, *open) as u32));
        *operations += pass.operations(false);
        let mut pass = spare.begin_forward(target);
        let utilities = self.agents.utilities(&mut pass, next.batch.input());
        let values = self.values(&mut pass, utilities, next);
        let goes_on = targets.iter_mut().zip(discounts).filter(|(_, discount)| **discount > 0.0);
        for ((target, discount), value) in goes_on.zip(pass.values(values)) {
            *target += *discount * value;
        }
        *operations += pass.operations(false);
    }
}

impl Lesson {
    /// Rebuilds what the teams of samples saw, turned as they were drawn.
    fn gather(&mut self, networks: &Networks, experience: Experience<'_>, drawn: &[Drawn]) {
        let Experience { environment, replay } = experience;
        let columns = Columns::of(&environment.spec().shape, networks.shape.targets);
        self.now.clear(networks.conditioning, columns);
        self.next.clear(networks.conditioning, columns);
        self.available.clear();
        self.rewards.clear();
        self.discounts.clear();
        replay.fetch(drawn.iter().map(|drawn| drawn.sample));
        for drawn in drawn {
            exchange(&mut self.marks, networks.shape.input - columns.unmarked(), drawn.marks);
            let sample = replay.sample(drawn.sample);
            self.push(networks, environment, (sample, drawn.turn));
        }
        self.now.batch.finish();
        self.next.batch.finish();
    }

    /// Adds a team in both of its states, with what it sees there.
    fn push(
        &mut self,
        networks: &Networks,
        environment: &dyn Environment,
        (sample, turn): (Sample<'_>, usize),
    ) {
        let Self { now, next, marks, seen, .. } = self;
        let (team, allocation) = (sample.now.team(sample.task), sample.now.allocation);
        let own = EntitySet::from(team);
        let sight = match networks.conditioning {
            Conditioning::Mask => own | sample.things,
            Conditioning::Input | Conditioning::None => EntitySet::MAX,
        };
        let push = |side: &mut Side, moment: Moment<'_>, seen: &Observation| {
            let last_action = |agent: usize| match moment.last_actions[agent] {
                NO_ACTION => NO_ACTION,
                action => environment.turned_action(turn, action.into()) as u8,
            };
            let task = |entity: usize| {
                let agents = allocation.get(entity).copied();
                let task = agents.unwrap_or_else(|| seen.task_of(entity));
                marks.get(usize::from(task)).copied().unwrap_or(task)
            };
            side.batch.push_team(seen, (team, sight), last_action, task);
        };
        environment.observe(sample.now.state, turn, sight, seen);
        push(now, sample.now, seen);
        let taken =
            |agent: usize| environment.turned_action(turn, sample.now.actions[agent].into());
        now.actions.extend(members(own).map(|agent| u32::from(taken(agent))));
        self.rewards.push(networks.reward_factor * sample.reward);
        self.discounts.push(sample.discount);
        if sample.discount > 0.0 {
            environment.observe(sample.next.state, turn, sight, seen);
            push(next, sample.next, seen);
            self.available.extend(members(own).map(|agent| seen.available[agent]));
        }
    }
}

/// Draws which mark each of so many subtasks gets; a draw of 0 leaves each its own.
fn exchange(marks: &mut Vec<u8>, tasks: usize, draw: u64) {
    marks.clear();
    marks.extend(0..tasks as u8);
    if draw != 0 {
        shuffle(&mut Generator::seed_from_u64(draw), marks);
    }
}

impl Side {
    fn clear(&mut self, conditioning: Conditioning, columns: Columns) {
        self.batch.clear(conditioning, columns);
        self.actions.clear();
    }
}

impl Config {
    /// The mixer's sizes: its hypernetwork sees what the agents see.
    fn mixer_shape(&self, spec: &Spec) -> MixerShape {
        let input = self.network.shape(spec).input;
        let active_inputs = self.network.active_inputs.max(1.0) as usize;
        let looking =
            LookShape { input, active_inputs, width: self.mixer.width, heads: self.mixer.heads };
        MixerShape {
            kind: self.mixer.kind,
            hypernetworks: Hypernetworks::Shared,
            weights_sum: WeightsSum::One,
            looking,
            mixing: self.mixer.mixing,
        }
    }
}

#[cfg(test)]
mod tests;
