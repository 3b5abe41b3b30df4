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
use sortie_envs::{AgentSet, EntitySet, Environment, Observation, Shape};
use sortie_learn::trajectory::{Capacity, End, Episode, Place, Widths};
use sortie_learn::{LearnError, State, Trajectories, Transition};
use sortie_nn::random::Generator;

use super::{NO_ACTION, NO_TASK, WindowShape, Windows};

/// What is noted of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// Whether agents were allocated anew before it.
    pub decision: bool,
    /// Environment steps of the run when its episode began.
    pub added: u64,
}

/// The newest episodes of a run. Behind each of their states stands the allocation `[A]` that was in force.
#[derive(Clone, Debug)]
pub struct Replay {
    agents: usize,
    /// What was done, and earned.
    pub steps: Trajectories<Note>,
}

impl Replay {
    /// Room for so many episodes, of so many instances of an environment of this shape.
    pub fn new(episodes: usize, instances: usize, shape: &Shape) -> Self {
        let Shape { agents, tasks, .. } = *shape;
        let widths = Widths { agents, tasks, earners: 0 };
        Self {
            agents,
            steps: Trajectories::noting(Capacity::Episodes(episodes), instances, widths),
        }
    }

    /// Adds a step under an allocation.
    pub fn push(&mut self, transition: &Transition<'_>, allocation: &[u8], note: Note) {
        let state = &[transition.state, allocation].concat();
        let last = if transition.step.done() { transition.next } else { &[] };
        self.steps.push_noted(
            &Transition { state, next: &[last, allocation].concat(), ..*transition },
            note,
        );
    }

    /// All episodes, one round behind the other and those of a round by their instances.
    pub fn episodes(&self) -> Vec<Episode> {
        let mut episodes: Vec<Episode> = self.steps.latest(usize::MAX).collect();
        episodes.sort_by_key(|episode| (self.steps.note(episode.first).added, episode.first));
        episodes
    }

    /// The bytes of a state.
    pub fn state(&self, place: Place) -> &[u8] {
        self.parts(place).0
    }

    /// The allocation `[A]` in force in a state.
    pub fn allocation(&self, place: Place) -> &[u8] {
        self.parts(place).1
    }

    fn parts(&self, place: Place) -> (&[u8], &[u8]) {
        let whole = self.steps.state(place);
        whole.split_at(whole.len() - self.agents)
    }

    /// Names all of it.
    ///
    /// # Errors
    /// A checkpoint has none, or one of another size.
    pub fn visit(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.steps.visit(state)
    }
}

/// How a batch is cut, and what is added to its rewards for coming nearer, by the environment's potential; nothing by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleShape {
    /// Episodes to draw, and windows to cut.
    pub windows: usize,
    /// States of a window.
    pub steps: usize,
    /// Potential of a step that is missing between an agent and its subtask.
    pub shaping: f32,
    /// Discount of a step.
    pub discount: f32,
}

