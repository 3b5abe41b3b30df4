//! A replay buffer of trajectories: what every instance did, step by step, from which learners draw.
//!
//! The states of an instance stand one behind the other, each once and at its own length, with what was done in it, what
//! that earned (the team, and where it is asked for each task and each agent), and how the step left its episode. The state
//! in which an episode ended follows its last step; in it nothing was done. A [`Place`] names a state, and what a learner
//! needs of the future is read from there on: how many steps, which discount is chosen when it is drawn.
//!
//! What a learner wants to know of a step besides, it [notes](Trajectories::push_noted) there: an `N`, which may be changed
//! later.
//!
//! What is kept is so many states of each instance, or so many whole episodes, the latest of all instances. Memory that
//! became free is used again: once the buffer is full, it allocates nothing.
//!
//! ```
//! # use sortie_envs::{Environment, Split, random::generator};
//! # use sortie_learn::{Transition, trajectory::{Capacity, Trajectories, Widths}};
//! let mut ring = sortie_envs::open("group-matching/3x6x1", Split::Train, 1, &Default::default())?;
//! let widths = Widths { agents: ring.spec().shape.agents, ..Widths::default() };
//! let mut replay = Trajectories::new(Capacity::States(1_000), 1, widths);
//! let (mut random, actions) = (generator(1), [1; 3]);
//! # let [mut state, mut next] = [Vec::new(), Vec::new()];
//! # ring.reset(0, &mut random);
//! # ring.save(0, &mut state);
//! for _ in 0..10 {
//!     // The trainer does this, and hands out the transition.
//!     let step = ring.step(0, &actions, &mut random)?;
//! #   next.clear();
//! #   ring.save(0, &mut next);
//! #   let (environment, task_rewards, agent_rewards) = (&*ring, &[][..], &[][..]);
//!     replay.push(&Transition { environment, instance: 0, state: &state, actions: &actions, step, task_rewards, agent_rewards, next: &next });
//! #   std::mem::swap(&mut state, &mut next);
//! }
//! let place = replay.draw(3, &mut random);
//! let future = replay.future(place, 3, 0.9);
//! // r + 0.9 r' + 0.81 r'' + 0.729 V(state), or less of it where the episode ended.
//! let (reward, counts, state) = (future.reward, future.discount, replay.state(future.place));
//! # assert!(!state.is_empty() && counts > 0.7 && reward.is_finite());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod drawing;
mod stream;

use std::collections::VecDeque;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::{LearnError, Result};
use crate::method::Transition;
use crate::state::State;

pub use drawing::{Future, Priorities, importance};
use stream::{BLOCK, Block, Stream};

/// How much is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Capacity {
    /// The latest states of each instance.
    States(usize),
    /// The latest whole episodes of all instances, and those that still run.
    Episodes(usize),
}

/// How many numbers are kept of each step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Widths {
    /// Agents whose actions are kept.
    pub agents: usize,
    /// Subtasks whose rewards are kept; 0: the team's alone.
    pub tasks: usize,
    /// Agents whose own rewards are kept; 0: the team's alone.
    pub earners: usize,
}

/// How a step left its episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// It goes on.
    Open,
    /// It is over, and what follows is worth nothing.
    Over,
    /// The time ran out: what follows is still worth something.
    TimedOut,
    /// There was no step: this is the state that an episode ended in.
    Nothing,
}

/// A state: its instance, and its number there since the run began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Place {
    instance: u32,
    number: u64,
}

/// What the step from a state earned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rewards<'a> {
    /// The team.
    pub team: f32,
    /// Each subtask, as far as they are kept.
    pub tasks: &'a [f32],
    /// Each agent, as far as they are kept.
    pub agents: &'a [f32],
}

/// A whole episode: so many steps, and a state more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Episode {
    /// Its first state.
    pub first: Place,
    /// Steps that were taken.
    pub steps: usize,
}

impl Place {
    /// The number of the instance.
    pub fn instance(self) -> usize {
        self.instance as usize
    }

    /// The state so many steps later.
    pub fn after(self, steps: usize) -> Self {
        Self { number: self.number + steps as u64, ..self }
    }

    /// How many steps it is behind an earlier one of the same instance.
    pub fn since(self, earlier: Self) -> usize {
        (self.number - earlier.number) as usize
    }
}

