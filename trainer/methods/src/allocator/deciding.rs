//! One agent after the other points at a subtask, in any number of episodes that have the same subtasks.

use sortie_envs::{EntitySet, Environment, Observation, Random, UNASSIGNED, members};
use sortie_nn::layers::softmax;
use sortie_nn::tape::Tape;

use super::network::{Decisions, Network};
use crate::actor_critic::groups::drawn;

/// What one more subtask adds to sums, so that they are about 1.
const SUM_SCALE: f32 = 0.2;

/// The subtasks of an instance, which stay as they are for its whole episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Subtasks {
    /// `[subtasks]`: their numbers.
    tasks: Vec<u8>,
    /// `[subtasks, fixed]`: what does not change in the row of the first thing of each.
    pub(super) rows: Vec<f32>,
}

impl Subtasks {
    /// Those of a state, finished ones as well: it does not matter how far the episode is.
    fn of(seen: &Observation, fixed: usize) -> Self {
        let mut subtasks = Self::default();
        for thing in members(seen.things() & seen.entities) {
            let task = seen.task_of(thing);
            if task == UNASSIGNED || subtasks.tasks.contains(&task) {
                continue;
            }
            let first = subtasks.rows.len();
            subtasks.tasks.push(task);
            subtasks.rows.resize(first + fixed, 0.0);
            let row = seen.rows.row(seen.row_of(thing)).filter(|(column, _)| *column < fixed);
            row.for_each(|(column, value)| subtasks.rows[first + column] = value);
        }
        subtasks
    }

    pub(super) fn len(&self) -> usize {
        self.tasks.len()
    }

    /// Where a task stands; behind all of them one that is none.
    fn place(&self, task: u8) -> usize {
        self.tasks.iter().position(|known| *known == task).unwrap_or(self.tasks.len())
    }

    /// Adds the sum of the rows of some tasks: how much there is to do, which means do not tell.
    fn add_sum(&self, tasks: u32, contexts: &mut Vec<f32>) {
        let (first, columns) = (contexts.len(), self.rows.len() / self.len());
        contexts.resize(first + columns, 0.0);
        for place in self.places(tasks) {
            let sums = contexts[first..].iter_mut().zip(&self.rows[place * columns..]);
            sums.for_each(|(sum, value)| *sum += SUM_SCALE * value);
        }
    }

    /// Tasks by their places here.
    fn places(&self, tasks: u32) -> impl Iterator<Item = usize> + '_ {
        let place = move |(place, task): (usize, &u8)| (tasks >> task & 1 == 1).then_some(place);
        self.tasks.iter().enumerate().filter_map(place)
    }
}

/// A team that is being allocated.
#[derive(Clone, Debug)]
struct Team {
    /// `[A, d]`
    rows: Vec<f32>,
    /// `[A]`: what each agent can be given.
    offers: Vec<u32>,
    /// Subtasks for one agent alone.
    exclusive: u32,
    open: u32,
    /// Those of them that somebody was given.
    taken: u32,
    allocation: Vec<u8>,
}

impl Team {
    fn of(environment: &dyn Environment, state: &[u8], seen: &Observation) -> Self {
        let columns = environment.spec().shape.features;
        let mut offers = Vec::new();
        let exclusive = environment.offers(state, &mut offers);
        let mut rows = vec![0.0; columns * offers.len()];
        for agent in members(seen.acting().into()) {
            let row = &mut rows[agent * columns..][..columns];
            seen.rows.write_dense(seen.row_of(agent), row);
        }
        let allocation = vec![UNASSIGNED; offers.len()];
        Self { rows, offers, exclusive, open: seen.open_tasks, taken: 0, allocation }
    }

    fn row(&self, agent: usize) -> &[f32] {
        let columns = self.rows.len() / self.offers.len();
        &self.rows[agent * columns..][..columns]
    }

    /// What an agent can still be given. Of agents that are alike the first ones are given what one alone can have: whoever
    /// comes after one that was not leaves it, which loses no allocation but the same with names exchanged.
    fn options(&self, agent: usize) -> u32 {
        let options = self.offers[agent] & !self.taken;
        let passed = |twin: &usize| {
            let task = u32::from(self.allocation[*twin]);
            task < u32::BITS && self.exclusive >> task & 1 == 0
        };
        let has_twin = (0..agent).filter(passed).any(|twin| self.row(twin) == self.row(agent));
        let shared = options & !self.exclusive;
        if has_twin && shared != 0 { shared } else { options }
    }

    fn give(&mut self, agent: usize, task: u8) {
        self.allocation[agent] = task;
        self.taken |= 1 << task & self.exclusive;
    }

