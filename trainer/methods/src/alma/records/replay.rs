//! What was seen: states with what was decided and done in them. A sample is a state and one subtask in it that was open and
//! had a team.
//!
//! A subtask earns for up to n steps from a state on. Its team is worth nothing any more once the subtask is finished; else
//! what follows is the value of the team of that state in the state n steps later, or in an earlier one in which the subtask
//! has another team, or in which time runs out.
//!
//! Without subtasks everybody is the team of one, which earns the whole team's rewards until the episode is over.

use serde::{Deserialize, Serialize};
use sortie_envs::random::below;
use sortie_envs::{AgentSet, EntitySet, Observation, Random, Spec, deployed_tasks, members};
use sortie_learn::trajectory::{Capacity, End, Future, Place, Widths};
use sortie_learn::{LearnError, State, Trajectories, Transition};

use super::config::{Config, ReturnsConfig};
use crate::alma::agents::Conditioning;

/// A state, with what each agent slot `[A]` was allocated to in it, had done before and did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment<'a> {
    /// The state.
    pub state: &'a [u8],
    /// The subtask of every agent, [`UNASSIGNED`](sortie_envs::UNASSIGNED) where it has none.
    pub allocation: &'a [u8],
    /// What every agent had done before.
    pub last_actions: &'a [u8],
    /// What every agent did.
    pub actions: &'a [u8],
}

impl<'a> Moment<'a> {
    /// As trajectories keep it: the state, and behind it three bytes for each agent.
    pub fn bytes(self) -> Vec<u8> {
        [self.state, self.allocation, self.last_actions, self.actions].concat()
    }

    /// What was kept so, of so many agents.
    pub fn read(bytes: &'a [u8], agents: usize) -> Self {
        let (bytes, actions) = bytes.split_at(bytes.len() - agents);
        let (bytes, last_actions) = bytes.split_at(bytes.len() - agents);
        let (state, allocation) = bytes.split_at(bytes.len() - agents);
        Self { state, allocation, last_actions, actions }
    }

    /// The agents at a subtask.
    pub fn team(self, task: usize) -> AgentSet {
        let at = |(agent, own): (usize, &u8)| AgentSet::from(usize::from(*own) == task) << agent;
        self.allocation.iter().enumerate().map(at).sum()
    }
}

/// What became of the subtasks in a step, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Worked {
    /// Those that were open and had a team: a sample each.
    samples: u32,
    /// Those of them that are not open behind the step.
    closed: u32,
    /// Those whose team is not that of the step before.
    moved: u32,
}

/// A team in a state, with what it did and what followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<'a> {
    /// The team's subtask.
    pub task: usize,
    /// The subtask's things.
    pub things: EntitySet,
    /// When it acted.
    pub now: Moment<'a>,
    /// The discounted rewards until the next moment.
    pub reward: f32,
    /// What the value of the same team there counts; 0 where there is nothing to come.
    pub discount: f32,
    /// The state to bootstrap from.
    pub next: Moment<'a>,
}

/// The samples of a run, the newest of each instance.
#[derive(Debug)]
pub struct Replay {
    conditioning: Conditioning,
    returns: ReturnsConfig,
    agents: usize,
    tasks: usize,
    /// Samples that are kept of each instance at most.
    most: usize,
    steps: Trajectories<Worked>,
    /// How many there are, by instance.
    samples: Vec<usize>,
}

/// Bytes of a set of entities.
const SET: usize = size_of::<EntitySet>();

/// How often what is missing is drawn again before there seems to be none.
const ROUNDS: usize = 1_000;

impl Replay {
    /// Room for what a configuration wants to keep of an environment.
    pub fn new(config: &Config, spec: &Spec) -> Self {
        let (conditioning, instances) = (config.network.subtask, config.environment.instances);
        let (agents, most) = (spec.shape.agents, config.replay.capacity / instances);
        let tasks = if conditioning.has_subtasks() { spec.shape.tasks } else { 1 };
        let widths = Widths { tasks, ..Widths::default() };
        Self {
            conditioning,
            returns: config.returns.clone(),
            agents,
            tasks,
            most,
            steps: Trajectories::noting(Capacity::States(most), instances, widths),
            samples: vec![0; instances],
        }
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.samples.iter().sum()
    }

    /// Whether there are so many samples, and some that as much followed as one looks ahead.
    pub fn has(&self, samples: usize) -> bool {
        self.samples() >= samples && self.steps.can_draw(self.returns.steps as usize)
    }

