//! Experience: what every instance saw, did and earned, each observation stored once, decision by decision; a decision
//! holds for some steps.

use serde::{Deserialize, Serialize};
use sortie_envs::random::below;
use sortie_envs::{Environment, Random};

/// What an instance is doing.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Decision {
    /// `[agents]`
    pub(crate) actions: Vec<u16>,
    /// Steps that it holds for.
    pub(crate) left: usize,
    /// `[agents]`: what each has earned by it.
    pub(crate) rewards: Vec<f32>,
    /// What a reward of the next step counts.
    pub(crate) discount: f32,
    /// How near each agent was to what it is after.
    potentials: Vec<f32>,
}

impl Decision {
    /// Begins another one, of so many agents, that holds for so many steps.
    pub(crate) fn begin(&mut self, agents: usize, steps: usize) {
        self.actions.resize(agents, 0);
        self.left = steps;
        self.rewards.clear();
        self.rewards.resize(agents, 0.0);
        self.discount = 1.0;
    }

    /// Adds what a step brought.
    pub(crate) fn earn(&mut self, rewards: &[f64], discount: f32) {
        for (sum, reward) in self.rewards.iter_mut().zip(rewards) {
            *sum += self.discount * *reward as f32;
        }
        self.discount *= discount;
    }

    /// Looks how near each agent is to what it is after, by which rewards are shaped on this scale.
    pub(crate) fn look(&mut self, environment: &dyn Environment, state: &[u8], scale: f32) {
        let near = |agent: usize| environment.potential(state, scale, 1 << agent, None);
        let agents = 0..self.rewards.len();
        self.potentials.clear();
        self.potentials.extend(agents.map(|agent| if scale == 0.0 { 0.0 } else { near(agent) }));
    }

    /// Adds how much nearer each agent came since it last looked.
    pub(crate) fn shape(&mut self, environment: &dyn Environment, state: &[u8], scale: f32) {
        let before = std::mem::take(&mut self.potentials);
        self.look(environment, state, scale);
        for ((sum, before), after) in self.rewards.iter_mut().zip(before).zip(&self.potentials) {
            *sum += self.discount * *after - before;
        }
    }
}

/// What came of a decision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outcome<'a> {
    /// `[agents]`: what each earned until the next decision.
    pub rewards: &'a [f32],
    /// What the value of the next decision counts.
    pub discount: f32,
    /// Whether no decision of the same episode follows.
    pub is_last: bool,
}

/// Decisions of all instances, the latest of each.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Replay {
    agents: usize,
    observed: usize,
    capacity: usize,
    stretches: Vec<Stretch>,
    totals: Vec<Total>,
}

/// Decisions of one instance. Number i stands at place `i % capacity`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Stretch {
    written: usize,
    /// `[capacity, observed]`
    observations: Vec<f32>,
    /// `[capacity, agents]`
    actions: Vec<u16>,
    /// `[capacity, agents]`
    rewards: Vec<f32>,
    discounts: Vec<f32>,
    ends: Vec<Next>,
}

/// What follows an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Next {
    /// A decision was made, of which nothing has come yet.
    Pending,
    /// The next observation.
    Observation,
    /// The next observation, the last of its episode.
    Last,
    /// Another episode: nothing was decided here.
    Nothing,
}

/// Sums over all rewards of an agent that are kept.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Total {
    count: f64,
    sum: f64,
    squares: f64,
}

/// A decision by its instance and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct Place {
    instance: usize,
    number: usize,
}

impl Place {
    /// The next of its episode, if that went on.
    pub(crate) fn next(self) -> Self {
        Self { number: self.number + 1, ..self }
    }
}

/// What followed a decision.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Future {
    /// The decision that is looked at next.
    pub next: Option<Place>,
    /// `[agents]`: the discounted rewards until there, perhaps in deviations from the mean of those that are kept.
    pub rewards: Vec<f32>,
    /// What its value counts.
    pub discount: f32,
}

impl Replay {
    /// Room for so many decisions of each instance, of so many agents who see so many numbers together.
    pub(crate) fn new(instances: usize, capacity: usize, agents: usize, observed: usize) -> Self {
        let stretches = vec![Stretch::default(); instances];
        Self { agents, observed, capacity, stretches, totals: vec![Total::default(); agents] }
    }

    /// Adds a decision.
    pub(crate) fn decide(&mut self, instance: usize, observation: &[f32], actions: &[u16]) {
        self.write(instance, observation, actions, Next::Pending);
    }

