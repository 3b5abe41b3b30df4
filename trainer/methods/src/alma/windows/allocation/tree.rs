//! Allocations are proposed agent by agent: proposals that begin alike share what follows from it, as a tree.
//!
//! A subtask with the agents that have joined it is a team. A team is computed once, whatever else the proposals around
//! it say.

use std::ops::Range;

use super::block::{Block, NONE};
use super::rows::COUNT_SCALE;

/// The logarithm of the probability of what cannot be chosen: none, yet a number that can be calculated with.
pub(super) const IMPOSSIBLE: f32 = -1e9;

/// Whether a choice is possible by the logarithm of its probability.
pub(super) fn is_possible(chance: f32) -> bool {
    chance > 0.5 * IMPOSSIBLE
}

/// One team at one subtask of one state.
#[derive(Clone, Copy, Debug)]
pub(super) struct Team {
    /// The team before the last agent joined, or [`NONE`].
    pub(super) before: u32,
    /// The last agent's row.
    pub(super) joined: u32,
    /// Where the product stands that all who join need, or [`NONE`].
    pub(super) product: u32,
    /// Agents, times [`COUNT_SCALE`].
    pub(super) size: f32,
    /// Other entities of the subtask, times [`COUNT_SCALE`].
    pub(super) others: f32,
}

/// The first agents of a state, allocated. All proposals that begin so share it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prefix {
    /// The state, counted from the block's first.
    pub(super) state: u32,
    /// The prefix without the last agent, or [`NONE`].
    pub(super) parent: u32,
    pub(super) level: u32,
    pub(super) task: u8,
    pub(super) count: u32,
    /// Its row among those of its level that are not whole.
    pub(super) row: u32,
    /// Sum of the log-probabilities of the choices.
    pub(super) log_probability: f32,
}

/// The logits that the prefixes of a level ask for, each of an agent at a team.
#[derive(Debug, Default)]
pub(super) struct Asked {
    pub(super) agents: Vec<u32>,
    pub(super) teams: Vec<u32>,
    /// `[prefixes, T]`: the logit of each choice; those behind the last are impossible.
    pub(super) places: Vec<u32>,
}

/// The prefixes of all proposals of a block of states, and their teams.
#[derive(Debug, Default)]
pub(super) struct Tree {
    tasks: usize,
    agents: usize,
    pub(super) prefixes: Vec<Prefix>,
    /// `[prefixes, T]`: the team at each subtask.
    teams_of: Vec<u32>,
    /// `[prefixes, T]`: the longer prefix after each choice, or [`NONE`].
    longer: Vec<u32>,
    /// `[states, P]`: how far each proposal has come.
    pub(super) at: Vec<u32>,
    pub(super) teams: Vec<Team>,
    /// `[teams, A]`: the team after the agent of each level has joined, or [`NONE`].
    after: Vec<u32>,
    /// The team that each product is about.
    pub(super) products_of: Vec<u32>,
}

impl Tree {
    /// Begins the proposals of a block, to whose subtasks nobody belongs yet.
    pub(super) fn begin(block: &Block, proposals: usize) -> Self {
        let mut tree = Self { tasks: block.tasks, agents: block.agents, ..Self::default() };
        for others in &block.others {
            let (before, joined, product) = (NONE, NONE, NONE);
            tree.push_team(Team { before, joined, product, size: 0.0, others: *others });
        }
        for (state, roots) in (0..).zip(block.open.chunks_exact(block.tasks)) {
            let count = proposals as u32;
            let (parent, log_probability) = (NONE, 0.0);
            let root =
                Prefix { state, parent, level: 0, task: 0, count, row: NONE, log_probability };
            let index = tree.push(root, |teams| teams.extend_from_slice(roots));
            tree.at.extend((0..proposals).map(|_| index));
        }
        tree
    }

