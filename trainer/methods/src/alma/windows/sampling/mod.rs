//! Whole episodes, stored as states from which everything else is rebuilt, and windows drawn from them.
//!
//! As in the public code, the states of the drawn episodes are laid end to end and every window begins
//! somewhere in its own stretch of them, so that windows may reach over the ends of episodes. What the
//! public code gets wrong there is not repeated: no transition leads from one episode to the next, and
//! actions and allocations before a window's first state are the true ones.

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use sortie_envs::random::below;
use sortie_envs::{AgentSet, EntitySet, Environment, Observation};
use sortie_nn::random::Generator;

use super::{NO_ACTION, NO_TASK, WindowShape, Windows};

/// One episode: every state with what was decided in it, and the final state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Environment steps of the run when it began.
    pub added: u64,
    agents: usize,
    tasks: usize,
    /// The states, each as many bytes as it needs, and where each of them ends.
    states: (Vec<u8>, Vec<u32>),
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
        let (bytes, ends) = &mut self.states;
        bytes.extend_from_slice(moment.state);
        ends.push(bytes.len() as u32);
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
        self.states.0.shrink_to_fit();
        self.states.1.shrink_to_fit();
        self.allocation.shrink_to_fit();
        self.actions.shrink_to_fit();
        self.decision.shrink_to_fit();
        self.reward.shrink_to_fit();
        self.task_reward.shrink_to_fit();
    }

    /// States, the final one included.
    pub fn states(&self) -> usize {
        self.states.1.len()
    }

    /// Steps taken.
    pub fn steps(&self) -> usize {
        self.reward.len()
    }

    /// The bytes of a state.
    pub fn state(&self, state: usize) -> &[u8] {
        let (bytes, ends) = &self.states;
        let start = state.checked_sub(1).map_or(0, |before| ends[before]);
        &bytes[start as usize..ends[state] as usize]
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
}

/// How a batch is cut, and what is added to its rewards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleShape {
    /// Episodes to draw, and windows to cut.
    pub windows: usize,
    /// States of a window.
    pub steps: usize,
    /// What is added to its rewards.
    pub shaping: Shaping,
}

/// Rewards for coming nearer, by the environment's potential; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shaping {
    /// Potential of a step that is missing between an agent and its subtask.
    pub scale: f32,
    /// Discount of a step.
    pub discount: f32,
}

/// Draws distinct episodes among those that `may_be_drawn`, as indices, or `None` if there are too few.
pub fn draw_episodes(
    replay: &Replay,
    count: usize,
    generator: &mut Generator,
    may_be_drawn: impl Fn(&Episode) -> bool,
) -> Option<Vec<usize>> {
    let episodes = replay.episodes().iter().enumerate();
    let mut candidates: Vec<usize> =
        episodes.filter(|(_, episode)| may_be_drawn(episode)).map(|(index, _)| index).collect();
    if candidates.len() < count {
        return None;
    }
    for place in 0..count {
        let chosen = place + below(generator, candidates.len() - place);
        candidates.swap(place, chosen);
    }
    candidates.truncate(count);
    Some(candidates)
}

/// Cuts windows from some episodes of an environment.
pub fn cut_windows(
    environment: &dyn Environment,
    replay: &Replay,
    drawn: &[usize],
    sample: SampleShape,
    generator: &mut Generator,
) -> Windows {
    let episodes: Vec<&Episode> = drawn.iter().map(|index| &replay.episodes()[*index]).collect();
    let longest = episodes.iter().map(|episode| episode.states()).max().unwrap_or(0);
    let steps = sample.steps.min(longest);
    let sizes = WindowShape::of(environment.spec());
    let shape = WindowShape { windows: drawn.len(), steps, ..sizes };
    let mut windows = Windows::new(shape);
    windows.features.clear();
    // Every state of all windows, by episode and its number there.
    let places: Vec<Option<(&Episode, usize)>> = if longest <= sample.steps {
        padded(&episodes, steps).collect()
    } else {
        stretches(&episodes, steps, generator)
    };
    let mut writer =
        Writer { environment, shaping: sample.shaping, windows, seen: Default::default() };
    for (state, place) in places.into_iter().enumerate() {
        match place {
            Some(place) => writer.write(state, place),
            None => (0..sizes.entities).for_each(|_| writer.windows.features.end_row()),
        }
    }
    writer.windows
}

/// Every episode as a window of its own, padded to the same length.
fn padded<'a>(
    episodes: &'a [&'a Episode],
    steps: usize,
) -> impl Iterator<Item = Option<(&'a Episode, usize)>> {
    episodes.iter().flat_map(move |episode| {
        (0..steps).map(|at| (at < episode.states()).then_some((*episode, at)))
    })
}

/// One window from each of as many equal stretches of all states.
fn stretches<'a>(
    episodes: &[&'a Episode],
    steps: usize,
    generator: &mut Generator,
) -> Vec<Option<(&'a Episode, usize)>> {
    let all: Vec<(&Episode, usize)> = episodes
        .iter()
        .flat_map(|episode| (0..episode.states()).map(|at| (*episode, at)))
        .collect();
    let count = episodes.len();
    // The starts from which a whole window fits.
    let starts = all.len() - steps + 1;
    let edge =
        |index: usize| (starts as f64 * index as f64 / count as f64).round_ties_even() as usize;
    let mut places = Vec::with_capacity(count * steps);
    for window in 0..count {
        let (from, to) = (edge(window), edge(window + 1));
        let start = (from + below(generator, (to - from).max(1))).min(starts - 1);
        places.extend(all[start..][..steps].iter().copied().map(Some));
    }
    places
}

