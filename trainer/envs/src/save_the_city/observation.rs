//! What there is to see: feature rows and relations, written from compact states; and what SaveTheCity says of itself.
//!
//! Every value is computed in f64 and rounded once to f32, so that rows rebuilt from stored states
//! equal the observed ones bit for bit.

use alloc::format;
use alloc::string::{String, ToString};

use super::bytes::state_bytes;
use super::causes::Cause;
use super::grid::Symmetry;
use super::rules::{ACTION_NAMES, ACTIONS};
use super::scenarios::ScenarioSet;
use super::scripted::RULES;
use super::state::{AgentKind, AgentState, BuildingKind, BuildingState, City, SIDE, Status};
use super::{Constants, VERSION};
use crate::picture::{Bar, Disc, Field, Outline, Picture};
use crate::spec::{Metric, Rewards, Shape, Spec, View};

/// Columns of a feature row.
pub const FEATURES: usize = 58;

/// Most columns of a row that differ from zero: five of place and every action.
const ROW_ENTRIES: usize = 5 + ACTIONS;

const X: usize = 5;
const Y: usize = 21;
pub(super) const X_SCALED: usize = 37;
pub(super) const Y_SCALED: usize = 38;
pub(super) const AVAILABLE: usize = 39;
pub(super) const HEALTH: usize = 51;
pub(super) const COMPLETE: usize = 52;
const BURNED_DOWN: usize = 53;
pub(super) const FIRE: usize = 54;
pub(super) const BURNING: usize = 55;
pub(super) const SINCE_LAST_FIRE: usize = 56;
pub(super) const IGNITION_RATE: usize = 57;

/// The availability mask of all actions.
const ALL_ACTIONS: u16 = (1 << ACTIONS) - 1;

/// Names of the columns.
#[rustfmt::skip]
pub const FEATURE_NAMES: [&str; FEATURES] = [
    "building-fast", "building-slow", "agent-firefighter", "agent-builder", "agent-generalist",
    "x-0", "x-1", "x-2", "x-3", "x-4", "x-5", "x-6", "x-7",
    "x-8", "x-9", "x-10", "x-11", "x-12", "x-13", "x-14", "x-15",
    "y-0", "y-1", "y-2", "y-3", "y-4", "y-5", "y-6", "y-7",
    "y-8", "y-9", "y-10", "y-11", "y-12", "y-13", "y-14", "y-15",
    "x-scaled", "y-scaled",
    "can-stay", "can-north", "can-east", "can-south", "can-west", "can-north-2",
    "can-east-2", "can-south-2", "can-west-2", "can-fight", "can-build", "can-freeze",
    "health", "complete", "burned-down", "fire", "burning", "since-last-fire", "ignition-rate",
];

/// Gives every column of an agent that may differ from zero, in rising order.
#[inline]
pub fn agent_features(agent: &AgentState, mut emit: impl FnMut(usize, f32)) {
    place(agent.kind.type_index(), agent.x, agent.y, &mut emit);
    // From bit to bit: most actions are not available, and testing each would be guessed wrong often.
    let mut available = agent.available & ALL_ACTIONS;
    while available != 0 {
        emit(AVAILABLE + available.trailing_zeros() as usize, 1.0);
        available &= available - 1;
    }
}

/// Gives every column of a building that may differ from zero, in rising order.
#[inline]
pub fn building_features(building: &BuildingState, mut emit: impl FnMut(usize, f32)) {
    place(building.kind.type_index(), building.x, building.y, &mut emit);
    emit(HEALTH, building.health as f32);
    match building.status {
        Status::Open => {}
        Status::Complete => emit(COMPLETE, 1.0),
        Status::BurnedDown => emit(BURNED_DOWN, 1.0),
    }
    if building.is_burning() {
        emit(FIRE, building.fire as f32);
        emit(BURNING, 1.0);
    }
    let since = f64::from(building.since_last_fire) / f64::from(building.period);
    emit(SINCE_LAST_FIRE, since as f32);
    let known = IGNITION_RATES.get(usize::from(building.period)).copied();
    emit(IGNITION_RATE, known.unwrap_or_else(|| ignition_rate(building.period)));
}

/// 1 for the shortest period of all, 10 steps, and 0 for the longest, 80.
const fn ignition_rate(period: u16) -> f32 {
    ((1.0 / period as f64 - 1.0 / 80.0) / (1.0 / 10.0 - 1.0 / 80.0)) as f32
}

/// The rates of all usual periods, since divisions would take a good part of an observation.
const IGNITION_RATES: [f32; 81] = {
    let mut rates = [0.0; 81];
    let mut period = 1;
    while period < rates.len() {
        rates[period] = ignition_rate(period as u16);
        period += 1;
    }
    rates
};

#[inline]
fn place(type_index: usize, x: u8, y: u8, emit: &mut impl FnMut(usize, f32)) {
    emit(type_index, 1.0);
    emit(X + usize::from(x), 1.0);
    emit(Y + usize::from(y), 1.0);
    emit(X_SCALED, (f64::from(x) / 16.0) as f32);
    emit(Y_SCALED, (f64::from(y) / 16.0) as f32);
}

/// Writes an agent's dense row into the first [`FEATURES`] columns of `row`.
pub fn write_agent_row(agent: &AgentState, row: &mut [f32]) {
    let row = known_length(row);
    row.fill(0.0);
    agent_features(agent, |column, value| row[column] = value);
}

/// Writes a building's dense row into the first [`FEATURES`] columns of `row`.
pub fn write_building_row(building: &BuildingState, row: &mut [f32]) {
    let row = known_length(row);
    row.fill(0.0);
    building_features(building, |column, value| row[column] = value);
}

