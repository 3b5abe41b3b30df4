//! The loss of the low level: value decomposition per subtask, on records.
//!
//! A mixer makes the value of a team from the utilities of its agents' actions; the simplest is their sum
//! (dissertation section 7.3). Target: `reward + discount * mixed target utilities`, each of the action
//! that the online network likes best among the available ones (double Q-learning), with the team of the
//! record's own step. Loss: squared difference.
//!
//! Where subtasks are marked in the input, the marks of each record are exchanged at random, so that no
//! subtask is special by its number.

#[cfg(test)]
mod tests;

use rand_core::SeedableRng;
use sortie_envs::random::below;
use sortie_envs::{ActionSet, AgentSet, EntitySet, Environment, Observation, members};
use sortie_nn::random::Generator;

use super::learner::{Experience, Loss, MixedNetwork, Networks, Pick};
use super::mixer::{MixerPass, Teams};
use super::replay::{Moment, Replay, Sample};
use crate::alma::agents::{
    Columns, Conditioning, NO_ACTION, TeamBatch, UtilityNetwork, UtilityPass, UtilityShape,
    best_action,
};

/// Space to compute the gradient of some records, and the result.
#[derive(Clone, Debug)]
pub struct Chunk {
    shape: UtilityShape,
    conditioning: Conditioning,
    reward_factor: f32,
    now: Side,
    next: Side,
    pass: UtilityPass,
    mixing: MixerPass,
    /// Available actions of each agent of `next`.
    next_available: Vec<ActionSet>,
    /// Reward, then target, and discount of each record.
    rewards: Vec<(f32, f32)>,
    /// The subtask that each subtask of a record is marked as.
    marks: Vec<u8>,
    d_values: Vec<f32>,
    d_chosen: Vec<f32>,
    d_utilities: Vec<f32>,
    gradient: Vec<f32>,
    squared_error: f64,
}

impl Chunk {
    /// Empty space for networks of the shapes of this one; rewards are multiplied by a factor.
    pub fn new(network: &MixedNetwork, conditioning: Conditioning, reward_factor: f32) -> Self {
        let shape = network.utility.shape();
        Self {
            shape,
            conditioning,
            reward_factor,
            now: Side::new(conditioning),
            next: Side::new(conditioning),
            pass: UtilityPass::new(shape),
            mixing: MixerPass::default(),
            next_available: Vec::new(),
            rewards: Vec::new(),
            marks: Vec::new(),
            d_values: Vec::new(),
            d_chosen: Vec::new(),
            d_utilities: Vec::new(),
            gradient: vec![0.0; shape.parameters() + network.mixer.shape().parameters()],
            squared_error: 0.0,
        }
    }

    /// Floating-point operations of the utility networks up to now, see [`UtilityPass::operations`].
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Rebuilds the features of the records, turned as they were picked.
    fn gather(&mut self, experience: Experience<'_, Replay>, picks: &[Pick]) {
        let Experience { environment, replay } = experience;
        let columns = Columns::of(&environment.spec().shape);
        self.now.clear(columns);
        self.next.clear(columns);
        self.next_available.clear();
        self.rewards.clear();
        replay.fetch(picks.iter().map(|pick| pick.sample as usize));
        for pick in picks {
            exchange(&mut self.marks, self.shape.input - columns.unmarked(), pick.draw);
            self.push(environment, replay.get(pick.sample as usize), pick.symmetry.into());
        }
        self.now.batch.finish();
        self.next.batch.finish();
    }

    /// Adds what the team of a record sees.
    fn push(&mut self, environment: &dyn Environment, sample: Sample<'_>, turn: usize) {
        let Self { now, next, marks, .. } = self;
        let (record, team) = (sample.record, sample.team());
        let sight = match self.conditioning {
            Conditioning::Mask => EntitySet::from(team) | record.things(),
            Conditioning::Input | Conditioning::None => EntitySet::MAX,
        };
        let allocation = sample.now.allocation;
        let look = Look { environment, turn, team, sight, allocation, marks };
        now.push(sample.now, look);
        let taken = members(team.into()).map(|agent| look.turned(sample.now.actions[agent]));
        now.actions.extend(taken);
        self.rewards.push((self.reward_factor * record.reward, record.discount));
        if record.discount > 0.0 {
            next.push(sample.next, look);
            let available = members(team.into()).map(|agent| next.seen.available[agent]);
            self.next_available.extend(available);
        }
    }

    fn choose_next(&mut self, online: &UtilityNetwork) {
        let utilities = self.pass.forward(online, self.next.batch.input());
        let agents = utilities.chunks_exact(self.shape.actions).zip(&self.next_available);
        self.next.actions.clear();
        self.next
            .actions
            .extend(agents.map(|(utilities, available)| best_action(utilities, *available)));
    }

    fn descend(&mut self, networks: Networks<'_, MixedNetwork>) {
        let values = self.next.values(networks.target, &mut self.pass, &mut self.mixing);
        let bootstrapped = self.rewards.iter_mut().filter(|(_, discount)| *discount > 0.0);
        for ((target, discount), value) in bootstrapped.zip(values) {
            *target += *discount * value;
        }

        let online = networks.online;
        let values = self.now.values(online, &mut self.pass, &mut self.mixing);
        self.squared_error = 0.0;
        self.d_values.clear();
        for (value, (target, _)) in values.iter().zip(&self.rewards) {
            let error = value - target;
            self.squared_error += f64::from(error) * f64::from(error);
            self.d_values.push(2.0 * error);
        }

        self.gradient.fill(0.0);
        let (to_utility, to_mixer) = self.gradient.split_at_mut(self.shape.parameters());
        self.d_chosen.clear();
        self.d_chosen.resize(self.now.chosen.len(), 0.0);
        let (d_values, d_chosen) = (&self.d_values, &mut self.d_chosen);
        self.mixing.backward(&online.mixer, self.now.teams(), d_values, d_chosen, to_mixer);

        let actions = self.shape.actions;
        self.d_utilities.clear();
        self.d_utilities.resize(self.d_chosen.len() * actions, 0.0);
        let agents = self.d_utilities.chunks_exact_mut(actions).zip(&self.now.actions);
        for ((slopes, action), slope) in agents.zip(&self.d_chosen) {
            slopes[usize::from(*action)] = *slope;
        }
        let input = self.now.batch.input();
        self.pass.backward(&online.utility, input, &self.d_utilities, to_utility);
    }
}

