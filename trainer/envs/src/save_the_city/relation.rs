//! How far every entity is from a building: what an allocator's network knows beside the features.

use super::state::{AgentState, BuildingState, City};

/// Columns of a relation: one per bin of travel times.
pub const RELATIONS: usize = TRAVEL_FROM.len() + 1;

/// Travel times in steps from which on an entity belongs to the next bin.
const TRAVEL_FROM: [f64; 15] =
    [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5, 9.5, 11.5, 13.5, 15.5, 18.5, 22.5];

/// The bin of the time that an agent takes to a building.
pub fn agent_relation(agent: &AgentState, building: &BuildingState) -> usize {
    travel_bin(agent.travel_time_to(building))
}

/// The bin of the time that a walk of single steps takes from one building to another.
pub fn building_relation(other: &BuildingState, building: &BuildingState) -> usize {
    let cells = other.x.abs_diff(building.x) + other.y.abs_diff(building.y);
    travel_bin(f64::from(cells.saturating_sub(1)))
}

fn travel_bin(travel_time: f64) -> usize {
    TRAVEL_FROM.iter().filter(|from| travel_time >= **from).count()
}

/// Writes the relation `[N, RELATIONS]` of every entity to an open building, each row one-hot.
///
/// Agent i of the city stands in row `agent_rows[i]`, building b in row `first_building + b`. The row of
/// the building itself stays zero, as do those of closed buildings and rows that hold no entity: no
/// network looks at their relation. All rows stay zero where the building is not open.
pub fn write_relation(
    city: City<'_>,
    task: usize,
    agent_rows: &[usize],
    first_building: usize,
    relation: &mut [f32],
) {
    relation.fill(0.0);
    let building = city.buildings.get(task).filter(|building| building.is_open());
    let Some(building) = building else { return };
    let mut mark = |row: usize, bin: usize| {
        if let Some(value) = relation.get_mut(row * RELATIONS + bin) {
            *value = 1.0;
        }
    };
    for (agent, row) in city.agents.iter().zip(agent_rows) {
        mark(*row, agent_relation(agent, building));
    }
    for (other, state) in city.buildings.iter().enumerate() {
        if other != task && state.is_open() {
            mark(first_building + other, building_relation(state, building));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::{AgentKind, BuildingKind, Status};
    use super::*;

    fn building(x: u8, status: Status) -> BuildingState {
        BuildingState {
            health: 0.5,
            fire: 0.0,
            period: 70,
            to_next_fire: 60,
            since_last_fire: 10,
            kind: BuildingKind::Fast,
            status,
            x,
            y: 3,
        }
    }

    #[test]
    fn travel_times_fall_into_rising_bins() {
        assert_eq!([0.0, 0.5, 1.0, 9.0, 10.0, 30.0].map(travel_bin), [0, 1, 1, 9, 10, 15]);
        assert_eq!(RELATIONS, 16);
    }

    #[test]
    fn only_agents_and_other_open_buildings_have_a_relation() {
        let agents = [AgentState::at(AgentKind::Generalist, 9, 3)];
        let open = [0, 4, 12].map(|x| building(x, Status::Open));
        let buildings = [open[0], open[1], building(8, Status::Complete), open[2]];
        let city = City { agents: &agents, buildings: &buildings };
        let mut relation = [7.0; 7 * RELATIONS];
        write_relation(city, 1, &[2], 3, &mut relation);
        let ones: [Option<usize>; 7] = core::array::from_fn(|row| {
            let row = &relation[row * RELATIONS..][..RELATIONS];
            assert!(row.iter().sum::<f32>() <= 1.0);
            row.iter().position(|value| *value == 1.0)
        });
        // Two cells a step: two steps to a cell beside the building. Rows 0 and 1 hold nobody.
        assert_eq!(ones, [None, None, Some(2), Some(3), None, None, Some(7)]);
    }
}
