//! Whole episodes, stored as states from which everything else is rebuilt.

use serde::{Deserialize, Serialize};

use crate::saved_states::SavedStates;

/// One episode: every state with what was decided in it, and the final state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Environment steps of the run when it began.
    pub added: u64,
    agents: usize,
    tasks: usize,
    states: SavedStates,
    /// `[states, A]`: the allocation in force.
    allocation: Vec<u8>,
    /// `[states, A]`; what stands at the final state is never used.
    actions: Vec<u8>,
    /// `[states]`: whether agents were allocated anew.
    decision: Vec<bool>,
    /// `[steps]`
    reward: Vec<f32>,
    /// `[steps, T]`
    task_reward: Vec<f32>,
    /// The last step came to the episode's own end, not to its time limit.
    pub terminated: bool,
}

/// A state with what was decided in it.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Its bytes.
    pub state: &'a [u8],
    /// `[A]`: the subtask of every agent.
    pub allocation: &'a [u8],
    /// Whether that was decided in this state.
    pub decision: bool,
    /// `[A]`: what the agents do.
    pub actions: &'a [u16],
}

impl Episode {
    /// Begins an episode of at most so many agents and subtasks, `added` environment steps into the run.
    pub fn begin(agents: usize, tasks: usize, added: u64) -> Self {
        Self { agents, tasks, added, ..Self::default() }
    }

    /// Adds a state.
    pub fn push_state(&mut self, moment: Moment<'_>) {
        self.states.push(moment.state);
        self.allocation.extend_from_slice(&moment.allocation[..self.agents]);
        let actions = &moment.actions[..self.agents];
        self.actions.extend(actions.iter().map(|action| *action as u8));
        self.decision.push(moment.decision);
    }

    /// Adds what the step from the last state earned: for the team, and for every subtask that has a reward.
    pub fn push_rewards(&mut self, team: f64, tasks: &[f64]) {
        self.reward.push(team as f32);
        self.task_reward.extend(tasks.iter().map(|reward| *reward as f32));
        self.task_reward.resize(self.reward.len() * self.tasks, 0.0);
    }

    /// Adds the final state, and keeps no memory for more.
    pub fn end(&mut self, last: Moment<'_>, terminated: bool) {
        self.push_state(last);
        self.terminated = terminated;
        self.states.shrink_to_fit();
        self.allocation.shrink_to_fit();
        self.actions.shrink_to_fit();
        self.decision.shrink_to_fit();
        self.reward.shrink_to_fit();
        self.task_reward.shrink_to_fit();
    }

    /// States, the final one included.
    pub fn states(&self) -> usize {
        self.states.len()
    }

    /// Steps taken.
    pub fn steps(&self) -> usize {
        self.reward.len()
    }

    /// The bytes of a state.
    pub fn state(&self, state: usize) -> &[u8] {
        self.states.at(state)
    }

    /// The allocation `[A]` in force in a state.
    pub fn allocation(&self, state: usize) -> &[u8] {
        &self.allocation[state * self.agents..][..self.agents]
    }

    /// The actions `[A]` taken in a state.
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

    /// The rewards `[T]` of all subtasks in a step.
    pub fn task_reward(&self, step: usize) -> &[f32] {
        &self.task_reward[step * self.tasks..][..self.tasks]
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