/// The replay buffer.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trajectories<N = ()> {
    capacity: Capacity,
    widths: Widths,
    streams: Vec<Stream<N>>,
    /// The latest whole episodes, in the order in which they ended.
    episodes: VecDeque<Episode>,
    /// Episodes that have ended since the run began.
    finished: u64,
    /// By earners: sums over what is kept.
    earned: Vec<Earned>,
}

/// Sums over the rewards of an agent, from which follow those of what was forgotten.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Earned {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Trajectories {
    /// An empty buffer for so many instances.
    pub fn new(capacity: Capacity, instances: usize, widths: Widths) -> Self {
        Self::noting(capacity, instances, widths)
    }
}

impl<N: Clone + Default + Serialize + DeserializeOwned> Trajectories<N> {
    /// The same, in which something is noted of every step.
    pub fn noting(capacity: Capacity, instances: usize, widths: Widths) -> Self {
        let streams = vec![Stream::default(); instances];
        let earned = vec![Earned::default(); widths.earners];
        Self { capacity, widths, streams, episodes: VecDeque::new(), finished: 0, earned }
    }

    /// Adds a step.
    pub fn push(&mut self, transition: &Transition<'_>) {
        self.push_noted(transition, N::default());
    }

    /// Adds a step, and what is noted of it; returns where it stands.
    pub fn push_noted(&mut self, transition: &Transition<'_>, note: N) -> Place {
        let Transition {
            instance, state, actions, step, task_rewards, agent_rewards, next, ..
        } = *transition;
        let end = match (step.terminated, step.timed_out) {
            (true, _) => End::Over,
            (_, true) => End::TimedOut,
            _ => End::Open,
        };
        let Self { capacity, widths, streams, .. } = self;
        let stream = &mut streams[instance];
        let place = Place { instance: instance as u32, number: stream.next };
        let block = stream.write(state, end, note, *widths);
        block.actions.extend(&actions[..widths.agents]);
        let padded = |rewards: &[f64], count: usize, to: &mut Vec<f32>| {
            let end = to.len() + count;
            to.extend(rewards.iter().take(count).map(|reward| *reward as f32));
            to.resize(end, 0.0);
        };
        block.rewards.push(step.reward as f32);
        padded(task_rewards, widths.tasks, &mut block.rewards);
        padded(agent_rewards, widths.earners, &mut block.rewards);
        let earned = &block.rewards[block.rewards.len() - widths.earners..];
        self.earned.iter_mut().zip(earned).for_each(|(sums, reward)| sums.add(*reward, 1.0));
        if step.done() {
            let block = stream.write(next, End::Nothing, N::default(), *widths);
            block.actions.resize(block.actions.len() + widths.agents, 0);
            block.rewards.resize(block.rewards.len() + widths.rewards(), 0.0);
        }
        if let Capacity::States(kept) = *capacity {
            let first = stream.next.saturating_sub(kept as u64);
            self.forget_before(instance, first);
        }
        if step.done() {
            self.end_episode(instance);
        }
        place
    }

    fn end_episode(&mut self, instance: usize) {
        self.finished += 1;
        let stream = &mut self.streams[instance];
        let (first, steps) = (stream.running, stream.next - stream.running - 1);
        stream.running = stream.next;
        if let Capacity::Episodes(kept) = self.capacity {
            let first = Place { instance: instance as u32, number: first };
            self.episodes.push_back(Episode { first, steps: steps as usize });
            let oldest = (self.episodes.len() > kept).then(|| self.episodes.pop_front());
            if let Some(Episode { first, steps }) = oldest.flatten() {
                // Episodes of an instance end in their order, so that all before this one are gone.
                self.forget_before(first.instance as usize, first.after(steps + 1).number);
            }
        }
    }

    /// The oldest state of an instance that has not been forgotten, or the one that comes next.
    pub fn oldest(&self, instance: usize) -> Place {
        Place { instance: instance as u32, number: self.streams[instance].kept_from }
    }

    /// The states of an instance that have not been forgotten, from the oldest on.
    pub fn places(&self, instance: usize) -> impl Iterator<Item = Place> + use<N> {
        let Stream { kept_from, next, .. } = self.streams[instance];
        (kept_from..next).map(move |number| Place { instance: instance as u32, number })
    }

    /// How many states are kept, those too that episodes ended in.
    pub fn states(&self) -> usize {
        let kept = self.streams.iter().map(|stream| (stream.next - stream.kept_from) as usize);
        kept.sum()
    }

    /// Forgets a state and all before it of its instance.
    pub fn forget(&mut self, place: Place) {
        self.forget_before(place.instance(), place.number + 1);
    }

