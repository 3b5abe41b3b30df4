//! Experience: the states of every instance in the order in which they were, each stored once; or whole episodes, the latest
//! of all instances.
//!
//! A record is a place in an instance's stretch; what it needs of the future is read there, so that the
//! number of steps, the discount and the partition are chosen when it is used.

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::below;

use crate::SavedStates;

/// How a step left its episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// It goes on.
    Open,
    /// It is over, and what follows is worth nothing.
    Over,
    /// The time ran out: what follows is still worth something.
    TimedOut,
}

/// Steps of all instances, the latest of each.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Replay {
    agents: usize,
    state_bytes: usize,
    capacity: usize,
    stretches: Vec<Stretch>,
}

/// The states of one instance. State i stands at place `i % capacity`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Stretch {
    written: usize,
    /// `[capacity, state_bytes]`
    states: Vec<u8>,
    /// Bytes of each state; what stands behind them does not matter.
    lengths: Vec<u32>,
    actions: Vec<u16>,
    rewards: Vec<f32>,
    ends: Vec<Option<End>>,
}

/// A place in the experience.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    instance: usize,
    state: usize,
}

/// What followed a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Future {
    /// The state that is looked at next.
    pub place: Place,
    /// The discounted rewards until there.
    pub reward: f32,
    /// What its value counts.
    pub discount: f32,
}

impl Replay {
    /// Room for so many states of each instance.
    pub fn new(instances: usize, capacity: usize, agents: usize, state_bytes: usize) -> Self {
        let stretch = Stretch {
            written: 0,
            states: vec![0; capacity * state_bytes],
            lengths: vec![0; capacity],
            actions: vec![0; capacity * agents],
            rewards: vec![0.0; capacity],
            ends: vec![None; capacity],
        };
        Self { agents, state_bytes, capacity, stretches: vec![stretch; instances] }
    }

    /// Adds a state in which actions were taken, and what came of them.
    pub fn push(&mut self, instance: usize, state: &[u8], actions: &[u16], reward: f32, end: End) {
        let slot = self.write(instance, state, Some(end));
        let stretch = &mut self.stretches[instance];
        stretch.actions[slot * self.agents..][..self.agents].copy_from_slice(actions);
        stretch.rewards[slot] = reward;
    }

    /// Adds the last state of an episode, in which nothing was done.
    pub fn push_last(&mut self, instance: usize, state: &[u8]) {
        self.write(instance, state, None);
    }

    fn write(&mut self, instance: usize, state: &[u8], end: Option<End>) -> usize {
        let stretch = &mut self.stretches[instance];
        let slot = stretch.written % self.capacity;
        stretch.written += 1;
        stretch.states[slot * self.state_bytes..][..state.len()].copy_from_slice(state);
        stretch.lengths[slot] = state.len() as u32;
        stretch.ends[slot] = end;
        slot
    }

    /// Draws a state that so many more follow, in which actions were taken.
    ///
    /// Every instance needs to have more than twice as many states.
    pub fn draw(&self, steps: usize, random: &mut Random) -> Place {
        loop {
            let instance = below(random, self.stretches.len());
            let written = self.stretches[instance].written;
            let kept = written.min(self.capacity);
            let state = written - kept + below(random, kept.saturating_sub(steps));
            let place = Place { instance, state };
            if self.stretches[instance].ends[state % self.capacity].is_some() {
                return place;
            }
        }
    }

    /// The bytes of a state.
    pub fn state(&self, place: Place) -> &[u8] {
        let slot = place.state % self.capacity;
        let stretch = &self.stretches[place.instance];
        &stretch.states[slot * self.state_bytes..][..stretch.lengths[slot] as usize]
    }

    /// The actions that were taken in a state.
    pub fn actions(&self, place: Place) -> &[u16] {
        let slot = place.state % self.capacity;
        &self.stretches[place.instance].actions[slot * self.agents..][..self.agents]
    }

    /// What followed a state within so many steps or until its episode ended.
    pub fn future(&self, place: Place, steps: usize, discount: f32) -> Future {
        let stretch = &self.stretches[place.instance];
        let (mut reward, mut factor) = (0.0, 1.0);
        let mut state = place.state;
        for _ in 0..steps {
            let slot = state % self.capacity;
            reward += factor * stretch.rewards[slot];
            factor *= discount;
            state += 1;
            match stretch.ends[slot] {
                Some(End::Open) => {}
                Some(End::TimedOut) => break,
                Some(End::Over) | None => {
                    factor = 0.0;
                    break;
                }
            }
        }
        Future { place: Place { state, ..place }, reward, discount: factor }
    }
}

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
    use sortie_nn::random::stream;

    use super::*;

    /// Two episodes of three steps each: the first is over, the second ran out of time; then an open one.
    fn replay() -> Replay {
        let mut replay = Replay::new(1, 64, 2, 1);
        for episode in 0..3 {
            let ends = [End::Open, End::Open, [End::Over, End::TimedOut, End::Open][episode]];
            for (step, end) in ends.into_iter().enumerate() {
                let state = (10 * episode + step) as u8;
                replay.push(0, &[state], &[state.into(), 7], f32::from(state), end);
            }
            if episode < 2 {
                replay.push_last(0, &[(10 * episode + 3) as u8]);
            }
        }
        replay
    }

    #[test]
    fn a_future_ends_with_its_episode() {
        let replay = replay();
        let future = |state, steps| {
            let future = replay.future(Place { instance: 0, state }, steps, 0.5);
            (replay.state(future.place)[0], future.reward, future.discount)
        };
        assert_eq!(future(0, 1), (1, 0.0, 0.5));
        assert_eq!(future(0, 2), (2, 0.5, 0.25));
        assert_eq!(future(0, 5), (3, 0.5 + 0.5, 0.0));
        assert_eq!(future(5, 5), (13, 11.0 + 6.0, 0.25));
        assert_eq!(future(8, 2), (22, 20.0 + 10.5, 0.25));
    }

    #[test]
    fn a_state_has_its_own_length() {
        let mut replay = Replay::new(1, 4, 1, 3);
        let states = [&[1][..], &[2, 3, 4], &[], &[5, 6], &[7]];
        for (number, state) in states.iter().enumerate() {
            replay.push(0, state, &[0], 0.0, End::Open);
            assert_eq!(replay.state(Place { instance: 0, state: number }), *state);
        }
        assert_eq!(replay.state(Place { instance: 0, state: 3 }), states[3]);
    }

    #[test]
    fn only_states_with_actions_and_a_future_are_drawn() {
        let replay = replay();
        let mut drawn = [0; 30];
        let mut random = stream(1, 1, 0);
        for _ in 0..2000 {
            let place = replay.draw(2, &mut random);
            assert_eq!(replay.actions(place), [replay.state(place)[0].into(), 7]);
            drawn[usize::from(replay.state(place)[0])] += 1;
        }
        let states: Vec<usize> = (0..30).filter(|state| drawn[*state] > 0).collect();
        assert_eq!(states, [0, 1, 2, 10, 11, 12, 20]);
        assert!(states.iter().all(|state| drawn[*state] > 200), "{drawn:?}");
    }

    #[test]
    fn the_oldest_states_give_way() {
        let mut replay = Replay::new(1, 5, 1, 1);
        for state in 0..12 {
            replay.push(0, &[state], &[0], 0.0, End::Open);
        }
        let mut random = stream(1, 1, 0);
        for _ in 0..100 {
            let state = replay.state(replay.draw(2, &mut random))[0];
            assert!((7..10).contains(&state), "{state}");
        }
    }

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
