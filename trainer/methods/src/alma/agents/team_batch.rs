//! Teams and what they see, written as input of the utility network.
//!
//! The subtask mask of ALMA lets an agent see its own team and its own subtask only (dissertation
//! section 7.3). Without the mask an agent sees everything.

use sortie_envs::random::shuffle;
use sortie_envs::{AgentSet, EntitySet, Observation, Shape, SparseRows, UNASSIGNED, members};
use sortie_learn::networks::{Targets, Teams};
use sortie_learn::subtasks::NO_ACTION;
use sortie_learn::words;
use sortie_nn::random::Generator;

use super::utility::UtilityInput;

words! {
    /// How agents and mixer are conditioned on subtasks (dissertation section 7.3 and the comparisons of figure 7.4).
    #[derive(Default)]
    Conditioning {
        /// An agent sees its own team and building only: ALMA.
        #[default]
        Mask = "mask",
        /// An agent sees everything, each entity marked with its subtask: "no mask".
        Input = "input",
        /// There are no subtasks: everybody sees everything and earns the whole team's reward.
        None = "none",
    }
}

impl Conditioning {
    /// As the configuration has it.
    pub fn name(self) -> &'static str {
        Self::WORDS[self as usize]
    }

    /// Whether teams work on subtasks of their own.
    pub fn has_subtasks(self) -> bool {
        self != Self::None
    }

    /// Columns that mark an entity's subtask, where there are at most so many of them.
    pub fn task_columns(self, tasks: usize) -> usize {
        if self == Self::Input { tasks } else { 0 }
    }
}

/// What the columns of a row are: an entity's features, its last action as one-hot, and where entities are marked with
/// their subtask, the marks; and what actions aim at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Columns {
    features: usize,
    actions: usize,
    targets: Targets,
}

impl Columns {
    /// Those of an environment, for a head that points at these.
    pub fn of(shape: &Shape, targets: Targets) -> Self {
        Self { features: shape.features, actions: shape.actions, targets }
    }

    /// Their number without marks, and the first of the marks.
    pub fn unmarked(self) -> usize {
        self.features + self.actions
    }
}

/// Any number of teams, each with what its agents see.
#[derive(Clone, Debug, Default)]
pub struct TeamBatch {
    conditioning: Conditioning,
    columns: Columns,
    input: UtilityInput,
    /// What the teams see besides themselves.
    others: SparseRows,
    /// How agents stand to what they may aim at, a row each.
    related: SparseRows,
    /// The entity of every row, agents' and others'.
    entities: [Vec<u8>; 2],
    /// Agents in all teams, and rows in `others`, up to each team's end.
    ends: Vec<(u32, u32)>,
    /// The team of every agent that is in one.
    numbers: Vec<u32>,
    /// Agents of each team.
    sizes: Vec<f32>,
}

impl TeamBatch {
    /// Columns of a row where there are so many subtasks.
    pub fn columns(&self, tasks: usize) -> usize {
        self.columns.unmarked() + self.conditioning.task_columns(tasks)
    }

    /// Forgets all teams, keeps the memory; those from here on are conditioned on subtasks so, and rows have these columns.
    pub fn clear(&mut self, conditioning: Conditioning, columns: Columns) {
        (self.conditioning, self.columns) = (conditioning, columns);
        let targets = columns.targets;
        self.input.clear();
        self.input.aims.aim_at(targets.entities(), targets.pairs());
        self.others.clear();
        self.related.clear();
        self.entities.iter_mut().for_each(Vec::clear);
        self.ends.clear();
    }

    /// Adds a team, whose agents see each other and the entities in sight, of all of whom `seen` has rows. The last action of
    /// each agent, and the subtask of each entity, are told by their numbers.
    ///
    /// How an agent stands to what it may aim at is left out of its row, which would tell of what it does not see.
    pub fn push_team(
        &mut self,
        seen: &Observation,
        (team, sight): (AgentSet, EntitySet),
        last_action: impl Fn(usize) -> u8,
        task: impl Fn(usize) -> u8,
    ) {
        let team = EntitySet::from(team);
        let pairs = self.columns.targets.pairs();
        for (row, entity) in members(seen.entities).enumerate() {
            let [agents, others] = &mut self.entities;
            let (rows, entities) = match (team >> entity & 1, sight >> entity & 1) {
                (1, _) => (&mut self.input.rows, agents),
                (_, 1) => (&mut self.others, others),
                _ => continue,
            };
            entities.push(entity as u8);
            let is_agent = entity < seen.observable.len();
            if is_agent && !pairs.is_empty() {
                let is_pair = |(column, _): &(usize, f32)| pairs.contains(column);
                let own = seen.rows.row(row);
                own.clone().filter(|it| !is_pair(it)).for_each(|(c, value)| rows.push(c, value));
                if team >> entity & 1 == 1 {
                    own.filter(is_pair).for_each(|(c, value)| self.related.push(c, value));
                    self.related.end_row();
                }
            } else {
                rows.push_row(&seen.rows, row);
            }
            let last_action = if is_agent { last_action(entity) } else { NO_ACTION };
            if last_action != NO_ACTION {
                rows.push(self.columns.features + usize::from(last_action), 1.0);
            }
            // A mark, where there are columns for that.
            if self.conditioning == Conditioning::Input && task(entity) != UNASSIGNED {
                rows.push(self.columns.unmarked() + usize::from(task(entity)), 1.0);
            }
            rows.end_row();
        }
        self.ends.push((self.input.rows.len() as u32, self.others.len() as u32));
    }

