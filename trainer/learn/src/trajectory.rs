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

mod priorities;

use std::collections::VecDeque;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::below;

use crate::error::LearnError;
use crate::method::Transition;
use crate::state::State;

pub use priorities::{Priorities, importance};

/// States that are stored, and forgotten, together.
const BLOCK: u64 = 256;

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

/// The states of one instance.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(bound(deserialize = "N: Deserialize<'de>"))]
struct Stream<N> {
    blocks: VecDeque<Block<N>>,
    /// Number of the first state in the first block.
    first: u64,
    /// Number of the first state that is kept.
    kept_from: u64,
    /// The number that the next state gets.
    next: u64,
    /// Number of the first state of the running episode.
    running: u64,
    /// Blocks to be used again.
    #[serde(skip)]
    spare: Vec<Block<N>>,
}

/// Some states of one instance, one behind the other.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Block<N> {
    states: Vec<Stored<N>>,
    bytes: Vec<u8>,
    actions: Vec<u16>,
    /// Of every state the team's, then those of subtasks and agents.
    rewards: Vec<f32>,
}

/// What stands together of a state, as a draw out of many millions waits for memory.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Stored<N> {
    /// Where its bytes end.
    bytes_end: u32,
    end: End,
    note: N,
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

    /// Draws so many different episodes (Floyd's way); there need to be as many.
    pub fn draw_episodes(&self, count: usize, random: &mut Random, drawn: &mut Vec<Episode>) {
        drawn.clear();
        for last in self.episodes.len() - count..self.episodes.len() {
            let episode = self.episodes[below(random, last + 1)];
            drawn.push(if drawn.contains(&episode) { self.episodes[last] } else { episode });
        }
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

    fn block(&self, place: Place) -> (&Block<N>, usize) {
        let stream = &self.streams[place.instance as usize];
        let at = place.number - stream.first;
        (&stream.blocks[(at / BLOCK) as usize], (at % BLOCK) as usize)
    }

    /// Names all of it.
    ///
    /// # Errors
    /// A checkpoint has none, or one of another size.
    pub fn visit(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.visit_as(state, "trajectories")
    }

    /// The same of one of several, by this name.
    ///
    /// # Errors
    /// A checkpoint has none, or one of another size.
    pub fn visit_as(&mut self, state: &mut State<'_>, name: &str) -> Result<(), LearnError> {
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

impl<N: Clone + Default> Stream<N> {
    /// Adds a state; returns its block, in which all else about it is to follow.
    fn write(&mut self, state: &[u8], end: End, note: N, widths: Widths) -> &mut Block<N> {
        if self.next == self.first + self.blocks.len() as u64 * BLOCK {
            let mut block = self.spare.pop().unwrap_or_default();
            block.clear();
            block.reserve(widths);
            self.blocks.push_back(block);
        }
        self.next += 1;
        let block = self.blocks.back_mut().expect("a block with room");
        block.bytes.extend_from_slice(state);
        block.states.push(Stored { bytes_end: block.bytes.len() as u32, end, note });
        block
    }

    /// Forgets all states of smaller numbers.
    fn forget_before(&mut self, number: u64) {
        self.kept_from = self.kept_from.max(number);
        while self.first + BLOCK <= self.kept_from {
            self.spare.extend(self.blocks.pop_front());
            self.first += BLOCK;
        }
    }
}

impl<N> Block<N> {
    fn clear(&mut self) {
        self.states.clear();
        self.bytes.clear();
        self.actions.clear();
        self.rewards.clear();
    }

    /// Makes room for all that is to come but the bytes of states, whose number is not known.
    fn reserve(&mut self, widths: Widths) {
        let states = BLOCK as usize;
        self.actions.reserve_exact(states * widths.agents);
        self.rewards.reserve_exact(states * widths.rewards());
        self.states.reserve_exact(states);
    }
}

#[cfg(test)]
mod tests;
