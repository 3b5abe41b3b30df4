//! Teams at subtasks, written as input of the team-value network.

use sortie_envs::{EntitySet, Environment, Observation, SparseRows, Spec, members};

use crate::alma::agents::{UtilityInput, UtilityShape};
use crate::alma::records::config::AllocatorConfig;

/// What the columns of a row are: an entity's features, its part in the question, its relation to the subtask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TeamColumns {
    features: usize,
    relations: usize,
}

impl TeamColumns {
    /// Those of an environment.
    pub fn of(spec: &Spec) -> Self {
        Self { features: spec.shape.features, relations: spec.relations }
    }

    /// Their number.
    pub fn count(self) -> usize {
        self.relation() + self.relations
    }

    /// Marks the subtask's thing that the value is about.
    pub(in crate::alma::records) fn own(self) -> usize {
        self.features
    }

    /// Marks the agents of the team.
    fn in_team(self) -> usize {
        self.features + 1
    }

    /// First of the columns that say how an entity stands to the subtask.
    pub(in crate::alma::records) fn relation(self) -> usize {
        self.features + 2
    }
}

impl AllocatorConfig {
    /// The network's shape in an environment: one output, the value.
    pub fn shape(&self, spec: &Spec) -> UtilityShape {
        self.network.shape(TeamColumns::of(spec).count(), 1)
    }
}

/// A team at a subtask.
#[derive(Clone, Copy, Debug)]
pub struct TeamQuery<'a> {
    /// The state.
    pub state: &'a [u8],
    /// The subtask, which is open.
    pub task: usize,
    /// Bit a set where agent a is in the team.
    pub team: u64,
    /// Number of the symmetry under which the state is seen.
    pub turn: usize,
}

impl TeamQuery<'_> {
    /// Whether it looks at the same things as another, maybe of another subtask.
    fn looks_as(&self, other: &Self) -> bool {
        std::ptr::eq(self.state, other.state) && self.turn == other.turn
    }
}

/// Any number of teams as input of the network, which gives one value for each.
#[derive(Clone, Debug, Default)]
pub struct TeamValueInput {
    input: UtilityInput,
    /// The rows behind those of the subtasks' own things.
    others: SparseRows,
    seen: Observation,
    /// Of every entity that is seen how it stands to a subtask.
    relations: SparseRows,
}