    fn push(&mut self, prefix: Prefix, extend_teams: impl FnOnce(&mut Vec<u32>)) -> u32 {
        let index = self.prefixes.len() as u32;
        self.prefixes.push(prefix);
        extend_teams(&mut self.teams_of);
        let length = self.prefixes.len() * self.tasks;
        self.longer.resize(length, NONE);
        index
    }

    fn push_team(&mut self, team: Team) -> u32 {
        self.teams.push(team);
        self.after.resize(self.teams.len() * self.agents, NONE);
        (self.teams.len() - 1) as u32
    }

    /// Whether a prefix has allocated all agents of its state.
    fn is_whole(block: &Block, prefix: &Prefix) -> bool {
        prefix.level as usize == block.levels[prefix.state as usize]
    }

    /// Lists the logits that some prefixes of one level need for their next choices, each once.
    pub(super) fn ask(&mut self, block: &Block, prefixes: Range<usize>) -> Asked {
        let mut asked = Asked::default();
        let mut place_of = vec![NONE; self.teams.len()];
        let mut row = 0;
        for index in prefixes {
            let prefix = &mut self.prefixes[index];
            if Self::is_whole(block, prefix) {
                continue;
            }
            prefix.row = row;
            row += 1;
            let agent = block.agent(prefix.state, prefix.level);
            for team in &self.teams_of[index * self.tasks..][..self.tasks] {
                let place = place_of.get_mut(*team as usize).map_or(NONE, |place| {
                    if *place == NONE {
                        *place = asked.teams.len() as u32;
                        asked.teams.push(*team);
                        asked.agents.push(agent);
                    }
                    *place
                });
                asked.places.push(place);
            }
        }
        let behind = asked.teams.len() as u32;
        asked.places.iter_mut().filter(|place| **place == NONE).for_each(|place| *place = behind);
        asked
    }

    /// Leads a proposal on by the choice for an agent, whose logarithm of a probability this is; where nobody has chosen so
    /// before, the agent joins the team, if others `follow` who see it there.
    pub(super) fn choose(
        &mut self,
        proposal: usize,
        (task, chance): (usize, f32),
        (agent, follow): (u32, bool),
    ) {
        let from = self.at[proposal] as usize;
        let place = from * self.tasks + task;
        if self.longer[place] == NONE {
            let Prefix { state, level, log_probability, .. } = self.prefixes[from];
            let team = self.teams_of[place];
            let team = if follow { self.join(team, level, agent) } else { team };
            let longer = Prefix {
                state,
                parent: from as u32,
                level: level + 1,
                task: task as u8,
                count: 0,
                row: NONE,
                log_probability: log_probability + chance,
            };
            let tasks = self.tasks;
            self.longer[place] = self.push(longer, |teams| {
                teams.extend_from_within(from * tasks..(from + 1) * tasks);
                let last = teams.len() - tasks + task;
                teams[last] = team;
            });
        }
        let next = self.longer[place];
        self.prefixes[next as usize].count += 1;
        self.at[proposal] = next;
    }

    /// The team after a level's agent, who is a row, has joined.
    fn join(&mut self, team: u32, level: u32, row: u32) -> u32 {
        let place = team as usize * self.agents + level as usize;
        if self.after[place] == NONE {
            let before = &mut self.teams[team as usize];
            if before.product == NONE {
                before.product = self.products_of.len() as u32;
                self.products_of.push(team);
            }
            let Team { size, others, .. } = *before;
            let size = size + COUNT_SCALE;
            self.after[place] =
                self.push_team(Team { before: team, joined: row, product: NONE, size, others });
        }
        self.after[place]
    }

    /// A prefix and all shorter ones down to one agent.
    pub(super) fn way_back(&self, prefix: u32) -> impl Iterator<Item = &Prefix> {
        let at = |index: u32| self.prefixes.get(index as usize);
        std::iter::successors(at(prefix), move |prefix| at(prefix.parent))
            .take_while(|prefix| prefix.level > 0)
    }
}