/// Draws which mark each of so many subtasks gets; a draw of 0 leaves each its own.
fn exchange(marks: &mut Vec<u8>, tasks: usize, draw: u64) {
    marks.clear();
    marks.extend(0..tasks as u8);
    if draw != 0 && tasks > 1 {
        let mut generator = Generator::seed_from_u64(draw);
        for last in (1..tasks).rev() {
            marks.swap(last, below(&mut generator, last + 1));
        }
    }
}

impl Loss for Chunk {
    type Network = MixedNetwork;
    type Replay = Replay;
    const CHUNK: usize = 128;

    fn learn(
        &mut self,
        networks: Networks<'_, MixedNetwork>,
        experience: Experience<'_, Replay>,
        picks: &[Pick],
    ) {
        self.gather(experience, picks);
        self.choose_next(&networks.online.utility);
        self.descend(networks);
    }

    fn squared_error(&self) -> f64 {
        self.squared_error
    }

    fn terms(&self) -> usize {
        self.rewards.len()
    }

    fn gradient(&self) -> &[f32] {
        &self.gradient
    }
}

/// One of the two states of the records: the rows, and what is known of the teams.
#[derive(Clone, Debug)]
pub(super) struct Side {
    pub(super) batch: TeamBatch,
    /// Number of agents of each team.
    pub(super) sizes: Vec<usize>,
    /// Each agent's action: the one taken, or the best of the next state.
    pub(super) actions: Vec<u8>,
    /// Utility of each agent's action.
    pub(super) chosen: Vec<f32>,
    pub(super) seen: Observation,
}

/// How a sample is looked at.
#[derive(Clone, Copy)]
pub(super) struct Look<'a> {
    pub(super) environment: &'a dyn Environment,
    /// Number of the symmetry under which it is seen.
    pub(super) turn: usize,
    /// The agents that earned the reward.
    pub(super) team: AgentSet,
    /// The entities that they see.
    pub(super) sight: EntitySet,
    /// `[A]`: the subtask that each agent has in both states.
    pub(super) allocation: &'a [u8],
    /// The subtask that each subtask is marked as.
    pub(super) marks: &'a [u8],
}

impl Look<'_> {
    fn mark(&self, task: u8) -> u8 {
        self.marks.get(usize::from(task)).copied().unwrap_or(task)
    }

    pub(super) fn turned(&self, action: u8) -> u8 {
        if action == NO_ACTION {
            NO_ACTION
        } else {
            self.environment.turned_action(self.turn, action.into()) as u8
        }
    }
}

impl Side {
    pub(super) fn new(conditioning: Conditioning) -> Self {
        let batch = TeamBatch::new(conditioning);
        let seen = Observation::default();
        Self { batch, sizes: Vec::new(), actions: Vec::new(), chosen: Vec::new(), seen }
    }

    pub(super) fn clear(&mut self, columns: Columns) {
        self.batch.clear(columns);
        self.sizes.clear();
        self.actions.clear();
    }

    /// Adds a team with what it sees in a state.
    pub(super) fn push(&mut self, moment: Moment<'_>, look: Look<'_>) {
        let Self { batch, sizes, seen, .. } = self;
        look.environment.observe(moment.state, look.turn, look.sight, seen);
        let is_member = |agent: usize| look.team >> agent & 1 == 1;
        let agents = members(seen.entities & !seen.things()).enumerate();
        let (last_action, task) = (
            |agent: usize| look.turned(moment.last_actions[agent]),
            |agent: usize| look.mark(look.allocation[agent]),
        );
        for (row, agent) in agents.clone().filter(|(_, agent)| is_member(*agent)) {
            batch.push_agent(&seen.rows, row, last_action(agent), task(agent));
        }
        for (row, agent) in agents.clone().filter(|(_, agent)| !is_member(*agent)) {
            batch.push_other(&seen.rows, row, last_action(agent), task(agent));
        }
        let first = agents.count();
        for (place, thing) in members(seen.entities & seen.things()).enumerate() {
            batch.push_thing(&seen.rows, first + place, look.mark(seen.task_of(thing)));
        }
        batch.end_team();
        sizes.push(look.team.count_ones() as usize);
    }

    /// Computes the value of every team.
    pub(super) fn values<'a>(
        &mut self,
        network: &MixedNetwork,
        pass: &mut UtilityPass,
        mixing: &'a mut MixerPass,
    ) -> &'a [f32] {
        let utilities = pass.forward(&network.utility, self.batch.input());
        let agents = utilities.chunks_exact(network.utility.shape().actions).zip(&self.actions);
        self.chosen.clear();
        self.chosen.extend(agents.map(|(utilities, action)| utilities[usize::from(*action)]));
        mixing.forward(&network.mixer, self.teams())
    }

    pub(super) fn teams(&self) -> Teams<'_> {
        Teams { input: self.batch.input(), sizes: &self.sizes, utilities: &self.chosen }
    }
}
