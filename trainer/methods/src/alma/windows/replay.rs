//! Whole episodes, stored as compact states from which everything else is rebuilt.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{AgentState, BuildingState, City};

/// One episode: every state with what was decided in it, and the final state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Agents of this episode.
    pub agents: usize,
    /// Buildings, each a subtask.
    pub buildings: usize,
    /// Environment steps of the run when it began.
    pub added: u64,
    /// `[states, agents]`
    agent_states: Vec<AgentState>,
    /// `[states, buildings]`
    building_states: Vec<BuildingState>,
    /// `[states, agents]`: the allocation in force.
    allocation: Vec<u8>,
    /// `[states, agents]`; what stands at the final state is never used.
    actions: Vec<u8>,
    /// `[states]`: whether agents were allocated anew.
    decision: Vec<bool>,
    /// `[steps]`
    reward: Vec<f32>,
    /// `[steps, buildings]`
    task_reward: Vec<f32>,
    /// The last step came to the episode's own end, not to its time limit.
    pub terminated: bool,
}

/// A state with what was decided in it.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Agents and buildings.
    pub city: City<'a>,
    /// The building of every agent.
    pub allocation: &'a [u8],
    /// Whether that was decided in this state.
    pub decision: bool,
    /// What the agents do.
    pub actions: &'a [u16],
}

impl Episode {
    /// Begins an episode in place of whatever was stored here.
    pub fn begin(&mut self, city: City<'_>, added: u64) {
        *self = Self {
            agents: city.agents.len(),
            buildings: city.buildings.len(),
            added,
            ..Self::default()
        };
    }

    /// Adds a state.
    pub fn push_state(&mut self, moment: Moment<'_>) {
        let agents = self.agents;
        self.agent_states.extend_from_slice(moment.city.agents);
        self.building_states.extend_from_slice(moment.city.buildings);
        self.allocation.extend_from_slice(&moment.allocation[..agents]);
        self.actions.extend(moment.actions[..agents].iter().map(|action| *action as u8));
        self.decision.push(moment.decision);
    }

    /// Adds what the step from the last state earned: for the team, and for every subtask.
    pub fn push_rewards(&mut self, team: f64, tasks: &[f64]) {
        self.reward.push(team as f32);
        self.task_reward.extend(tasks[..self.buildings].iter().map(|reward| *reward as f32));
    }

    /// States, the final one included.
    pub fn states(&self) -> usize {
        self.decision.len()
    }

    /// Steps taken.
    pub fn steps(&self) -> usize {
        self.reward.len()
    }

    /// Agents and buildings in a state.
    pub fn city(&self, state: usize) -> City<'_> {
        City {
            agents: &self.agent_states[state * self.agents..][..self.agents],
            buildings: &self.building_states[state * self.buildings..][..self.buildings],
        }
    }

    /// The allocation `[agents]` in force in a state.
    pub fn allocation(&self, state: usize) -> &[u8] {
        &self.allocation[state * self.agents..][..self.agents]
    }

    /// The actions `[agents]` taken in a state.
    pub fn actions(&self, state: usize) -> &[u8] {
        &self.actions[state * self.agents..][..self.agents]
    }

    /// Whether agents were allocated anew in a state.
    pub fn decision(&self, state: usize) -> bool {
        self.decision[state]
    }

    /// The team's reward of a step.
    pub fn reward(&self, step: usize) -> f32 {
        self.reward[step]
    }

    /// The reward of every subtask in a step.
    pub fn task_reward(&self, step: usize) -> &[f32] {
        &self.task_reward[step * self.buildings..][..self.buildings]
    }
}

/// The newest episodes of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    capacity: usize,
    episodes: Vec<Episode>,
    /// Where the next episode goes once all places are taken.
    next: usize,
}

impl Replay {
    /// An empty replay with room for so many episodes.
    pub fn new(capacity: usize) -> Self {
        Self { capacity, episodes: Vec::new(), next: 0 }
    }

    /// Adds an episode, in place of the oldest where there is no room.
    pub fn push(&mut self, episode: Episode) {
        if self.episodes.len() < self.capacity {
            self.episodes.push(episode);
        } else {
            self.episodes[self.next] = episode;
            self.next = (self.next + 1) % self.capacity;
        }
    }

    /// All episodes, in no particular order.
    pub fn episodes(&self) -> &[Episode] {
        &self.episodes
    }

    /// Number of episodes.
    pub fn len(&self) -> usize {
        self.episodes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_episode_makes_room() {
        let mut replay = Replay::new(3);
        for added in 0..8 {
            replay.push(Episode { added, ..Episode::default() });
        }
        let mut kept: Vec<u64> = replay.episodes().iter().map(|episode| episode.added).collect();
        kept.sort_unstable();
        assert_eq!(kept, [5, 6, 7]);
    }
}