    /// Adds every team of a state of which everything was observed. `added` is told the agents in the order of their
    /// rows.
    ///
    /// Without the subtask mask everybody sees the same, so that all agents are one team here.
    pub fn push_teams(
        &mut self,
        seen: &Observation,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        let last_action = |agent: usize| last_actions[agent];
        if self.conditioning != Conditioning::Mask {
            let task = |entity: usize| match allocation.get(entity) {
                Some(task) if entity < seen.observable.len() => *task,
                _ => seen.task_of(entity),
            };
            let everybody = (seen.present & !seen.things()) as AgentSet;
            self.push_team(seen, (everybody, seen.present), last_action, task);
            (0..seen.agents()).for_each(added);
            return;
        }
        for task in 0..seen.tasks() {
            let at = |agent: &usize| usize::from(allocation[*agent]) == task;
            let team = (0..seen.agents()).filter(at);
            let set = team.clone().fold(0, |set: AgentSet, agent| set | 1 << agent);
            if set != 0 {
                self.push_team(seen, (set, seen.things_of(task)), last_action, |_| task as u8);
                team.for_each(&mut added);
            }
        }
    }

    /// Adds the agents of a state that are in no team, once all teams have been added: each sees nothing.
    pub fn push_unassigned(
        &mut self,
        seen: &Observation,
        allocation: &[u8],
        last_actions: &[u8],
        mut added: impl FnMut(usize),
    ) {
        if self.conditioning != Conditioning::Mask {
            return;
        }
        for (agent, task) in allocation.iter().enumerate().take(seen.agents()) {
            if usize::from(*task) >= seen.tasks() {
                self.push_team(seen, (1 << agent, 0), |agent| last_actions[agent], |_| UNASSIGNED);
                self.ends.pop();
                added(agent);
            }
        }
    }

    /// Writes what each agent sees. No team may be added afterwards.
    ///
    /// Agents after the last closed team have no subtask and see nothing.
    pub fn finish(&mut self) -> &UtilityInput {
        let UtilityInput { rows, visible, aims } = &mut self.input;
        let [of_agents, of_others] = &self.entities;
        let mut places = [0; EntitySet::BITS as usize];
        let agents = rows.len();
        rows.append(&self.others);
        let (mut agent, mut other) = (0, agents);
        self.numbers.clear();
        self.sizes.clear();
        for (number, (agent_end, other_end)) in self.ends.iter().enumerate() {
            let members = agent..*agent_end as usize;
            self.numbers.extend(members.clone().map(|_| number as u32));
            self.sizes.push(members.len() as f32);
            let others = other..agents + *other_end as usize;
            let entities = of_agents[members.clone()]
                .iter()
                .chain(&of_others[other - agents..others.end - agents]);
            let mut seen: EntitySet = 0;
            for (entity, row) in entities.zip(members.clone().chain(others.clone())) {
                places[usize::from(*entity)] = row;
                seen |= 1 << entity;
            }
            for query in members.clone() {
                visible.push_parts(members.clone().chain(others.clone()), std::iter::empty());
                let related =
                    if self.related.is_empty() { rows.row(query) } else { self.related.row(query) };
                aims.push((query as u32, related), seen, |entity| places[entity]);
            }
            (agent, other) = (members.end, others.end);
        }
        (agent..agents).for_each(|_| visible.end_list());
        &self.input
    }

    /// The teams of a finished batch, of whose agents each is in one: what mixers mix.
    pub fn teams(&self) -> Teams<'_> {
        Teams { known: self.input.view(), numbers: &self.numbers, sizes: &self.sizes }
    }

    /// The input as [`finish`](Self::finish) left it.
    pub fn input(&self) -> &UtilityInput {
        &self.input
    }
}

/// Which mark stands for which subtask: the column of subtask t at place t.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskOrder(pub Vec<u16>);

impl TaskOrder {
    /// Every subtask has the mark of its number: how agents are deployed.
    pub fn identity(tasks: usize) -> Self {
        Self((0..tasks as u16).collect())
    }

    /// Draws an order of so many subtasks and spare marks.
    pub fn shuffled(tasks: usize, generator: &mut Generator) -> Self {
        let mut columns: Vec<u16> = (0..tasks as u16).collect();
        shuffle(generator, &mut columns);
        Self(columns)
    }
}

#[cfg(test)]
mod tests {
    use sortie_learn::networks::Aims;

    use super::*;