    /// Describes a decision about an agent that has these options.
    fn describe(
        &self,
        (agent, options): (usize, u32),
        subtasks: &Subtasks,
        decisions: &mut Decisions,
    ) {
        let columns = self.row(agent).len();
        let acts = |agent: &usize| self.offers[*agent] != 0;
        let [before, after] = [0..agent, agent + 1..self.offers.len()]
            .map(|agents| agents.filter(acts).collect::<Vec<_>>());
        decisions.contexts.extend(self.row(agent));
        self.add_mean(&before, &mut decisions.contexts);
        self.add_mean(&after, &mut decisions.contexts);
        decisions.contexts.push(after.len() as f32 / self.offers.len() as f32);
        let left = self.open & !self.taken;
        subtasks.add_sum(left, &mut decisions.contexts);
        subtasks.places(left).for_each(|place| decisions.seen.push(place));
        for other in before.into_iter().chain(after) {
            let row = decisions.agents.len() / columns;
            decisions.seen.push(subtasks.len() + row);
            decisions.agents.extend(self.row(other));
            decisions.given.push(subtasks.place(self.allocation[other]) as u32);
        }
        decisions.seen.end_list();
        let offered = subtasks.places(options).fold(0, |set, place| set | 1 << place);
        decisions.offered.push(offered);
    }

    /// Adds the mean row of some agents, zeros where there are none.
    fn add_mean(&self, agents: &[usize], contexts: &mut Vec<f32>) {
        let (first, share) = (contexts.len(), 1.0 / agents.len().max(1) as f32);
        contexts.resize(first + self.row(0).len(), 0.0);
        for agent in agents {
            let means = contexts[first..].iter_mut();
            means.zip(self.row(*agent)).for_each(|(mean, value)| *mean += share * value);
        }
    }
}

/// States of episodes with the same subtasks, each with the number of its episode.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) environment: &'a dyn Environment,
    /// The symmetry under which they are seen.
    pub(super) turn: usize,
    pub(super) states: &'a [(usize, &'a [u8])],
}

/// Episodes with the same subtasks at work: what is known of these, and the decisions that were made.
#[derive(Debug, Default)]
pub(super) struct Group {
    pub(super) subtasks: Subtasks,
    /// `[subtasks, 5 width]`
    tables: Vec<f32>,
    /// Decisions of all episodes.
    pub(super) made: Decisions,
    tape: Tape,
    /// Decisions about agents of one number.
    now: Decisions,
}

impl Group {
    /// Forgets what was decided, and by which weights subtasks were encoded.
    pub(super) fn forget(&mut self) {
        self.subtasks = Subtasks::default();
        self.made.clear();
    }

    /// Looks at the subtasks, unless they are those that were looked at last.
    fn encode(&mut self, (network, weights): (&Network, &[f32]), subtasks: Subtasks) {
        if subtasks == self.subtasks {
            return;
        }
        let mut pass = self.tape.begin(weights);
        let encoded = network.encode(&mut pass, &subtasks.rows);
        self.tables = pass.values(encoded).to_vec();
        self.subtasks = subtasks;
    }

    /// Allocates the agents of some states of these episodes, each by its number: `choose` picks a place among those that a
    /// decision offers, by the scores of all.
    pub(super) fn allocate(
        &mut self,
        (network, weights): (&Network, &[f32]),
        Seen { environment, turn, states }: Seen<'_>,
        mut choose: impl FnMut(&[f32], u32) -> usize,
    ) -> Vec<Vec<u8>> {
        let spec = environment.spec();
        let mut seen = Observation::default();
        let mut subtasks = Subtasks::default();
        let mut teams: Vec<Team> = Vec::new();
        for (_, state) in states {
            environment.observe(state, turn, EntitySet::MAX, &mut seen);
            if teams.is_empty() {
                subtasks = Subtasks::of(&seen, spec.fixed);
            }
            teams.push(Team::of(environment, state, &seen));
        }
        self.encode((network, weights), subtasks);
        let Self { tables, made, tape, now, .. } = self;
        for agent in 0..spec.shape.agents {
            now.clear();
            let mut deciding = Vec::new();
            for (team, (episode, _)) in teams.iter_mut().zip(states) {
                let options = team.options(agent);
                match options.count_ones() {
                    0 => {}
                    1 => team.give(agent, options.trailing_zeros() as u8),
                    _ => {
                        team.describe((agent, options), &self.subtasks, now);
                        now.episodes.push(*episode);
                        deciding.push(team);
                    }
                }
            }
            if deciding.is_empty() {
                continue;
            }
            let mut pass = tape.begin(weights);
            let known = pass.input(tables.len() / self.subtasks.len(), tables);
            let scores = network.scores(&mut pass, known, now);
            let scores = pass.values(scores).chunks_exact(self.subtasks.len());
            for ((scores, offered), team) in scores.zip(&now.offered).zip(deciding) {
                let place = choose(scores, *offered);
                now.chosen.push(place);
                team.give(agent, self.subtasks.tasks[place]);
            }
            made.append(now, self.subtasks.len(), spec.shape.features);
        }
        teams.into_iter().map(|team| team.allocation).collect()
    }
}

/// Draws a place by the softmax of the scores of those that are offered.
pub(super) fn draw(scores: &[f32], offered: u32, random: &mut Random) -> usize {
    drawn(&chances(scores, offered), sortie_envs::random::unit(random) as f32) as usize
}

/// The softmax of the scores of those places that are offered.
pub(super) fn chances(scores: &[f32], offered: u32) -> Vec<f32> {
    let masked = scores.iter().enumerate();
    let masked = masked.map(
        |(place, score)| {
            if offered >> place & 1 == 1 { *score } else { f32::NEG_INFINITY }
        },
    );
    let mut chances: Vec<f32> = masked.collect();
    softmax::forward(&mut chances);
    chances
}