impl TeamValueInput {
    /// Writes independent queries, each with its own rows.
    pub fn queries<'a>(
        &mut self,
        environment: &dyn Environment,
        queries: impl Iterator<Item = TeamQuery<'a>> + Clone,
    ) -> &UtilityInput {
        self.clear();
        let columns = TeamColumns::of(environment.spec());
        let count = queries.clone().count();
        let mut before: Option<TeamQuery<'_>> = None;
        for (index, query) in queries.enumerate() {
            let TeamQuery { state, task, team, turn } = query;
            let looks_as_before = before.is_some_and(|before| query.looks_as(&before));
            if !looks_as_before {
                environment.observe(state, turn, EntitySet::MAX, &mut self.seen);
            }
            if !looks_as_before || before.is_some_and(|before| before.task != task) {
                self.relate(environment, query);
            }
            let own = self.own(task);
            self.push_own(columns, own);
            self.input.visible.push(index);
            let first = self.others.len();
            for agent in members(self.seen.acting().into()) {
                self.push_agent(columns, agent, team >> agent & 1 == 1);
            }
            self.push_others(columns, own);
            (first..self.others.len()).for_each(|row| self.input.visible.push(count + row));
            self.input.visible.end_list();
            before = Some(query);
        }
        self.input.rows.append(&self.others);
        &self.input
    }

    /// Writes every team of the acting agents at every open subtask: `[open subtasks, 2^A]` queries. Bit i of a team stands
    /// for the i-th of them.
    ///
    /// The teams at a subtask share its other rows: each agent once as member and once not.
    pub fn all_teams(&mut self, environment: &dyn Environment, state: &[u8]) -> &UtilityInput {
        self.clear();
        let columns = TeamColumns::of(environment.spec());
        environment.observe(state, 0, EntitySet::MAX, &mut self.seen);
        let acting = members(self.seen.acting().into());
        let agents = acting.clone().count();
        let (teams, open) = (0..1_usize << agents, self.seen.open_tasks);
        let count = open.count_ones() as usize * teams.len();
        for (place, task) in members(open.into()).enumerate() {
            self.relate(environment, TeamQuery { state, task, team: 0, turn: 0 });
            let own = self.own(task);
            teams.clone().for_each(|_| self.push_own(columns, own));
            let first = count + self.others.len();
            for agent in acting.clone() {
                self.push_agent(columns, agent, false);
                self.push_agent(columns, agent, true);
            }
            let others = count + self.others.len();
            self.push_others(columns, own);
            let end = count + self.others.len();
            let visible = &mut self.input.visible;
            for team in teams.clone() {
                visible.push(place * teams.len() + team);
                (0..agents).for_each(|a| visible.push(first + 2 * a + (team >> a & 1)));
                (others..end).for_each(|row| visible.push(row));
                visible.end_list();
            }
        }
        self.input.rows.append(&self.others);
        &self.input
    }

    /// The input as it was written last.
    pub fn input(&self) -> &UtilityInput {
        &self.input
    }

    fn clear(&mut self) {
        self.input.clear();
        self.others.clear();
    }

    fn relate(&mut self, environment: &dyn Environment, query: TeamQuery<'_>) {
        let TeamQuery { state, task, turn, .. } = query;
        self.relations.clear();
        environment.relate(state, turn, task, EntitySet::MAX, &mut self.relations);
    }

    /// The first thing of a subtask, and its row.
    fn own(&self, task: usize) -> Option<(usize, usize)> {
        let own = members(self.seen.things_of(task)).next();
        own.map(|own| (own, self.seen.row_of(own)))
    }

    /// The row of the subtask's own thing.
    fn push_own(&mut self, columns: TeamColumns, own: Option<(usize, usize)>) {
        let rows = &mut self.input.rows;
        if let Some((_, row)) = own {
            rows.push_row(&self.seen.rows, row);
        }
        rows.push(columns.own(), 1.0);
        rows.end_row();
    }

    /// An agent's row; those of agents come first, as everything was observed.
    fn push_agent(&mut self, columns: TeamColumns, agent: usize, in_team: bool) {
        self.others.push_row(&self.seen.rows, agent);
        if in_team {
            self.others.push(columns.in_team(), 1.0);
        }
        self.end_row(columns, agent);
    }

    /// The rows of the things of open subtasks but one.
    fn push_others(&mut self, columns: TeamColumns, own: Option<(usize, usize)>) {
        let things = members(self.seen.things());
        for (row, thing) in (self.seen.agents()..).zip(things) {
            let is_open = self.seen.entity_task[thing] & self.seen.open_tasks != 0;
            if is_open && own.is_none_or(|(own, _)| own != thing) {
                self.others.push_row(&self.seen.rows, row);
                self.end_row(columns, row);
            }
        }
    }

    /// Adds an entity's relation to the row that is written and closes it.
    fn end_row(&mut self, columns: TeamColumns, row: usize) {
        self.others.push_row_at(columns.relation(), &self.relations, row);
        self.others.end_row();
    }
}

#[cfg(test)]
mod tests {
    use sortie_learn::random::{Purpose, generator};
    use sortie_nn::gradient_check::assert_gradient;

    use super::*;
    use crate::alma::agents::{UtilityNetwork, UtilityPass};
    use crate::alma::records::toy::{Street, toy};

    /// Streets with three agents somewhere and three sites, the second of which is finished.
    fn streets() -> Vec<Vec<u8>> {
        let street = |index: u8| {
            let mut street = Street::new(3, &[index, 9, 15 - index]);
            street.agents.rotate_left(usize::from(index % 3));
            street.agents[0] += index;
            street.sites[1].1 = false;
            street.bytes()
        };
        (0..8).map(street).collect()
    }

    fn network(skip: bool) -> UtilityNetwork {
        let mut config = AllocatorConfig::default();
        (config.network.width, config.network.base) = (16, 12);
        config.network.skip = skip;
        let shape = config.shape(toy().spec());
        UtilityNetwork::initialise(shape, 8.0, &mut generator(1, Purpose::Weights, 0))
    }

