//! Allocations that are proposed agent by agent: proposals that begin alike share what follows from it.

use super::trunk::NONE;

/// The first agents of a state, allocated. All proposals that begin so share it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prefix {
    /// The state, counted from the block's first.
    pub(super) state: u32,
    /// The prefix without the last agent, or [`NONE`].
    pub(super) parent: u32,
    /// Number of agents allocated.
    pub(super) level: u32,
    /// The subtask of the last of them.
    pub(super) task: u8,
    /// How many proposals begin so.
    pub(super) count: u32,
    /// Sum of the log-probabilities of the choices.
    pub(super) log_probability: f32,
}

/// The prefixes of all proposals of a block of states.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    tasks: usize,
    pub(super) prefixes: Vec<Prefix>,
    /// `[prefixes, T]`: the team at each subtask.
    teams: Vec<u32>,
    /// `[prefixes, T]`: log-probabilities of the next agent's choices; minus infinity where impossible.
    log_probabilities: Vec<f32>,
    /// `[prefixes, T]`: the longer prefix after each choice, or [`NONE`].
    longer: Vec<u32>,
    /// `[states, P]`: how far each proposal has come.
    pub(super) at: Vec<u32>,
}

impl Tree {
    /// Begins the proposals of some states, whose subtasks have the teams `roots [states, T]`.
    pub(super) fn begin(&mut self, proposals: usize, tasks: usize, roots: &[u32]) {
        self.tasks = tasks;
        self.prefixes.clear();
        self.teams.clear();
        self.log_probabilities.clear();
        self.longer.clear();
        self.at.clear();
        for (state, roots) in (0..).zip(roots.chunks_exact(tasks)) {
            let count = proposals as u32;
            let root =
                Prefix { state, parent: NONE, level: 0, task: 0, count, log_probability: 0.0 };
            let index = self.push(root, |teams| teams.extend_from_slice(roots));
            self.at.extend((0..proposals).map(|_| index));
        }
    }

    fn push(&mut self, prefix: Prefix, extend_teams: impl FnOnce(&mut Vec<u32>)) -> u32 {
        let index = self.prefixes.len() as u32;
        self.prefixes.push(prefix);
        extend_teams(&mut self.teams);
        let length = self.prefixes.len() * self.tasks;
        self.log_probabilities.resize(length, f32::NEG_INFINITY);
        self.longer.resize(length, NONE);
        index
    }

    /// The teams `[T]` of a prefix.
    pub(super) fn teams(&self, prefix: usize) -> &[u32] {
        &self.teams[prefix * self.tasks..][..self.tasks]
    }

    pub(super) fn log_probabilities(&self, prefix: usize) -> &[f32] {
        &self.log_probabilities[prefix * self.tasks..][..self.tasks]
    }

    pub(super) fn log_probabilities_mut(&mut self, prefix: usize) -> &mut [f32] {
        &mut self.log_probabilities[prefix * self.tasks..][..self.tasks]
    }

    /// Leads a proposal on; `team` is asked for the team after the choice where nobody chose it before.
    pub(super) fn choose(&mut self, proposal: usize, task: usize, team: impl FnOnce(u32) -> u32) {
        let from = self.at[proposal] as usize;
        let place = from * self.tasks + task;
        if self.longer[place] == NONE {
            let Prefix { state, level, log_probability, .. } = self.prefixes[from];
            let longer = Prefix {
                state,
                parent: from as u32,
                level: level + 1,
                task: task as u8,
                count: 0,
                log_probability: log_probability + self.log_probabilities[place],
            };
            let tasks = self.tasks;
            self.longer[place] = self.push(longer, |teams| {
                teams.extend_from_within(from * tasks..(from + 1) * tasks);
                let last = teams.len() - tasks + task;
                teams[last] = team(teams[last]);
            });
        }
        let next = self.longer[place];
        self.prefixes[next as usize].count += 1;
        self.at[proposal] = next;
    }

    /// A prefix and all shorter ones down to one agent.
    pub(super) fn way_back(&self, prefix: u32) -> impl Iterator<Item = &Prefix> {
        let at = |index: u32| self.prefixes.get(index as usize);
        std::iter::successors(at(prefix), move |prefix| at(prefix.parent))
            .take_while(|prefix| prefix.level > 0)
    }
}
