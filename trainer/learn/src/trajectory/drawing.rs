//! What learners draw of a replay, and what followed it.

use serde::Serialize;
use serde::de::DeserializeOwned;
use sortie_envs::Random;
use sortie_envs::random::below;

use super::{End, Episode, Place, Trajectories};

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
}