/// Windows that are being written, state by state.
struct Writer<'a> {
    environment: &'a dyn Environment,
    shaping: Shaping,
    windows: Windows,
    seen: Observation,
}

impl Writer<'_> {
    /// Writes a state of a window from one of an episode. Rows of features are added in order.
    fn write(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        self.environment.observe(episode.state(at), 0, EntitySet::MAX, &mut self.seen);
        self.write_entities(state, (episode, at));
        self.write_agents(state, (episode, at));
        let Self { environment, windows, seen, .. } = self;
        windows.decision[state] = episode.decision(at);
        windows.added[state] = episode.added;
        let tasks = windows.shape.tasks;
        for task in 0..tasks {
            let open = seen.open_tasks >> task & 1 == 1;
            windows.open[state * tasks + task] = open;
            windows.task_unfinished[state * tasks + task] = open;
        }
        if at < episode.steps() {
            environment.observe(episode.state(at + 1), 0, 0, seen);
            self.write_outcome(state, (episode, at));
        } else {
            windows.task_terminated[state * tasks..][..tasks].fill(true);
        }
    }

    /// Features, existence and subtasks of all entities.
    fn write_entities(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { windows, seen, .. } = self;
        let first = state * windows.shape.entities;
        for entity in 0..windows.shape.entities {
            let exists = seen.present >> entity & 1 == 1;
            windows.present[first + entity] = exists;
            if exists {
                windows.features.push_row(&seen.rows, seen.row_of(entity));
                windows.entity_task[first + entity] = match episode.allocation(at).get(entity) {
                    Some(task) => *task,
                    None => seen.task_of(entity),
                };
            }
            windows.features.end_row();
        }
    }

    /// What the agents that exist observe, can do and did.
    fn write_agents(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { windows, seen, .. } = self;
        let WindowShape { agents, entities, actions, .. } = windows.shape;
        let present = &windows.present[state * entities..][..entities];
        for agent in 0..seen.agents() {
            let own = state * agents + agent;
            // As they act and are deployed: of what shares their subtask agents see all that exists.
            windows.observable[own * entities..][..entities].copy_from_slice(present);
            let codes = &mut windows.available[own * actions..][..actions];
            for (action, code) in codes.iter_mut().enumerate() {
                *code = (seen.available[agent] >> action & 1) as u16;
            }
            windows.actions[own] = episode.actions(at)[agent];
            let before = at.checked_sub(1);
            windows.last_actions[own] = before.map_or(NO_ACTION, |at| episode.actions(at)[agent]);
            windows.last_allocation[own] =
                before.map_or(NO_TASK, |at| episode.allocation(at)[agent]);
        }
    }

    /// What the step from a state came to; the state behind it is seen.
    fn write_outcome(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { windows, seen, shaping, .. } = self;
        let WindowShape { steps, tasks, .. } = windows.shape;
        let own_tasks = state * tasks..(state + 1) * tasks;
        for (task, terminated) in windows.task_terminated[own_tasks.clone()].iter_mut().enumerate()
        {
            *terminated = seen.open_tasks >> task & 1 == 0;
        }
        windows.reward[state] = episode.reward(at);
        windows.task_reward[own_tasks].copy_from_slice(episode.task_reward(at));
        let last = at + 1 == episode.steps();
        windows.reset[state] = last;
        windows.terminated[state] = last && episode.terminated;
        windows.has_transition[state] = state % steps + 1 < steps;
        if shaping.scale != 0.0 {
            self.shape(state, (episode, at));
        }
    }

    /// Adds to the rewards of a step what its end is nearer than its beginning.
    fn shape(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { environment, windows, shaping: Shaping { scale, discount }, .. } = self;
        let WindowShape { agents, entities, tasks, .. } = windows.shape;
        let gain = |team: AgentSet, task: Option<usize>, ends: bool| {
            let potential = |at| environment.potential(episode.state(at), *scale, team, task);
            let before = potential(at);
            if ends { -before } else { *discount * potential(at + 1) - before }
        };
        let present = &windows.present[state * entities..][..agents];
        let team = |task: Option<usize>| {
            let works = |agent: &usize| {
                let allocated = usize::from(episode.allocation(at)[*agent]);
                present[*agent] && task.is_none_or(|task| allocated == task)
            };
            (0..agents).filter(works).fold(0, |team, agent| team | 1 << agent)
        };
        for task in 0..tasks {
            let own = state * tasks + task;
            match team(Some(task)) {
                0 => {}
                team => {
                    let ends = windows.task_terminated[own];
                    windows.task_reward[own] += gain(team, Some(task), ends);
                }
            }
        }
        windows.reward[state] += gain(team(None), None, windows.terminated[state]);
    }
}