    /// Adds a step, and forgets the oldest of its instance: what there was to see in the state, the subtasks that are open
    /// behind the step, and who acted for what then and in the step before, which is nothing at the begin of an episode.
    pub fn push(
        &mut self,
        transition: &Transition<'_>,
        (seen, open_then): (&Observation, u32),
        (moment, before): (Moment<'_>, &[u8]),
    ) {
        let everybody: Vec<u8>;
        let moment = if self.conditioning.has_subtasks() {
            moment
        } else {
            let agents = 0..moment.allocation.len();
            let exists = |agent| if agent < seen.agents() { 0 } else { u8::MAX };
            everybody = agents.map(exists).collect();
            Moment { allocation: &everybody, ..moment }
        };
        let (worked, rewards) = self.worked(transition, (seen, open_then), (moment, before));
        let mut state = moment.bytes();
        for task in members(worked.samples.into()) {
            state.extend(seen.things_of(task).to_le_bytes());
        }
        let Moment { actions, .. } = moment;
        let last = Moment { state: transition.next, last_actions: actions, ..moment };
        let next = if transition.step.done() { last.bytes() } else { Vec::new() };
        let kept = Transition { state: &state, task_rewards: &rewards, next: &next, ..*transition };
        self.steps.push_noted(&kept, worked);
        let samples = &mut self.samples[transition.instance];
        *samples += worked.samples.count_ones() as usize;
        while *samples > self.most {
            let oldest = self.steps.oldest(transition.instance);
            *samples -= self.steps.note(oldest).samples.count_ones() as usize;
            self.steps.forget(oldest);
        }
    }

    /// What became of the subtasks, and what each has earned: shaped, the difference of its team's potentials is part of it.
    fn worked(
        &self,
        transition: &Transition<'_>,
        (seen, open_then): (&Observation, u32),
        (moment, before): (Moment<'_>, &[u8]),
    ) -> (Worked, Vec<f64>) {
        let Transition { environment, step, task_rewards, next, .. } = *transition;
        let has_subtasks = self.conditioning.has_subtasks();
        let bit = |task: &u8| 1_u32.checked_shl((*task).into()).unwrap_or(0);
        let [open, then] =
            if has_subtasks { [deployed_tasks(seen.open_tasks), open_then] } else { [1; 2] };
        let samples = open & moment.allocation.iter().fold(0, |teams, task| teams | bit(task));
        let changed = moment.allocation.iter().zip(before).filter(|(own, before)| own != before);
        let moved = changed.fold(0, |moved, (own, before)| moved | bit(own) | bit(before));
        let moved = if has_subtasks { moved } else { 0 };
        let worked = Worked { samples, closed: samples & !then, moved };
        let mut rewards = vec![step.reward];
        if has_subtasks {
            rewards.clear();
            rewards.extend_from_slice(task_rewards);
        }
        let ReturnsConfig { discount, shaping, .. } = self.returns;
        if shaping != 0.0 {
            for task in members(samples.into()) {
                let (team, at) = (moment.team(task), has_subtasks.then_some(task));
                let potential = |state| environment.potential(state, shaping, team, at);
                let goes_on = worked.closed >> task & 1 == 0 && !step.terminated;
                let later = if goes_on { discount * potential(next) } else { 0.0 };
                rewards[task] += f64::from(later - potential(moment.state));
            }
        }
        (worked, rewards)
    }

    /// Draws so many samples, each as likely as any other: states and a subtask in each. There are fewer where there seem
    /// to be none.
    pub fn draw(&self, count: usize, random: &mut Random, drawn: &mut Vec<(Place, u8)>) {
        let steps = self.returns.steps as usize;
        drawn.clear();
        for _ in 0..ROUNDS {
            let found = drawn.len();
            let any = |_| (self.steps.draw_any(steps, random), below(random, self.tasks) as u8);
            drawn.extend((found..count).map(any));
            // Looked at one behind the other without a question, all are on their way from memory at the same time.
            let note = |place| self.steps.note(place).samples;
            let read = drawn[found..].iter().fold(0, |sum, (place, _)| sum ^ note(*place));
            std::hint::black_box(read);
            drawn.retain(|(place, task)| note(*place) >> task & 1 == 1);
            if drawn.len() == count {
                break;
            }
        }
    }

    /// Reads a little of each of these samples, for the same reason.
    pub fn fetch(&self, samples: impl Iterator<Item = (Place, u8)> + Clone) {
        let ahead = self.returns.steps as usize;
        let next = |place: Place| self.steps.note(place.after(ahead)).samples;
        std::hint::black_box(samples.clone().fold(0, |sum, (place, _)| sum ^ next(place)));
        let both = |place: Place| self.steps.fetch(place) ^ self.steps.fetch(place.after(ahead));
        std::hint::black_box(samples.fold(0, |sum, (place, _)| sum ^ both(place)));
    }

    /// A sample that was drawn.
    pub fn sample(&self, (place, task): (Place, u8)) -> Sample<'_> {
        let task = usize::from(task);
        let Future { place: next, reward, discount } = self.future(place, task);
        let ((now, things), (next, _)) = (self.moment(place), self.moment(next));
        let before = self.steps.note(place).samples & ((1 << task) - 1);
        let things = things.get(before.count_ones() as usize);
        let things = things.map_or(0, |bytes| EntitySet::from_le_bytes(*bytes));
        Sample { task, things, now, reward, discount, next }
    }

    /// A state, and behind it the things of each subtask that is a sample, as they were pushed.
    fn moment(&self, place: Place) -> (Moment<'_>, &[[u8; SET]]) {
        let bytes = self.steps.state(place);
        let things = SET * self.steps.note(place).samples.count_ones() as usize;
        let (moment, things) = bytes.split_at(bytes.len() - things);
        (Moment::read(moment, self.agents), things.as_chunks().0)
    }

    fn future(&self, place: Place, task: usize) -> Future {
        let ReturnsConfig { steps, discount, .. } = self.returns;
        let is = |tasks: u32| tasks >> task & 1 == 1;
        let earned = |place| {
            let is_closed = is(self.steps.note(place).closed);
            let end = if is_closed { End::Over } else { self.steps.end(place) };
            (self.steps.rewards(place).tasks[task], end)
        };
        let has_moved = |place| is(self.steps.note(place).moved);
        self.steps.future_of(place, steps as usize, discount, earned, has_moved)
    }

    /// Names all of it.
    ///
    /// # Errors
    /// A checkpoint has none, or one of another size.
    pub fn visit(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        state.value("samples", &mut self.samples)?;
        self.steps.visit_as(state, "records")
    }
}

#[cfg(test)]
mod tests;
