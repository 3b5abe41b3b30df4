//! One agent after the other points at a subtask, in any number of episodes that have the same subtasks.

use sortie_core::allocate::pointing::Round;
use sortie_envs::random::unit;
use sortie_envs::{EntitySet, Environment, Observation, Random, TaskSet, UNASSIGNED, members};
use sortie_learn::networks::{chances, drawn};
use sortie_nn::tape::Tape;

use super::network::{Critic, Decisions, Network};

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

    /// Tasks by their places here.
    fn places(&self, tasks: TaskSet) -> impl Iterator<Item = usize> + '_ {
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
    offers: Vec<TaskSet>,
    /// Subtasks for one agent alone.
    exclusive: TaskSet,
    open: TaskSet,
    before: Vec<u8>,
    allocation: Vec<u8>,
}

impl Team {
    fn of(environment: &dyn Environment, scene: &Asked<'_>, seen: &Observation) -> Self {
        let columns = environment.spec().shape.features;
        let mut offers = Vec::new();
        let exclusive = environment.offers(scene.state, &mut offers);
        let mut rows = vec![0.0; columns * offers.len()];
        for agent in members(seen.acting().into()) {
            let row = &mut rows[agent * columns..][..columns];
            seen.rows.write_dense(seen.row_of(agent), row);
        }
        let allocation = vec![UNASSIGNED; offers.len()];
        let (open, before) = (seen.open_tasks, scene.before.to_vec());
        Self { rows, offers, exclusive, open, before, allocation }
    }

    fn round(&self) -> Round<'_, TaskSet> {
        let columns = self.rows.len() / self.offers.len();
        let Self { rows, offers, exclusive, open, before, allocation } = self;
        let (exclusive, open) = (*exclusive, *open);
        Round { rows, stride: columns, columns, offers, exclusive, open, before, allocation }
    }

    /// Describes a decision about an agent that has these options.
    fn describe(
        &self,
        (agent, options): (usize, TaskSet),
        subtasks: &Subtasks,
        decisions: &mut Decisions,
    ) {
        let (round, fixed) = (self.round(), subtasks.rows.len() / subtasks.len());
        let (columns, left) = (round.columns, round.left());
        let first = decisions.contexts.len();
        decisions.contexts.resize(first + Round::context(columns, fixed), 0.0);
        let rows = subtasks.places(left).map(|place| &subtasks.rows[place * fixed..][..fixed]);
        round.describe(agent, rows, &mut decisions.contexts[first..]);
        let place = |agent| subtasks.place(round.subtask_of(agent)) as u32;
        decisions.own.push(place(agent));
        subtasks.places(left).for_each(|place| decisions.seen.push(place));
        for other in round.others(agent) {
            let (row, first) = (decisions.given.len(), decisions.agents.len());
            decisions.seen.push(subtasks.len() + row);
            decisions.agents.resize(first + columns + 1, 0.0);
            round.describe_other(agent, other, &mut decisions.agents[first..]);
            decisions.given.push(place(other));
        }
        decisions.seen.end_list();
        let offered = subtasks.places(options).fold(0, |set, place| set | 1 << place);
        decisions.offered.push(offered);
    }
}

/// A state in which agents are to be allocated.
#[derive(Clone, Copy)]
pub(super) struct Asked<'a> {
    pub(super) episode: usize,
    pub(super) state: &'a [u8],
    /// `[A]`: the allocation that was in force.
    pub(super) before: &'a [u8],
}

/// States of episodes with the same subtasks.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) environment: &'a dyn Environment,
    /// The symmetry under which they are seen.
    pub(super) turn: usize,
    pub(super) states: &'a [Asked<'a>],
}