    /// Adds what came of the last decision of an instance, whose place this returns.
    pub(crate) fn conclude(&mut self, instance: usize, outcome: Outcome<'_>) -> Place {
        let (agents, stretch) = (self.agents, &mut self.stretches[instance]);
        let slot = (stretch.written - 1) % self.capacity;
        stretch.rewards[slot * agents..][..agents].copy_from_slice(outcome.rewards);
        stretch.discounts[slot] = outcome.discount;
        stretch.ends[slot] = if outcome.is_last { Next::Last } else { Next::Observation };
        for (total, reward) in self.totals.iter_mut().zip(outcome.rewards) {
            total.add(*reward, 1.0);
        }
        Place { instance, number: stretch.written - 1 }
    }

    /// Adds the last observation of an episode.
    pub(crate) fn end(&mut self, instance: usize, observation: &[f32]) {
        let nothing = vec![0; self.agents];
        self.write(instance, observation, &nothing, Next::Nothing);
    }

    fn write(&mut self, instance: usize, observation: &[f32], actions: &[u16], next: Next) {
        let (agents, stretch) = (self.agents, &mut self.stretches[instance]);
        let slot = stretch.written % self.capacity;
        if slot == stretch.ends.len() {
            stretch.observations.resize((slot + 1) * self.observed, 0.0);
            stretch.actions.resize((slot + 1) * agents, 0);
            stretch.rewards.resize((slot + 1) * agents, 0.0);
            stretch.discounts.push(0.0);
            stretch.ends.push(Next::Nothing);
        } else if matches!(stretch.ends[slot], Next::Observation | Next::Last) {
            let rewards = &stretch.rewards[slot * agents..][..agents];
            for (total, reward) in self.totals.iter_mut().zip(rewards) {
                total.add(*reward, -1.0);
            }
        }
        stretch.observations[slot * self.observed..][..self.observed].copy_from_slice(observation);
        stretch.actions[slot * agents..][..agents].copy_from_slice(actions);
        stretch.ends[slot] = next;
        stretch.written += 1;
    }

    /// Decisions that are kept and of which something came.
    pub(crate) fn decisions(&self) -> usize {
        self.totals.first().map_or(0, |total| total.count as usize)
    }

    /// Draws a decision that so many observations follow, or of whose episode the end is kept.
    pub(crate) fn draw(&self, steps: usize, random: &mut Random) -> Place {
        loop {
            let instance = below(random, self.stretches.len());
            let stretch = &self.stretches[instance];
            let kept = stretch.written.min(self.capacity);
            let number = stretch.written - kept + below(random, kept.max(1));
            let place = Place { instance, number };
            if kept > 0 && self.has_future(place, steps) {
                return place;
            }
        }
    }

    fn has_future(&self, place: Place, steps: usize) -> bool {
        let stretch = &self.stretches[place.instance];
        for number in place.number..place.number + steps {
            match stretch.ends.get(number % self.capacity) {
                Some(Next::Observation) if number + 1 < stretch.written => {}
                Some(Next::Last) => return number + 1 < stretch.written,
                _ => return false,
            }
        }
        true
    }

    /// What all agents saw, one behind the other.
    pub(crate) fn observation(&self, place: Place) -> &[f32] {
        let slot = place.number % self.capacity;
        &self.stretches[place.instance].observations[slot * self.observed..][..self.observed]
    }

    /// What they did.
    pub(crate) fn actions(&self, place: Place) -> &[u16] {
        let slot = place.number % self.capacity;
        &self.stretches[place.instance].actions[slot * self.agents..][..self.agents]
    }

    /// What each agent earned by a decision of an instance, by its number.
    #[cfg(test)]
    pub(crate) fn rewards(&self, instance: usize, number: usize) -> &[f32] {
        &self.stretches[instance].rewards[number * self.agents..][..self.agents]
    }

    /// A reward of an agent in deviations from the mean of all of its rewards that are kept.
    fn scaled(&self, agent: usize, reward: f32) -> f32 {
        let Total { count, sum, squares } = self.totals[agent];
        let mean = sum / count;
        let deviation = (squares / count - mean * mean).max(0.0).sqrt();
        let deviation = if deviation > 0.0 { deviation } else { 1.0 };
        ((f64::from(reward) - mean) / deviation) as f32
    }

