//! What learners draw of a replay, and what followed it; and items drawn as often as their errors were large (prioritised
//! replay, Schaul et al. 2016).
//!
//! Such items are numbers: those of states are [`slot`](super::Trajectories::slot)s, other things are numbered by whoever keeps
//! them.
//!
//! ```
//! # use sortie_envs::random::generator;
//! # use sortie_learn::trajectory::{Priorities, importance};
//! let mut priorities = Priorities::new(100, 0.5);
//! (0..10).for_each(|item| priorities.add(item));
//! // Learned from without error it is drawn seldom.
//! priorities.correct(3, 0.0);
//! let mut random = generator(1);
//! let drawn: Vec<(usize, f64)> = (0..4).filter_map(|_| priorities.draw(&mut random)).collect();
//! let weights = importance(drawn.iter().map(|(_, priority)| *priority), 0.6);
//! assert!(weights.into_iter().all(|weight| 0.0 < weight && weight <= 1.0));
//! ```

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::{below, unit};

use super::{Capacity, End, Episode, Place, Trajectories};

/// What followed a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Future {
    /// The state that is looked at next.
    pub place: Place,
    /// The discounted rewards of the team until there.
    pub reward: f32,
    /// What its value counts.
    pub discount: f32,
}

impl<N: Clone + Default + Serialize + DeserializeOwned> Trajectories<N> {
    /// Whether there is a state that so many more follow, in which something was done.
    pub fn can_draw(&self, steps: usize) -> bool {
        // Of two states behind each other something was done in one.
        self.streams.iter().any(|stream| (stream.next - stream.kept_from) as usize > steps + 1)
    }

    /// Draws a state that so many more follow, in which something was done. There needs to be one.
    pub fn draw(&self, steps: usize, random: &mut Random) -> Place {
        loop {
            let place = self.draw_any(steps, random);
            if self.end(place) != End::Nothing {
                return place;
            }
        }
    }

    /// The same of any state, without looking at it.
    pub fn draw_any(&self, steps: usize, random: &mut Random) -> Place {
        loop {
            let instance = below(random, self.streams.len());
            let stream = &self.streams[instance];
            let kept = (stream.next - stream.kept_from) as usize;
            let ahead = below(random, kept.saturating_sub(steps)) as u64;
            if kept > steps {
                return Place { instance: instance as u32, number: stream.kept_from + ahead };
            }
        }
    }

    /// Reads a little of a state and of what was earned in it, so that both are on their way from memory.
    pub fn fetch(&self, place: Place) -> u8 {
        const CACHE_LINE: usize = 64;
        let state = self.state(place);
        let last = state.len().saturating_sub(1);
        // Always as many: a loop of another length for each state would wait for the first of them.
        let bytes = (0..8).map(|line| state.get((line * CACHE_LINE).min(last)));
        let bytes = bytes.fold(0, |sum, byte| sum ^ byte.copied().unwrap_or(0));
        bytes ^ self.rewards(place).team.to_bits() as u8
    }

    /// What followed a state within so many steps or until its episode ended.
    pub fn future(&self, place: Place, steps: usize, discount: f32) -> Future {
        let of_team = |place| (self.rewards(place).team, self.end(place));
        self.future_of(place, steps, discount, of_team, |_| false)
    }

    /// The same of whom a step earned so much and left so, until a state in which it stops.
    pub fn future_of(
        &self,
        place: Place,
        steps: usize,
        discount: f32,
        earned: impl Fn(Place) -> (f32, End),
        stops: impl Fn(Place) -> bool,
    ) -> Future {
        let mut future = Future { place, reward: 0.0, discount: 1.0 };
        for _ in 0..steps {
            let (reward, end) = earned(future.place);
            if end == End::Nothing {
                return Future { discount: 0.0, ..future };
            }
            future.reward += future.discount * reward;
            future.discount *= if end == End::Over { 0.0 } else { discount };
            future.place = future.place.after(1);
            if end != End::Open || stops(future.place) {
                break;
            }
        }
        future
    }

    /// Draws so many different episodes (Floyd's way); there need to be as many.
    pub fn draw_episodes(&self, count: usize, random: &mut Random, drawn: &mut Vec<Episode>) {
        drawn.clear();
        for last in self.episodes.len() - count..self.episodes.len() {
            let episode = self.episodes[below(random, last + 1)];
            drawn.push(if drawn.contains(&episode) { self.episodes[last] } else { episode });
        }
    }

    /// The number of a state for [`Priorities`], among [`slots`](Self::slots): that of the state before it that it pushed out.
    ///
    /// # Panics
    /// The capacity is in episodes.
    pub fn slot(&self, place: Place) -> usize {
        let kept = self.kept();
        place.instance() * kept + (place.number % kept as u64) as usize
    }

    /// The latest state of a slot that was filled.
    pub fn at(&self, slot: usize) -> Place {
        let (instance, kept) = (slot / self.kept(), self.kept() as u64);
        let last = self.streams[instance].next - 1;
        let ahead = (last % kept + kept - slot as u64 % kept) % kept;
        Place { instance: instance as u32, number: last - ahead }
    }