/// Episodes with the same subtasks at work: what is known of these, and the decisions that were made.
#[derive(Debug, Default)]
pub(super) struct Group {
    pub(super) subtasks: Subtasks,
    /// `[subtasks, 6 width]`
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
        self.tables.clear();
        self.made.clear();
    }

    /// Encodes the subtasks, unless they are those that were encoded last.
    fn encode(&mut self, (network, weights): (&Network, &[f32])) {
        if self.tables.is_empty() {
            let mut pass = self.tape.begin_forward(weights);
            let encoded = network.encode(&mut pass, &self.subtasks.rows);
            self.tables = pass.values(encoded).to_vec();
        }
    }

    /// The teams of some states, whose subtasks are known from here on. They are encoded once somebody scores them.
    fn teams(&mut self, Seen { environment, turn, states }: Seen<'_>) -> Vec<Team> {
        let mut seen = Observation::default();
        let (mut teams, mut subtasks) = (Vec::new(), Subtasks::default());
        for asked in states {
            environment.observe(asked.state, turn, EntitySet::MAX, &mut seen);
            if teams.is_empty() {
                subtasks = Subtasks::of(&seen, environment.spec().fixed);
            }
            teams.push(Team::of(environment, asked, &seen));
        }
        if subtasks != self.subtasks {
            self.tables.clear();
            self.subtasks = subtasks;
        }
        teams
    }

    /// Allocates the agents of some states of these episodes, each by its number: `choose` picks a place among those that a
    /// decision offers, by the scores of all.
    pub(super) fn allocate(
        &mut self,
        network: (&Network, &[f32]),
        seen: Seen<'_>,
        mut choose: impl FnMut(&[f32], TaskSet) -> usize,
    ) -> Vec<Vec<u8>> {
        let mut teams = self.teams(seen);
        for agent in 0..seen.environment.spec().shape.agents {
            self.now.clear();
            let mut deciding = Vec::new();
            for (team, asked) in teams.iter_mut().zip(seen.states) {
                if self.has_choice(agent, team, asked.episode) {
                    deciding.push(team);
                }
            }
            if deciding.is_empty() {
                continue;
            }
            let scores = self.scores(network);
            let Self { subtasks, made, now, .. } = self;
            for (decision, team) in deciding.into_iter().enumerate() {
                let scores = &scores[decision * subtasks.len()..][..subtasks.len()];
                let place = choose(scores, now.offered[decision]);
                now.chosen.push(place);
                team.allocation[agent] = subtasks.tasks[place];
            }
            made.append(now, subtasks.len());
        }
        teams.into_iter().map(|team| team.allocation).collect()
    }

    /// Whether there is more than one subtask for an agent of a team: then the decision is described as the next one;
    /// otherwise it is given what there is.
    fn has_choice(&mut self, agent: usize, team: &mut Team, episode: usize) -> bool {
        let options = team.round().options(agent);
        if options.count_ones() > 1 {
            team.describe((agent, options), &self.subtasks, &mut self.now);
            self.now.episodes.push(episode);
            return true;
        }
        if options != 0 {
            team.allocation[agent] = options.trailing_zeros() as u8;
        }
        false
    }

    /// `[situations]`: what a critic makes of what it was described.
    pub(super) fn values(&mut self, (critic, weights): (&Critic, &[f32])) -> Vec<f32> {
        self.encode((&critic.network, weights));
        let Self { subtasks, tables, tape, made, .. } = self;
        let mut pass = tape.begin_forward(weights);
        let known = pass.input(tables.len() / subtasks.len(), tables);
        let values = critic.values(&mut pass, known, made);
        pass.values(values).to_vec()
    }

    /// `[decisions, subtasks]`: the scores of the decisions that were described.
    fn scores(&mut self, (network, weights): (&Network, &[f32])) -> Vec<f32> {
        self.encode((network, weights));
        let Self { subtasks, tables, tape, now, .. } = self;
        let mut pass = tape.begin_forward(weights);
        let known = pass.input(tables.len() / subtasks.len(), tables);
        let scores = network.scores(&mut pass, known, now);
        pass.values(scores).to_vec()
    }

    /// Draws so many allocations in each state; of each state those that are different, which begin alike as long as they are
    /// alike.
    pub(super) fn propose(
        &mut self,
        network: (&Network, &[f32]),
        seen: Seen<'_>,
        (count, random): (usize, &mut Random),
    ) -> Vec<Vec<Vec<u8>>> {
        let teams = self.teams(seen);
        // Of each state, and of how many proposals.
        let mut begun: Vec<(usize, usize, Team)> = Vec::new();
        begun.extend(teams.into_iter().enumerate().map(|(state, team)| (state, count, team)));
        for agent in 0..seen.environment.spec().shape.agents {
            self.now.clear();
            let mut next = Vec::with_capacity(begun.len());
            let mut deciding = Vec::new();
            for (state, count, mut team) in begun {
                let list = if self.has_choice(agent, &mut team, state) {
                    &mut deciding
                } else {
                    &mut next
                };
                list.push((state, count, team));
            }
            let scores = if deciding.is_empty() { Vec::new() } else { self.scores(network) };
            let subtasks = &self.subtasks;
            for (decision, (state, count, team)) in deciding.into_iter().enumerate() {
                let scores = &scores[decision * subtasks.len()..][..subtasks.len()];
                let chances = chances(scores, self.now.offered[decision]);
                let mut drawn_times = vec![0; subtasks.len()];
                (0..count).for_each(|_| drawn_times[drawn(&chances, unit(random) as f32)] += 1);
                for (place, count) in
                    drawn_times.into_iter().enumerate().filter(|(_, count)| *count > 0)
                {
                    let mut team = team.clone();
                    team.allocation[agent] = subtasks.tasks[place];
                    next.push((state, count, team));
                }
            }
            begun = next;
        }
        let mut proposals = vec![Vec::new(); seen.states.len()];
        begun.into_iter().for_each(|(state, _, team)| proposals[state].push(team.allocation));
        proposals
    }

    /// Describes the decisions that lead to these allocations, as if they had been made.
    pub(super) fn follow(&mut self, seen: Seen<'_>, allocations: &[Vec<u8>]) {
        self.made.clear();
        let teams = self.teams(seen);
        for (mut team, allocation) in teams.into_iter().zip(allocations) {
            for (agent, task) in allocation.iter().enumerate() {
                self.now.clear();
                if self.has_choice(agent, &mut team, 0) {
                    self.now.chosen.push(self.subtasks.place(*task));
                    self.made.append(&self.now, self.subtasks.len());
                }
                team.allocation[agent] = *task;
            }
        }
    }

    /// Describes states to a critic, each as the first of its agents sees all others, with what they were given there.
    pub(super) fn look(&mut self, seen: Seen<'_>, allocations: &[Vec<u8>]) {
        self.made.clear();
        let teams = self.teams(seen);
        for (mut team, allocation) in teams.into_iter().zip(allocations) {
            team.allocation.copy_from_slice(allocation);
            let first = team.offers.iter().position(|offer| *offer != 0).unwrap_or(0);
            self.now.clear();
            team.describe((first, 0), &self.subtasks, &mut self.now);
            self.now.episodes.push(0);
            self.now.chosen.push(0);
            self.made.append(&self.now, self.subtasks.len());
        }
    }
}