    /// What followed a decision within so many, or until its episode ended; rewards in deviations if they are to be
    /// `normalised`.
    pub(crate) fn future(&self, place: Place, steps: usize, normalised: bool, future: &mut Future) {
        let stretch = &self.stretches[place.instance];
        future.rewards.clear();
        future.rewards.resize(self.agents, 0.0);
        future.discount = 1.0;
        let mut number = place.number;
        for _ in 0..steps {
            let slot = number % self.capacity;
            let rewards = &stretch.rewards[slot * self.agents..][..self.agents];
            for (agent, (sum, reward)) in future.rewards.iter_mut().zip(rewards).enumerate() {
                let reward = if normalised { self.scaled(agent, *reward) } else { *reward };
                *sum += future.discount * reward;
            }
            future.discount *= stretch.discounts[slot];
            number += 1;
            if stretch.ends[slot] == Next::Last {
                break;
            }
        }
        future.next = Some(Place { number, ..place });
    }
}

impl Total {
    fn add(&mut self, reward: f32, times: f64) {
        let reward = f64::from(reward);
        self.count += times;
        self.sum += times * reward;
        self.squares += times * reward * reward;
    }
}

#[cfg(test)]
mod tests {
    use sortie_nn::random::stream;

    use super::*;

    /// One instance of two agents who see a number: episodes of three decisions, the first agent earns the number.
    fn replay(capacity: usize, decisions: usize) -> Replay {
        let mut replay = Replay::new(1, capacity, 2, 1);
        for number in 0..decisions {
            let is_last = number % 3 == 2;
            replay.decide(0, &[number as f32], &[number as u16, 7]);
            let outcome = Outcome { rewards: &[number as f32, 2.0], discount: 0.5, is_last };
            replay.conclude(0, outcome);
            if is_last {
                replay.end(0, &[100.0 + number as f32]);
            }
        }
        replay
    }

    fn future(replay: &Replay, place: Place, steps: usize) -> (f32, Future) {
        let mut future = Future::default();
        replay.future(place, steps, true, &mut future);
        (replay.observation(future.next.unwrap())[0], future)
    }

    #[test]
    fn rewards_are_in_deviations_of_what_is_kept() {
        // Decisions 0 to 5 and two last observations; the mean is 2.5, the deviation that of six numbers in a row.
        let replay = replay(8, 6);
        assert_eq!(replay.decisions(), 6);
        let deviation = (35.0_f32 / 12.0).sqrt();
        let (next, found) = future(&replay, Place { instance: 0, number: 0 }, 2);
        assert_eq!((next, found.discount), (2.0, 0.25));
        let want = (0.0 - 2.5) / deviation + 0.5 * (1.0 - 2.5) / deviation;
        assert!((found.rewards[0] - want).abs() < 1e-6, "{found:?}");
        // An agent that always earns the same learns of nothing.
        assert_eq!(found.rewards[1], 0.0);
        let mut found = Future::default();
        replay.future(Place { instance: 0, number: 1 }, 2, false, &mut found);
        assert_eq!(found.rewards, [1.0 + 0.5 * 2.0, 2.0 + 0.5 * 2.0]);
        // The decision behind the first last observation.
        let (next, found) = future(&replay, Place { instance: 0, number: 4 }, 9);
        assert_eq!((next, found.discount), (105.0, 0.125));
    }

    #[test]
    fn what_gave_way_counts_no_more() {
        let replay = replay(8, 9);
        // Kept are decisions 3 to 8 and two last observations.
        assert_eq!(replay.decisions(), 6);
        let (_, found) = future(&replay, Place { instance: 0, number: 4 }, 1);
        let want = (3.0 - 5.5) / (35.0_f32 / 12.0).sqrt();
        assert!((found.rewards[0] - want).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn only_decisions_whose_future_is_kept_are_drawn() {
        let mut replay = replay(64, 7);
        replay.decide(0, &[7.0], &[7, 7]);
        let mut random = stream(1, 1, 0);
        let mut drawn = [0; 9];
        for _ in 0..1000 {
            let place = replay.draw(2, &mut random);
            let [own, other] = replay.actions(place) else { panic!("two agents") };
            assert_eq!((f32::from(*own), *other), (replay.observation(place)[0], 7));
            drawn[usize::from(*own)] += 1;
        }
        // The last has no outcome yet, and the one before no two.
        assert!(drawn[..6].iter().all(|count| *count > 100), "{drawn:?}");
        assert_eq!(drawn[6..], [0, 0, 0]);
    }
}
