//! What the teams of some records see, when they acted or in the states to bootstrap from.

use sortie_envs::{AgentSet, EntitySet, Environment, Observation, members};

use super::mixed_network::MixedNetwork;
use super::mixer::{MixerPass, Teams};
use super::moments::Moment;
use crate::alma::agents::{Columns, Conditioning, NO_ACTION, TeamBatch, UtilityPass};

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