    const FEATURES: usize = 3;
    const COLUMNS: Columns = Columns { features: FEATURES, actions: 5, targets: Targets::NONE };

    /// Agents of four slots that exist, and two things, one for each subtask; row e is e + 1 in column 0.
    fn seen(agents: usize) -> Observation {
        let present: EntitySet = 0b11 << 4 | ((1 << agents) - 1);
        let mut rows = SparseRows::default();
        members(present).for_each(|entity| rows.push_dense(&[entity as f32 + 1.0, 0.0, 0.0]));
        Observation {
            entities: present,
            rows,
            present,
            absent: 0,
            observable: vec![present; 4],
            entity_task: vec![0, 0, 0, 0, 0b01, 0b10],
            available: vec![1; 4],
            open_tasks: 0b11,
        }
    }

    #[test]
    fn agents_see_their_team_and_subtask_only() {
        let (seen, mut batch) = (seen(4), TeamBatch::default());
        batch.clear(Conditioning::Mask, COLUMNS);
        let (allocation, last) = ([0, 0, 1, UNASSIGNED], [NO_ACTION, 3, NO_ACTION, NO_ACTION]);
        let mut order = Vec::new();
        batch.push_teams(&seen, &allocation, &last, |agent| order.push(agent));
        batch.push_unassigned(&seen, &allocation, &last, |agent| order.push(agent));
        assert_eq!(order, [0, 1, 2, 3]);
        let input = batch.finish();

        let features = |row| input.rows.row(row).next();
        let entities = (0..input.rows.len()).map(|row| features(row).unwrap().1 as usize - 1);
        assert!(entities.eq(0..6));
        let lists = |query| input.visible.list(query).collect::<Vec<_>>();
        assert_eq!(lists(0), [0, 1, 4]);
        assert_eq!(lists(1), [0, 1, 4]);
        assert_eq!(lists(2), [2, 5]);
        assert!(lists(3).is_empty());
        let last_actions =
            |row| input.rows.row(row).filter(|(c, _)| *c >= FEATURES).collect::<Vec<_>>();
        assert!(last_actions(0).is_empty());
        assert_eq!(last_actions(1), [(FEATURES + 3, 1.0)]);
    }

    /// Of agents 0 and 1 the columns 1 and 2 say how they stand to the entities 4 and 5.
    #[test]
    fn what_is_told_of_pairs_is_for_what_is_seen_alone() {
        let targets = Targets { first: 4, count: 2, first_pair: 1, pair_features: 1 };
        let mut seen = seen(2);
        seen.rows.clear();
        [[1.0, 7.0, 8.0], [2.0, 9.0, 0.0], [5.0; 3], [6.0; 3]]
            .iter()
            .for_each(|row| seen.rows.push_dense(row));
        let mut batch = TeamBatch::default();
        batch.clear(Conditioning::Mask, Columns { targets, ..COLUMNS });
        batch.push_teams(&seen, &[0, 1], &[NO_ACTION; 2], |_| ());
        let input = batch.finish();
        let rows: Vec<Vec<_>> = (0..4).map(|row| input.rows.row(row).collect()).collect();
        assert_eq!(rows[..2], [[(0, 1.0)], [(0, 2.0)]]);
        assert_eq!(rows[2], [(0, 5.0), (1, 5.0), (2, 5.0)]);
        // Agent 0 sees entity 4 alone, which is row 2, agent 1 entity 5, to which nothing stands.
        let mut want = Aims::default();
        want.aim_at(targets.entities(), targets.pairs());
        let own = |values: [f32; 2]| [(1, values[0]), (2, values[1])].into_iter();
        want.push((0, own([7.0, 8.0])), 1 << 4, |_| 2);
        want.push((1, own([9.0, 0.0])), 1 << 5, |_| 3);
        assert_eq!(input.aims, want);
    }

    #[test]
    fn without_the_mask_everybody_sees_everything() {
        let seen = seen(2);
        for (conditioning, marks) in [
            (Conditioning::Input, [Some(1), None, Some(0), Some(1)]),
            (Conditioning::None, [None; 4]),
        ] {
            let mut batch = TeamBatch::default();
            batch.clear(conditioning, COLUMNS);
            let mut order = Vec::new();
            batch.push_teams(&seen, &[1, UNASSIGNED], &[3, 4], |agent| order.push(agent));
            batch.push_unassigned(&seen, &[1, UNASSIGNED], &[3, 4], |agent| order.push(agent));
            assert_eq!(order, [0, 1]);
            let input = batch.finish();
            for query in 0..2 {
                assert!(input.visible.list(query).eq(0..4));
            }
            let first = COLUMNS.unmarked();
            let mark = |row| {
                let columns = input.rows.row(row).map(|(column, _)| column);
                columns.filter(|column| *column >= first).collect::<Vec<_>>()
            };
            for (row, task) in marks.into_iter().enumerate() {
                assert_eq!(mark(row), Vec::from_iter(task.map(|task: usize| first + task)));
            }
        }
    }
}
