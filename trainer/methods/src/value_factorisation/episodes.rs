//! Experience in whole episodes, the latest of all instances.

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::below;

use super::replay::End;
use crate::saved_states::SavedStates;

/// Episodes of all instances, and what of the running ones there is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Episodes {
    agents: usize,
    capacity: usize,
    /// Episodes that have ended since the run began. Episode i stands at place `i % capacity`.
    finished: u64,
    kept: Vec<Episode>,
    running: Vec<Episode>,
}

/// One episode: a state more than things that were done.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Episode {
    states: SavedStates,
    actions: Vec<u16>,
    rewards: Vec<f32>,
    /// Whether it was over, and did not run out of time.
    is_over: bool,
}

/// What followed a state of an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ahead {
    /// The step that is looked at next.
    pub step: usize,
    /// The discounted rewards until there.
    pub reward: f32,
    /// What its value counts.
    pub discount: f32,
}

impl Episodes {
    /// Room for so many episodes.
    pub fn new(instances: usize, capacity: usize, agents: usize) -> Self {
        let running = vec![Episode::default(); instances];
        Self { agents, capacity, finished: 0, kept: Vec::new(), running }
    }

    /// Adds a state in which actions were taken, what came of them, and the state that followed.
    pub fn push(
        &mut self,
        instance: usize,
        (state, actions): (&[u8], &[u16]),
        (reward, end): (f32, End),
        next: &[u8],
    ) {
        let running = &mut self.running[instance];
        running.states.push(state);
        running.actions.extend_from_slice(actions);
        running.rewards.push(reward);
        if end == End::Open {
            return;
        }
        running.states.push(next);
        running.is_over = end == End::Over;
        let episode = std::mem::take(running);
        let place = (self.finished % self.capacity as u64) as usize;
        match self.kept.get_mut(place) {
            Some(old) => *old = episode,
            None => self.kept.push(episode),
        }
        self.finished += 1;
    }

    /// Episodes that have ended since the run began.
    pub fn finished(&self) -> u64 {
        self.finished
    }

    /// Draws so many different episodes (Floyd's way); there need to be as many.
    pub fn draw(&self, count: usize, random: &mut Random, drawn: &mut Vec<usize>) {
        drawn.clear();
        for last in self.kept.len() - count..self.kept.len() {
            let index = below(random, last + 1);
            drawn.push(if drawn.contains(&index) { last } else { index });
        }
    }

    /// An episode that is kept.
    pub fn episode(&self, index: usize) -> &Episode {
        &self.kept[index]
    }

    /// The bytes of a state.
    pub fn state(&self, episode: usize, step: usize) -> &[u8] {
        self.kept[episode].states.at(step)
    }

    /// The actions that were taken in a state; none in the last.
    pub fn actions(&self, episode: usize, step: usize) -> Option<&[u16]> {
        self.kept[episode].actions.get(step * self.agents..(step + 1) * self.agents)
    }
}

impl Episode {
    /// Steps that were taken.
    pub fn steps(&self) -> usize {
        self.rewards.len()
    }

    /// What followed a state within so many steps or until the end; nothing follows the last.
    pub fn ahead(&self, step: usize, steps: usize, discount: f32) -> Option<Ahead> {
        let last = self.steps().min(step + steps);
        let rewards = self.rewards.get(step..last).filter(|rewards| !rewards.is_empty())?;
        let (mut reward, mut factor) = (0.0, 1.0);
        for earned in rewards {
            reward += factor * earned;
            factor *= discount;
        }
        if last == self.steps() && self.is_over {
            factor = 0.0;
        }
        Some(Ahead { step: last, reward, discount: factor })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sortie_nn::random::stream;

    /// Episodes of three steps each; every other one is over, the others ran out of time.
    fn episodes(count: usize, capacity: usize) -> Episodes {
        let mut episodes = Episodes::new(2, capacity, 2);
        for episode in 0..count {
            for step in 0..3 {
                let end = match (step, episode % 2) {
                    (2, 0) => End::Over,
                    (2, _) => End::TimedOut,
                    _ => End::Open,
                };
                let state = (10 * episode + step) as u8;
                let (actions, reward) = ([state.into(), 7], f32::from(state));
                let (acted, next) = ((&[state][..], &actions[..]), [state + 1]);
                episodes.push(0, acted, (reward, end), &next);
                // The other instance never ends.
                episodes.push(1, acted, (reward, End::Open), &next);
            }
        }
        episodes
    }

    #[test]
    fn what_is_ahead_ends_with_the_episode() {
        let episodes = episodes(2, 8);
        let ahead = |episode, step, steps| {
            let ahead = episodes.episode(episode).ahead(step, steps, 0.5)?;
            Some((episodes.state(episode, ahead.step)[0], ahead.reward, ahead.discount))
        };
        assert_eq!(ahead(0, 0, 1), Some((1, 0.0, 0.5)));
        assert_eq!(ahead(0, 0, 2), Some((2, 0.5, 0.25)));
        assert_eq!(ahead(0, 0, 5), Some((3, 0.5 + 0.5, 0.0)));
        assert_eq!(ahead(0, 2, 1), Some((3, 2.0, 0.0)));
        assert_eq!(ahead(1, 1, 5), Some((13, 11.0 + 6.0, 0.25)));
        assert_eq!(ahead(1, 3, 5), None);
        assert_eq!(episodes.actions(1, 2), Some(&[12, 7][..]));
        assert_eq!(episodes.actions(1, 3), None);
    }

    #[test]
    fn different_episodes_are_drawn_each_as_often() {
        let episodes = episodes(7, 5);
        assert_eq!(episodes.finished(), 7);
        let (mut drawn, mut random) = (Vec::new(), stream(1, 1, 0));
        let mut counts = [0; 70];
        for _ in 0..2_000 {
            episodes.draw(3, &mut random, &mut drawn);
            drawn.iter().for_each(|index| counts[usize::from(episodes.state(*index, 0)[0])] += 1);
            drawn.sort_unstable();
            drawn.dedup();
            assert_eq!(drawn.len(), 3);
        }
        // The first two gave way; of five three are drawn 2,000 times.
        let kept = [20, 30, 40, 50, 60].map(|state| counts[state]);
        assert_eq!(kept.iter().sum::<usize>(), 6_000);
        assert!(kept.iter().all(|count| (1_100..1_300).contains(count)), "{kept:?}");
        episodes.draw(5, &mut random, &mut drawn);
        drawn.sort_unstable();
        assert_eq!(drawn, [0, 1, 2, 3, 4]);
    }
}