/// Draws distinct episodes among those that `may_be_drawn`, or `None` if there are too few.
pub fn draw_episodes(
    replay: &Replay,
    count: usize,
    generator: &mut Generator,
    may_be_drawn: impl Fn(Episode) -> bool,
) -> Option<Vec<Episode>> {
    let mut candidates = replay.episodes();
    candidates.retain(|episode| may_be_drawn(*episode));
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

/// A state of an episode, by its number there.
type At = (Episode, usize);

/// States of an episode, the one among them that it ended in.
fn states(episode: &Episode) -> usize {
    episode.steps + 1
}

/// Cuts windows from some episodes of an environment.
pub fn cut_windows(
    environment: &dyn Environment,
    replay: &Replay,
    drawn: &[Episode],
    sample: SampleShape,
    generator: &mut Generator,
) -> Windows {
    let longest = drawn.iter().map(states).max().unwrap_or(0);
    let steps = sample.steps.min(longest);
    let sizes = WindowShape::of(environment.spec());
    let shape = WindowShape { windows: drawn.len(), steps, ..sizes };
    let mut windows = Windows::new(shape);
    windows.features.clear();
    // Every state of all windows, by episode and its number there.
    let places: Vec<Option<At>> = if longest <= sample.steps {
        padded(drawn, steps).collect()
    } else {
        stretches(drawn, steps, generator)
    };
    let seen = Observation::default();
    let mut writer = Writer { environment, replay, sample, windows, seen };
    for (state, place) in places.into_iter().enumerate() {
        match place {
            Some(place) => writer.write(state, place),
            None => (0..sizes.entities).for_each(|_| writer.windows.features.end_row()),
        }
    }
    writer.windows
}

/// Every episode as a window of its own, padded to the same length.
fn padded(episodes: &[Episode], steps: usize) -> impl Iterator<Item = Option<At>> {
    episodes.iter().flat_map(move |episode| {
        (0..steps).map(|at| (at < states(episode)).then_some((*episode, at)))
    })
}

/// One window from each of as many equal stretches of all states.
fn stretches(episodes: &[Episode], steps: usize, generator: &mut Generator) -> Vec<Option<At>> {
    let of = |episode: &Episode| {
        let episode = *episode;
        (0..states(&episode)).map(move |at| (episode, at))
    };
    let all: Vec<At> = episodes.iter().flat_map(of).collect();
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
    replay: &'a Replay,
    sample: SampleShape,
    windows: Windows,
    seen: Observation,
}

impl Writer<'_> {
    /// Writes a state of a window from one of an episode. Rows of features are added in order.
    fn write(&mut self, state: usize, (episode, at): At) {
        let place = episode.first.after(at);
        self.environment.observe(self.replay.state(place), 0, EntitySet::MAX, &mut self.seen);
        self.write_entities(state, place);
        self.write_agents(state, place, (at > 0).then(|| episode.first.after(at - 1)));
        let Self { environment, replay, windows, seen, .. } = self;
        windows.decision[state] = replay.steps.note(place).decision;
        windows.added[state] = replay.steps.note(episode.first).added;
        let tasks = windows.shape.tasks;
        for task in 0..tasks {
            let open = seen.open_tasks >> task & 1 == 1;
            windows.open[state * tasks + task] = open;
            windows.task_unfinished[state * tasks + task] = open;
        }
        if at < episode.steps {
            environment.observe(replay.state(place.after(1)), 0, 0, seen);
            self.write_outcome(state, place);
        } else {
            windows.task_terminated[state * tasks..][..tasks].fill(true);
        }
    }

    /// Features, existence and subtasks of all entities.
    fn write_entities(&mut self, state: usize, place: Place) {
        let Self { replay, windows, seen, .. } = self;
        let (first, allocation) = (state * windows.shape.entities, replay.allocation(place));
        for entity in 0..windows.shape.entities {
            let exists = seen.present >> entity & 1 == 1;
            windows.present[first + entity] = exists;
            if exists {
                windows.features.push_row(&seen.rows, seen.row_of(entity));
                let allocated = allocation.get(entity).copied();
                windows.entity_task[first + entity] =
                    allocated.unwrap_or_else(|| seen.task_of(entity));
            }
            windows.features.end_row();
        }
    }

    /// What the agents that exist observe, can do and did.
    fn write_agents(&mut self, state: usize, place: Place, before: Option<Place>) {
        let Self { replay, windows, seen, .. } = self;
        let WindowShape { agents, entities, .. } = windows.shape;
        let present = &windows.present[state * entities..][..entities];
        let did = |place: Place, agent: usize| replay.steps.actions(place)[agent] as u8;
        for agent in 0..seen.agents() {
            let own = state * agents + agent;
            // As they act and are deployed: of what shares their subtask agents see all that exists.
            windows.observable[own * entities..][..entities].copy_from_slice(present);
            windows.available[own] = seen.available[agent];
            windows.actions[own] = did(place, agent);
            windows.last_actions[own] = before.map_or(NO_ACTION, |before| did(before, agent));
            windows.last_allocation[own] =
                before.map_or(NO_TASK, |before| replay.allocation(before)[agent]);
        }
    }

    /// What the step from a state came to; the state behind it is seen.
    fn write_outcome(&mut self, state: usize, place: Place) {
        let Self { replay, windows, seen, sample, .. } = self;
        let WindowShape { steps, tasks, .. } = windows.shape;
        let own_tasks = state * tasks..(state + 1) * tasks;
        for (task, terminated) in windows.task_terminated[own_tasks.clone()].iter_mut().enumerate()
        {
            *terminated = seen.open_tasks >> task & 1 == 0;
        }
        let (rewards, end) = (replay.steps.rewards(place), replay.steps.end(place));
        windows.reward[state] = rewards.team;
        windows.task_reward[own_tasks].copy_from_slice(rewards.tasks);
        windows.reset[state] = end != End::Open;
        windows.terminated[state] = end == End::Over;
        windows.has_transition[state] = state % steps + 1 < steps;
        if sample.shaping != 0.0 {
            self.shape(state, place);
        }
    }

    /// Adds to the rewards of a step what its end is nearer than its beginning.
    fn shape(&mut self, state: usize, place: Place) {
        let Self { environment, replay, windows, sample, .. } = self;
        let SampleShape { shaping, discount, .. } = *sample;
        let WindowShape { agents, entities, tasks, .. } = windows.shape;
        let gain = |team: AgentSet, task: Option<usize>, ends: bool| {
            let potential = |place| environment.potential(replay.state(place), shaping, team, task);
            let before = potential(place);
            if ends { -before } else { discount * potential(place.after(1)) - before }
        };
        let present = &windows.present[state * entities..][..agents];
        let team = |task: Option<usize>| {
            let works = |agent: &usize| {
                let allocated = usize::from(replay.allocation(place)[*agent]);
                present[*agent] && task.is_none_or(|task| allocated == task)
            };
            (0..agents).filter(works).fold(0, |team, agent| team | 1 << agent)
        };
        for task in 0..tasks {
            let own = state * tasks + task;
            let team = team(Some(task));
            if team != 0 {
                let ends = windows.task_terminated[own];
                windows.task_reward[own] += gain(team, Some(task), ends);
            }
        }
        windows.reward[state] += gain(team(None), None, windows.terminated[state]);
    }
}