    #[test]
    fn a_row_says_what_an_entity_is_and_how_it_stands_to_the_subtask() {
        let mut street = Street::new(2, &[4, 9, 6]);
        street.sites[1].1 = false;
        let state = street.bytes();
        let mut input = TeamValueInput::default();
        let query = |task| TeamQuery { state: &state, task, team: 0b10, turn: 0 };
        let input = input.queries(&toy(), [query(0), query(2)].into_iter());
        let own = |door| vec![(0, 1.0), (1, door), (2, 1.0), (3, 1.0)];
        let other = |door, away: usize| vec![(0, 1.0), (1, door), (2, 1.0), (5 + away, 1.0)];
        let wanted = [
            own(4.0),
            own(6.0),
            vec![(5 + 4, 1.0)],
            vec![(1, 1.0), (4, 1.0), (5 + 3, 1.0)],
            other(6.0, 2),
            vec![(5 + 6, 1.0)],
            vec![(1, 1.0), (4, 1.0), (5 + 5, 1.0)],
            other(4.0, 2),
        ];
        let rows = (0..input.rows.len()).map(|row| input.rows.row(row).collect::<Vec<_>>());
        assert!(rows.eq(wanted));
        assert!(input.visible.list(0).eq([0, 2, 3, 4]) && input.visible.list(1).eq([1, 5, 6, 7]));

        let mut input = TeamValueInput::default();
        let turned = [0, 1].map(|turn| TeamQuery { turn, ..query(0) });
        let input = input.queries(&toy(), turned.into_iter());
        let owns = [0, 1].map(|row| input.rows.row(row).collect::<Vec<_>>());
        assert_eq!(owns, [own(4.0), own(11.0)], "the same state under a symmetry");
    }

    #[test]
    fn shared_rows_give_the_values_of_single_queries() {
        let (environment, network) = (toy(), network(true));
        let mut pass = UtilityPass::new(network.shape());
        for state in &streets() {
            let mut shared = TeamValueInput::default();
            let shared = pass.forward(&network, shared.all_teams(&environment, state)).to_vec();
            let queries = [0, 2].into_iter().flat_map(|task| {
                (0..1 << 3).map(move |team| TeamQuery { state, task, team, turn: 0 })
            });
            let mut single = TeamValueInput::default();
            let single = pass.forward(&network, single.queries(&environment, queries));
            assert_eq!(shared.len(), single.len());
            for (shared, single) in shared.iter().zip(single) {
                assert!((shared - single).abs() < 1e-4, "{shared} against {single}");
            }
            assert_ne!(shared[0], shared[1], "a member changes the value");
        }
    }

    #[test]
    fn gradients_of_the_value_agree_with_finite_differences() {
        [false, true].map(network).iter().for_each(check_gradient);
    }

    fn check_gradient(network: &UtilityNetwork) {
        let streets = streets();
        let queries = streets.iter().enumerate().map(|(index, state)| TeamQuery {
            state,
            task: index % 2 * 2,
            team: index as u64,
            turn: index % 2,
        });
        let mut input = TeamValueInput::default();
        input.queries(&toy(), queries);
        let slopes = [0.3, -1.0, 0.5, 2.0, -0.7, 0.2, 1.1, -0.4];
        let loss = |parameters: &[f32]| -> f64 {
            let network = UtilityNetwork::from_parameters(network.shape(), parameters.to_vec());
            let mut pass = UtilityPass::new(network.as_ref().unwrap().shape());
            let values = pass.forward(&network.unwrap(), input.input());
            values.iter().zip(slopes).map(|(v, s)| f64::from(*v) * f64::from(s)).sum()
        };
        let mut pass = UtilityPass::new(network.shape());
        assert_eq!(pass.forward(network, input.input()).len(), 8);
        let mut gradient = vec![0.0; network.shape().parameters()];
        pass.backward(network, input.input(), &slopes, &mut gradient);
        for tensor in network.shape().tensors() {
            let at = &network.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &gradient[tensor.range.clone()], |moved| {
                let mut parameters = network.parameters().to_vec();
                parameters[tensor.range.clone()].copy_from_slice(moved);
                loss(&parameters)
            });
        }
    }
}