/// The columns of a row as an array, so that writing them needs few checks.
#[inline]
fn known_length(row: &mut [f32]) -> &mut [f32; FEATURES] {
    row.first_chunk_mut().expect("a row has all columns of the shape")
}

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

/// Potential of a state for a team at a task; without one an agent counts by its nearest open building.
///
/// `cell` is the potential of one cell between an agent and its building. Shaping with `discount^m * phi(s') - phi(s)`
/// leaves the best policy as it is (Ng, Harada and Russell 1999). It is no part of the dissertation.
pub fn potential(
    cell: f32,
    city: City<'_>,
    team: impl Iterator<Item = usize>,
    task: Option<usize>,
) -> f32 {
    let at = |agent: &AgentState, building: &BuildingState| {
        -cell * f32::from(agent.distance_to(building).saturating_sub(1))
    };
    let nearest = |agent: &AgentState| {
        let open = city.buildings.iter().filter(|building| building.is_open());
        open.map(|building| at(agent, building)).reduce(f32::max).unwrap_or(0.0)
    };
    team.map(|agent| &city.agents[agent])
        .map(|agent| task.map_or_else(|| nearest(agent), |task| at(agent, &city.buildings[task])))
        .sum()
}

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "save-the-city";

/// The metric that tells how many buildings there were.
pub(super) const BUILDINGS: &str = "buildings";

pub(super) const METRICS: &[Metric] = &[
    Metric::reported("none_burned", "share", "no building burned"),
    Metric::recorded("prop_buildings_completed", "share", "of the buildings that are complete"),
    Metric::recorded("fires_extinguished", "fires", "put out"),
    Metric::recorded("buildings_completed", "buildings", "completed"),
    Metric::recorded("buildings_burned", "buildings", "lost"),
    Metric::recorded(BUILDINGS, "buildings", "of the episode"),
    Metric::recorded("buildings_health_delta", "health", "sum of all changes"),
    Metric::recorded("types_per_firefight", "kinds", "at a fire that anyone fought"),
    Metric::recorded("types_per_build", "kinds", "at a building that anyone built"),
];

/// The unit of a feature.
fn unit(feature: &str) -> &'static str {
    match feature {
        "x-scaled" | "y-scaled" => "sides of the map",
        "health" | "fire" => "share of full",
        "since-last-fire" => "ignition periods",
        "ignition-rate" => "share of the fastest",
        _ => "flag",
    }
}

/// What a set of scenarios says of itself.
pub(super) fn spec(set: &ScenarioSet, constants: &Constants) -> Spec {
    let shape = Shape {
        agents: set.max_agents,
        entities: set.max_agents + set.max_buildings,
        tasks: set.max_buildings,
        actions: ACTIONS,
        features: FEATURES,
    };
    Spec {
        name: NAME.into(),
        version: VERSION,
        shape,
        view: View::Entities,
        features: FEATURE_NAMES.map(String::from).to_vec(),
        units: FEATURE_NAMES.map(unit).to_vec(),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(0),
        metrics: METRICS.to_vec(),
        causes: &Cause::NAMES,
        rewards: Rewards { tasks: true, agents: false },
        disturbance: "set on fire",
        turns: Symmetry::ALL.len(),
        rules: RULES.to_vec(),
        relations: RELATIONS,
        row_entries: ROW_ENTRIES,
        state_bytes: state_bytes(set.max_agents, set.max_buildings),
        episode_limit: constants.episode_limit,
        ..Spec::default()
    }
}

/// What a city looks like, north up.
pub(super) fn picture(city: City<'_>) -> Picture {
    let place = |x: u8, y: u8| Some([x, y].map(f64::from));
    let agents = city.agents.iter().enumerate().map(|(number, agent)| {
        let (kind, outline) = match agent.kind {
            AgentKind::Firefighter => ("firefighter", Outline::Circle),
            AgentKind::Builder => ("builder", Outline::Square),
            AgentKind::Generalist => ("generalist", Outline::Diamond),
        };
        Disc {
            name: format!("{}{number}", agent.kind.letter()),
            kind,
            outline,
            colour: Some(agent.kind as u8),
            place: place(agent.x, agent.y),
            ..Disc::default()
        }
    });
    let things = city.buildings.iter().enumerate().map(|(number, building)| {
        let (status, sign, colour) = match building.status {
            Status::Complete => ("complete", "+", None),
            Status::BurnedDown => ("burned down", "-", None),
            Status::Open if building.is_burning() => ("burning", "!", Some(3)),
            Status::Open => ("open", "", None),
        };
        let name = char::from(b'a'.saturating_add(number as u8)).to_string();
        let speed = match building.kind {
            BuildingKind::Fast => "fast",
            BuildingKind::Slow => "slow",
        };
        let ignition =
            format!("; ignites in {} of {} steps", building.to_next_fire, building.period);
        let hidden = if building.is_open() { &ignition[..] } else { "" };
        Disc {
            label: format!("{name}{sign}"),
            name,
            kind: "building",
            outline: Outline::Square,
            colour,
            place: place(building.x, building.y),
            bars: [("health", building.health), ("fire", building.fire)]
                .map(|(name, share)| Bar { name, share })
                .to_vec(),
            status: status.into(),
            about: format!("burns {speed}{hidden}"),
            task: Some(number),
            ..Disc::default()
        }
    });
    Picture {
        field: Some(Field::grid(SIDE.into(), SIDE.into()).upwards()),
        agents: agents.collect(),
        things: things.collect(),
        ..Picture::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::save_the_city::state::{AgentKind, BuildingKind, Status};

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
