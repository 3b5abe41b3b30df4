//! Who shares networks, and where an agent's rows stand.

use std::ops::Range;

use sortie_envs::Spec;
use sortie_nn::layers::VisibleLists;

/// Agents that share a policy and a critic's own layers: those of a role, or one alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Its agents.
    pub agents: Range<usize>,
    /// Numbers that an agent observes.
    pub observed: usize,
    /// Whether the agent's index within the group follows them, as a row of zeros and a one.
    pub identity: bool,
    /// Actions of an agent.
    pub actions: usize,
}

impl Group {
    /// Columns of the networks' input.
    pub fn inputs(&self) -> usize {
        self.observed + if self.identity { self.agents.len() } else { 0 }
    }

    /// Of numbers with so many columns for each of its rows those of some records.
    pub(crate) fn rows<'a>(
        &self,
        numbers: &'a [f32],
        columns: usize,
        records: &Range<usize>,
    ) -> &'a [f32] {
        let of_record = columns * self.agents.len();
        &numbers[records.start * of_record..records.end * of_record]
    }

    /// Record and agent of each of its rows.
    pub(crate) fn order(&self, records: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let agents = self.agents.clone();
        (0..records).flat_map(move |record| agents.clone().map(move |agent| (record, agent)))
    }

    /// Where its rows stand among those of all groups, of so many records.
    pub(crate) fn places(&self, records: usize) -> Range<usize> {
        self.agents.start * records..self.agents.end * records
    }

    /// `[rows, actions]`: a one for each of these actions, among zeros.
    pub(crate) fn one_hot(&self, actions: &[u32]) -> Vec<f32> {
        let mut taken = vec![0.0; actions.len() * self.actions];
        for (taken, action) in taken.chunks_exact_mut(self.actions).zip(actions) {
            taken[*action as usize] = 1.0;
        }
        taken
    }
}

/// Numbers by groups, a row for each agent of each record.
pub type Rows = Vec<Vec<f32>>;

/// All agents, in their order.
///
/// Of a batch of records the rows of a group stand behind each other, record by record, and the groups behind each other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Groups(pub Vec<Group>);

impl Groups {
    /// One group for each role, or for each agent alone.
    pub fn new(spec: &Spec, shares: bool, identity: bool) -> Self {
        let all = 0..spec.shape.agents;
        let roles: Vec<_> = match &spec.roles[..] {
            [] => vec![(all, spec.shape.features, spec.shape.actions)],
            roles => roles
                .iter()
                .map(|role| (role.agents.clone(), role.features.len(), role.actions.len()))
                .collect(),
        };
        let groups = roles.into_iter().flat_map(|(agents, observed, actions)| {
            let size = if shares { agents.len() } else { 1 };
            agents.step_by(size.max(1)).map(move |first| Group {
                agents: first..first + size,
                observed,
                identity: identity && size > 1,
                actions,
            })
        });
        Self(groups.collect())
    }

    /// How many agents there are.
    pub fn agents(&self) -> usize {
        self.0.last().map_or(0, |group| group.agents.end)
    }

    /// For every row of so many records the rows of the other agents of its record, by their index.
    pub fn others(&self, records: usize) -> VisibleLists {
        let mut others = VisibleLists::default();
        for (record, agent) in self.0.iter().flat_map(|group| group.order(records)) {
            let rows = (0..self.agents()).filter(|other| *other != agent);
            rows.for_each(|other| others.push(self.row(records, record, other)));
            others.end_list();
        }
        others
    }

    /// For every row of so many records its record.
    pub fn records(&self, records: usize) -> Vec<u32> {
        let rows = self.0.iter().flat_map(|group| group.order(records));
        rows.map(|(record, _)| record as u32).collect()
    }

    fn row(&self, records: usize, record: usize, agent: usize) -> usize {
        let group = self.0.iter().find(|group| group.agents.contains(&agent));
        let agents = group.map_or(0..0, |group| group.agents.clone());
        agents.start * records + record * agents.len() + agent - agents.start
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(agents: Range<usize>) -> Group {
        Group { agents, observed: 3, identity: true, actions: 2 }
    }

    #[test]
    fn every_row_sees_the_others_of_its_record() {
        let groups = Groups(vec![group(0..2), group(2..3)]);
        let (others, records) = (groups.others(2), groups.records(2));
        // Agents 0 and 1 of record 0, of record 1; agent 2 of both.
        let lists: Vec<Vec<usize>> = (0..6).map(|row| others.list(row).collect()).collect();
        assert_eq!(lists, [[1, 4], [0, 4], [3, 5], [2, 5], [0, 1], [2, 3]]);
        assert_eq!(records, [0, 0, 1, 1, 0, 1]);
    }
}