    /// How many slots there are.
    pub fn slots(&self) -> usize {
        self.streams.len() * self.kept()
    }

    fn kept(&self) -> usize {
        match self.capacity {
            Capacity::States(kept) => kept,
            Capacity::Episodes(_) => panic!("slots are of states"),
        }
    }
}

/// Added to an error, so that what is well known is still drawn.
const LEAST: f64 = 0.001;

/// What each item counts when one is drawn: leaves of a tree whose nodes are sums.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Priorities {
    /// Power of an error.
    exponent: f64,
    /// Node `i` is the sum of `2 i` and `2 i + 1`; behind all nodes stand the leaves.
    nodes: Vec<f64>,
    /// The largest that was ever given; what is new counts as much.
    most: f64,
}

impl Priorities {
    /// So many items, none of which counts yet; priorities are errors to the power of `exponent`, 0 to 1.
    pub fn new(items: usize, exponent: f64) -> Self {
        Self { exponent, nodes: vec![0.0; 2 * items.next_power_of_two()], most: 1.0 }
    }

    /// An item is new: it counts as much as the most that ever did.
    pub fn add(&mut self, item: usize) {
        self.set(item, self.most);
    }

    /// An item is not drawn any more.
    pub fn remove(&mut self, item: usize) {
        self.set(item, 0.0);
    }

    /// An item was learned from with such an error.
    pub fn correct(&mut self, item: usize, error: f32) {
        let priority = (f64::from(error.abs()) + LEAST).powf(self.exponent);
        self.most = self.most.max(priority);
        self.set(item, priority);
    }

    fn set(&mut self, item: usize, priority: f64) {
        let mut node = self.nodes.len() / 2 + item;
        self.nodes[node] = priority;
        while node > 1 {
            node /= 2;
            self.nodes[node] = self.nodes[2 * node] + self.nodes[2 * node + 1];
        }
    }

    /// An item, as often as it counts, and its priority; none where none does.
    pub fn draw(&self, random: &mut Random) -> Option<(usize, f64)> {
        let (leaves, mut node) = (self.nodes.len() / 2, 1);
        let mut left = unit(random) * self.nodes[1];
        while node < leaves {
            let first = self.nodes[2 * node];
            // Sums are rounded: nothing is drawn from where nothing counts.
            let is_first = left < first || self.nodes[2 * node + 1] == 0.0;
            node = 2 * node + usize::from(!is_first);
            left -= if is_first { 0.0 } else { first };
        }
        (self.nodes[node] > 0.0).then_some((node - leaves, self.nodes[node]))
    }
}

/// What the error of each drawn item is multiplied by, which makes up for how often it is drawn: the least likely counts 1.
pub fn importance(
    priorities: impl Iterator<Item = f64> + Clone,
    exponent: f64,
) -> impl Iterator<Item = f32> {
    let least = priorities.clone().fold(f64::INFINITY, f64::min);
    priorities.map(move |priority| (least / priority).powf(exponent) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_drawn_as_often_as_a_naive_list_says() {
        let mut priorities = Priorities::new(5, 0.4);
        let mut list = [0.0_f64; 5];
        let mut random = sortie_envs::random::generator(1);
        assert_eq!(priorities.draw(&mut random), None);
        (0..4).for_each(|place| priorities.add(place));
        list[..4].fill(1.0);
        for (place, error) in [(0, 0.5_f32), (2, -3.0), (1, 0.0)] {
            priorities.correct(place, error);
            list[place] = (f64::from(error.abs()) + 0.001).powf(0.4);
        }
        // What is new counts as much as the most did.
        priorities.add(4);
        list[4] = list[2];
        priorities.remove(3);
        list[3] = 0.0;
        let mut drawn = [0; 5];
        for _ in 0..20_000 {
            let (place, priority) = priorities.draw(&mut random).unwrap();
            drawn[place] += 1;
            assert_eq!(priority, list[place]);
        }
        let sum: f64 = list.iter().sum();
        for (found, want) in drawn.into_iter().zip(list) {
            assert!((f64::from(found) / 20_000.0 - want / sum).abs() < 0.01, "{drawn:?} {list:?}");
        }
        (0..5).for_each(|place| priorities.remove(place));
        assert_eq!(priorities.draw(&mut random), None);
    }

    #[test]
    fn what_is_drawn_often_counts_less() {
        let found: Vec<f32> = importance([0.5, 2.0, 1.0].into_iter(), 0.5).collect();
        let all = [0.5_f64, 2.0, 1.0].map(|priority| {
            // As published: (number times probability)^-exponent, by the largest of the batch.
            (3.0 * priority / 3.5).powf(-0.5)
        });
        for (found, want) in found.iter().zip(all) {
            assert!((f64::from(*found) - want / all[0]).abs() < 1e-6);
        }
    }
}
