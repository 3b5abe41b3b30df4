//! Teams at buildings, written as input of the team-value network.

use sortie_envs::save_the_city::{
    AgentState, BuildingState, City, FEATURES, RELATIONS, Symmetry, agent_features, agent_relation,
    building_features, building_relation,
};
use sortie_nn::layers::SparseRows;

use crate::alma::records::UtilityInput;

/// Marks the building that the value is about.
const OWN: usize = FEATURES;
/// Marks the agents of the team.
const IN_TEAM: usize = FEATURES + 1;
/// First of the columns that say how far away an entity is from the building.
const RELATION: usize = FEATURES + 2;
/// Columns of a row: an entity's features, its part in the question, its travel time as one-hot.
pub const COLUMNS: usize = RELATION + RELATIONS;

/// A team at a building of a city.
#[derive(Clone, Copy, Debug)]
pub struct TeamQuery<'a> {
    /// Agents and buildings.
    pub city: City<'a>,
    /// The building, which is open.
    pub task: usize,
    /// Bit a set where agent a is in the team.
    pub team: u64,
    /// How the map is turned.
    pub turn: Symmetry,
}

/// Any number of teams as input of the network, which gives one value for each.
#[derive(Clone, Debug, Default)]
pub struct TeamValueInput {
    input: UtilityInput,
}

impl TeamValueInput {
    /// Writes independent queries, each with its own rows.
    pub fn queries<'a>(
        &mut self,
        queries: impl Iterator<Item = TeamQuery<'a>> + Clone,
    ) -> &UtilityInput {
        self.input.clear();
        for query in queries.clone() {
            self.push_own(&query.turn.building(&query.city.buildings[query.task]));
        }
        for (index, query) in queries.enumerate() {
            let TeamQuery { city, task, team, turn } = query;
            let building = turn.building(&city.buildings[task]);
            self.input.visible.push(index);
            for (number, agent) in city.agents.iter().enumerate() {
                let row = self.push_agent(&turn.agent(agent), &building, team >> number & 1 == 1);
                self.input.visible.push(row);
            }
            for other in other_open(city, task) {
                let row = self.push_other(&turn.building(other), &building);
                self.input.visible.push(row);
            }
            self.input.visible.end_list();
        }
        &self.input
    }

    /// Writes every team at every open building: `[open buildings, 2^A]` queries.
    ///
    /// The teams at a building share its other rows: each agent once as member and once not.
    pub fn all_teams(&mut self, city: City<'_>) -> &UtilityInput {
        self.input.clear();
        let open = || city.buildings.iter().enumerate().filter(|(_, building)| building.is_open());
        let teams = 0..1_usize << city.agents.len();
        for (_, building) in open() {
            teams.clone().for_each(|_| self.push_own(building));
        }
        for (place, (task, building)) in open().enumerate() {
            let agents = self.input.rows.len();
            for agent in city.agents {
                self.push_agent(agent, building, false);
                self.push_agent(agent, building, true);
            }
            let others = self.input.rows.len();
            for other in other_open(city, task) {
                self.push_other(other, building);
            }
            let end = self.input.rows.len();
            let visible = &mut self.input.visible;
            for team in teams.clone() {
                visible.push(place * teams.len() + team);
                (0..city.agents.len()).for_each(|a| visible.push(agents + 2 * a + (team >> a & 1)));
                (others..end).for_each(|row| visible.push(row));
                visible.end_list();
            }
        }
        &self.input
    }

    /// The input as it was written last.
    pub fn input(&self) -> &UtilityInput {
        &self.input
    }

    fn push_own(&mut self, building: &BuildingState) {
        let rows = &mut self.input.rows;
        building_features(building, |column, value| rows.push(column, value));
        rows.push(OWN, 1.0);
        rows.end_row();
    }

    fn push_agent(&mut self, agent: &AgentState, building: &BuildingState, in_team: bool) -> usize {
        let rows = &mut self.input.rows;
        agent_features(agent, |column, value| rows.push(column, value));
        if in_team {
            rows.push(IN_TEAM, 1.0);
        }
        end_row(rows, agent_relation(agent, building))
    }

    fn push_other(&mut self, other: &BuildingState, building: &BuildingState) -> usize {
        let rows = &mut self.input.rows;
        building_features(other, |column, value| rows.push(column, value));
        end_row(rows, building_relation(other, building))
    }
}

/// The open buildings but one.
fn other_open<'a>(city: City<'a>, task: usize) -> impl Iterator<Item = &'a BuildingState> {
    let numbered = city.buildings.iter().enumerate();
    numbered.filter(move |(other, b)| *other != task && b.is_open()).map(|(_, b)| b)
}

/// Adds the relation to a row and closes it; returns the row's number.
fn end_row(rows: &mut SparseRows, relation: usize) -> usize {
    rows.push(RELATION + relation, 1.0);
    rows.end_row();
    rows.len() - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::{UtilityNetwork, UtilityPass, config::AllocatorConfig};
    use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet, Status};
    use sortie_learn::random::{Purpose, generator};
    use sortie_nn::gradient_check::assert_gradient;

    fn city() -> SaveTheCity {
        let set = ScenarioSet::named("2-5a_2-5b").unwrap();
        SaveTheCity::new(set, Constants::default(), 8, 5).unwrap()
    }

    fn network(skip: bool) -> UtilityNetwork {
        let mut config = AllocatorConfig::default();
        (config.network.width, config.network.base) = (16, 12);
        config.network.skip = skip;
        UtilityNetwork::initialise(config.shape(), 8.0, &mut generator(1, Purpose::Weights, 0))
    }

    #[test]
    fn shared_rows_give_the_values_of_single_queries() {
        let (world, network) = (city(), network(true));
        let mut pass = UtilityPass::new(network.shape());
        for instance in 0..8 {
            let city = world.city(instance);
            let mut buildings = city.buildings.to_vec();
            buildings[1].status = Status::Complete;
            let city = City { agents: city.agents, buildings: &buildings };
            let shared = pass.forward(&network, TeamValueInput::default().all_teams(city)).to_vec();
            let turn = Symmetry::ALL[0];
            let tasks = (0..buildings.len()).filter(|task| *task != 1);
            let queries = tasks.flat_map(|task| {
                let teams = 0..1_u64 << city.agents.len();
                teams.map(move |team| TeamQuery { city, task, team, turn })
            });
            let mut single = TeamValueInput::default();
            let single = pass.forward(&network, single.queries(queries));
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
        let world = city();
        let queries = (0..8).map(|instance| TeamQuery {
            city: world.city(instance),
            task: instance % 3,
            team: instance as u64,
            turn: Symmetry::ALL[instance],
        });
        let mut input = TeamValueInput::default();
        input.queries(queries);
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