    /// Forgets all states of an instance with smaller numbers.
    fn forget_before(&mut self, instance: usize, number: u64) {
        if self.widths.earners > 0 {
            let place = |number| Place { instance: instance as u32, number };
            for place in (self.streams[instance].kept_from..number).map(place) {
                if self.end(place) == End::Nothing {
                    continue;
                }
                for agent in 0..self.widths.earners {
                    let reward = self.rewards(place).agents[agent];
                    self.earned[agent].add(reward, -1.0);
                }
            }
        }
        self.streams[instance].forget_before(number);
    }

    /// A reward of an agent in deviations from the mean of all of its rewards that are kept.
    pub fn in_deviations(&self, agent: usize, reward: f32) -> f32 {
        let Earned { count, sum, squares } = self.earned[agent];
        let mean = sum / count;
        let deviation = (squares / count - mean * mean).max(0.0).sqrt();
        let deviation = if deviation > 0.0 { deviation } else { 1.0 };
        ((f64::from(reward) - mean) / deviation) as f32
    }

    /// Episodes that have ended since the run began.
    pub fn finished(&self) -> u64 {
        self.finished
    }

    /// The whole episodes that are kept; none where the capacity is in states.
    pub fn episodes(&self) -> usize {
        self.episodes.len()
    }

    /// The episodes that ended last, so many of those that are kept, in their order.
    pub fn latest(&self, count: usize) -> impl Iterator<Item = Episode> {
        self.episodes.iter().skip(self.episodes.len().saturating_sub(count)).copied()
    }

    /// Whether a state has not been forgotten.
    pub fn has(&self, place: Place) -> bool {
        let stream = &self.streams[place.instance as usize];
        (stream.kept_from..stream.next).contains(&place.number)
    }

    /// The bytes of a state.
    pub fn state(&self, place: Place) -> &[u8] {
        let (block, at) = self.block(place);
        let start = at.checked_sub(1).map_or(0, |before| block.states[before].bytes_end);
        &block.bytes[start as usize..block.states[at].bytes_end as usize]
    }

    /// `[A]`: what was done in a state.
    pub fn actions(&self, place: Place) -> &[u16] {
        let (block, at) = self.block(place);
        &block.actions[at * self.widths.agents..][..self.widths.agents]
    }

    /// What that earned.
    pub fn rewards(&self, place: Place) -> Rewards<'_> {
        let (block, at) = self.block(place);
        let width = self.widths.rewards();
        let rewards = &block.rewards[at * width..][..width];
        let (tasks, agents) = rewards[1..].split_at(self.widths.tasks);
        Rewards { team: rewards[0], tasks, agents }
    }

    /// How the step from a state left its episode.
    pub fn end(&self, place: Place) -> End {
        let (block, at) = self.block(place);
        block.states[at].end
    }

    /// What was noted of it.
    pub fn note(&self, place: Place) -> &N {
        let (block, at) = self.block(place);
        &block.states[at].note
    }

    /// The same, to be changed.
    pub fn note_mut(&mut self, place: Place) -> &mut N {
        let stream = &mut self.streams[place.instance()];
        let at = place.number - stream.first;
        &mut stream.blocks[(at / BLOCK) as usize].states[(at % BLOCK) as usize].note
    }

    fn block(&self, place: Place) -> (&Block<N>, usize) {
        let stream = &self.streams[place.instance as usize];
        let at = place.number - stream.first;
        (&stream.blocks[(at / BLOCK) as usize], (at % BLOCK) as usize)
    }

    /// Names all of it.
    pub fn visit(&mut self, state: &mut State<'_>) -> Result<()> {
        self.visit_as(state, "trajectories")
    }

    /// The same of one of several, by this name.
    ///
    /// # Errors
    /// A checkpoint has none, or one of another size.
    pub fn visit_as(&mut self, state: &mut State<'_>, name: &str) -> Result<()> {
        let sizes = |it: &Self| (it.capacity, it.widths, it.streams.len());
        let own = sizes(self);
        state.value(name, self)?;
        if sizes(self) == own {
            return Ok(());
        }
        Err(LearnError::Config(format!("`{name}` of the checkpoint: of another size")))
    }
}

impl Earned {
    fn add(&mut self, reward: f32, times: f64) {
        let reward = f64::from(reward);
        self.count += times;
        self.sum += times * reward;
        self.squares += times * reward * reward;
    }
}

impl Widths {
    fn rewards(self) -> usize {
        1 + self.tasks + self.earners
    }
}

#[cfg(test)]
mod tests;
