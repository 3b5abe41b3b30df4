//! What the fast learner computes, written a second time: slowly, in f64, from its rules alone.
//!
//! Tests compare losses with it. It shares neither passes nor batches nor turned maps with what it checks; of the
//! environment it takes dense rows and travel times, which recorded episodes check.

use sortie_envs::members;
use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    AgentState, BuildingState, City, FEATURES, RELATIONS, agent_relation, building_relation,
    with_city, write_agent_row, write_building_row,
};

use super::{city, gradient, played, samples, usual};
use crate::alma::agents::{Conditioning, NO_ACTION, UtilityNetwork, transpose};
use crate::alma::records::config::Credit;
use crate::alma::records::lesson::{Drawn, Experience, Networks};
use crate::alma::records::replay::Moment;
use crate::alma::records::team_value::{DrawnSegment, TeamValues};
use crate::alma::records::{Config, Sample};

type Row = Vec<f64>;

/// What a network says to the entity of the row `own` that sees the rows `seen` (dissertation section 2.3).
fn outputs(network: &UtilityNetwork, own: &Row, seen: &[Row]) -> Vec<f64> {
    let shape = network.shape;
    let tensors = shape.tensors();
    let tensor = |name: &str| {
        let found = tensors.iter().find(|tensor| tensor.name == name);
        &network.parameters[found.map_or(0..0, |tensor| tensor.range.clone())]
    };
    let fc1 = transpose(tensor("fc1.weight"), shape.input, shape.width);
    let embed = |row: &Row| rectified(affine(&fc1, tensor("fc1.bias"), row));
    let (query, rest) = tensor("attention.in.weight").split_at(shape.width * shape.width);
    let (key, value) = rest.split_at(shape.width * shape.width);
    let no_bias = vec![0.0; shape.width];
    let query = affine(query, &no_bias, &embed(own));
    let embedded = || seen.iter().map(embed);
    let keys: Vec<Row> = embedded().map(|row| affine(key, &no_bias, &row)).collect();
    let values: Vec<Row> = embedded().map(|row| affine(value, &no_bias, &row)).collect();

    let mut attended = vec![0.0; shape.width];
    let head = shape.width / shape.heads;
    for start in (0..shape.width).step_by(head) {
        let columns = start..start + head;
        let score = |key: &Row| {
            let products = columns.clone().map(|column| query[column] * key[column]);
            (products.sum::<f64>() / (head as f64).sqrt()).exp()
        };
        let total: f64 = keys.iter().map(score).sum();
        for (key, value) in keys.iter().zip(&values) {
            for column in columns.clone() {
                attended[column] += score(key) / total * value[column];
            }
        }
    }
    let mut looked =
        affine(tensor("attention.out.weight"), tensor("attention.out.bias"), &attended);
    if shape.skip {
        let past = affine(tensor("skip.weight"), &no_bias, &embed(own));
        looked.iter_mut().zip(past).for_each(|(looked, past)| *looked += past);
    }
    let base = affine(tensor("fc2.weight"), tensor("fc2.bias"), &rectified(looked));
    affine(tensor("head.weight"), tensor("head.bias"), &rectified(base))
}

/// `matrix [out, in]` times `input`, plus `bias`.
fn affine(matrix: &[f32], bias: &[f32], input: &[f64]) -> Row {
    let rows = matrix.chunks_exact(input.len()).zip(bias);
    let dot = |row: &[f32]| row.iter().zip(input).map(|(a, b)| f64::from(*a) * b).sum::<f64>();
    rows.map(|(row, bias)| dot(row) + f64::from(*bias)).collect()
}

fn rectified(mut row: Row) -> Row {
    row.iter_mut().for_each(|value| *value = value.max(0.0));
    row
}

/// A row of features, widened by zeros to so many columns.
fn agent_row(agent: &AgentState, columns: usize) -> Row {
    widened(columns, |row| write_agent_row(agent, row))
}

fn building_row(building: &BuildingState, columns: usize) -> Row {
    widened(columns, |row| write_building_row(building, row))
}

fn widened(columns: usize, write: impl Fn(&mut [f32])) -> Row {
    let mut row = [0.0; FEATURES];
    write(&mut row);
    let zeros = std::iter::repeat_n(0.0, columns - FEATURES);
    row.into_iter().map(f64::from).chain(zeros).collect()
}

/// One of the eight ways to look at the map: bits for west and east, for south and north, for the diagonal.
#[derive(Clone, Copy)]
struct Map(u8);

impl Map {
    /// Where a cell is then.
    fn cell(self, (x, y): (i32, i32)) -> (i32, i32) {
        let x = if self.0 & 1 == 0 { x } else { 15 - x };
        let y = if self.0 & 2 == 0 { y } else { 15 - y };
        if self.0 & 4 == 0 { (x, y) } else { (y, x) }
    }

    /// The number of an action then: that of the move between the same two cells.
    fn action(self, action: u8) -> u8 {
        const STEPS: [(i32, i32); 8] =
            [(0, 1), (1, 0), (0, -1), (-1, 0), (0, 2), (2, 0), (0, -2), (-2, 0)];
        let Some((dx, dy)) = STEPS.get(usize::from(action).wrapping_sub(1)) else { return action };
        let (from, to) = (self.cell((7, 7)), self.cell((7 + dx, 7 + dy)));
        let step = (to.0 - from.0, to.1 - from.1);
        1 + STEPS.iter().position(|other| *other == step).unwrap() as u8
    }

    fn agent(self, agent: &AgentState) -> AgentState {
        let (x, y) = self.place(agent.x, agent.y);
        let available = (0..16).filter(|action| agent.available >> action & 1 == 1);
        let available = available.map(|action| 1 << self.action(action)).sum();
        AgentState { x, y, available, ..*agent }
    }

    fn building(self, building: &BuildingState) -> BuildingState {
        let (x, y) = self.place(building.x, building.y);
        BuildingState { x, y, ..*building }
    }

    fn place(self, x: u8, y: u8) -> (u8, u8) {
        let (x, y) = self.cell((x.into(), y.into()));
        (x as u8, y as u8)
    }
}

/// Whether two losses are the same but for rounding.
fn assert_near(what: &str, got: f64, want: f64) {
    assert!((got - want).abs() <= 1e-4 * (0.01 + want), "{what}: {got}, by the rules {want}");
}

fn config(subtask: Conditioning, skip: bool) -> Config {
    let mut config = usual();
    config.allocation.heuristic = 1.0;
    (config.network.subtask, config.network.skip) = (subtask, skip);
    (config.network.width, config.network.base) = (8, 6);
    config
}

/// What a team sees of a state.
struct Sight {
    /// The row of every agent and its available actions, agents of the team or not.
    agents: Vec<(Row, u16)>,
    buildings: Vec<Row>,
}

/// What there is to see of a record's state, turned: when its team acted, or to bootstrap from.
fn sight(sample: &Sample<'_>, map: Map, columns: usize, next: bool) -> Sight {
    let moment = if next { sample.next } else { sample.now };
    let mark = |row: &mut Row, task: usize| {
        if columns > FEATURES + 12 {
            row[FEATURES + 12 + task] = 1.0;
        }
    };
    with_city(moment.state, |city| {
        let agent = |(number, agent): (usize, &AgentState)| {
            let turned = map.agent(agent);
            let mut row = agent_row(&turned, columns);
            let last = moment.last_actions[number];
            if last != NO_ACTION {
                row[FEATURES + usize::from(map.action(last))] = 1.0;
            }
            mark(&mut row, sample.now.allocation[number].into());
            (row, turned.available)
        };
        let building = |(task, building): (usize, &BuildingState)| {
            let mut row = building_row(&map.building(building), columns);
            mark(&mut row, task);
            row
        };
        Sight {
            agents: city.agents.iter().enumerate().map(agent).collect(),
            buildings: city.buildings.iter().enumerate().map(building).collect(),
        }
    })
}

/// The squared difference between the value of what a team did and its target.
fn squared_error(
    online: &UtilityNetwork,
    target: &UtilityNetwork,
    sample: &Sample<'_>,
    map: Map,
    subtask: Conditioning,
) -> f64 {
    let columns = online.shape.input;
    let [now, next] = [false, true].map(|next| sight(sample, map, columns, next));
    let task = sample.task;
    let team: Vec<usize> = members(sample.now.team(task).into()).collect();
    let seen = |sight: &Sight| {
        let row = |agent: usize| sight.agents[agent].0.clone();
        match subtask {
            Conditioning::Mask => {
                let building = sight.buildings[task].clone();
                team.iter().map(|agent| row(*agent)).chain([building]).collect::<Vec<_>>()
            }
            _ => {
                let agents = (0..sight.agents.len()).map(row);
                agents.chain(sight.buildings.iter().cloned()).collect()
            }
        }
    };
    let (seen_now, seen_next) = (seen(&now), seen(&next));
    let mut value = 0.0;
    let mut wanted = f64::from(sample.reward);
    for agent in &team {
        let action = map.action(sample.now.actions[*agent]);
        value += outputs(online, &now.agents[*agent].0, &seen_now)[usize::from(action)];
        let (row, available) = &next.agents[*agent];
        let liked = outputs(online, row, &seen_next);
        let is_available = |action: &usize| available >> action & 1 == 1;
        let best = (0..12).filter(is_available).max_by(|a, b| liked[*a].total_cmp(&liked[*b]));
        let valued = outputs(target, row, &seen_next)[best.unwrap()];
        wanted += f64::from(sample.discount) * valued;
    }
    (value - wanted) * (value - wanted)
}

#[test]
fn the_loss_of_every_record_is_that_of_the_rules() {
    for (subtask, skip) in [
        (Conditioning::Mask, false),
        (Conditioning::Input, false),
        (Conditioning::None, false),
        (Conditioning::Mask, true),
        (Conditioning::None, true),
    ] {
        let config = config(subtask, skip);
        let (method, city) = (played(config.clone(), 40), city(&config));
        let network = |seed| Networks::new(&config, city.spec(), &mut generator(seed));
        let ((networks, online), (_, target)) = (network(1), network(2));
        let utility = |parameters: &[f32]| UtilityNetwork {
            shape: networks.shape,
            parameters: parameters.to_vec(),
        };
        let experience = Experience { environment: &*city, replay: &method.replay };
        let mut ended = 0;
        for (number, sample) in samples(&method, 100).into_iter().enumerate() {
            let symmetry = number % 8;
            let drawn = Drawn { sample, turn: symmetry, marks: 0 };
            let losses = |drawn: &[Drawn], of| {
                let weights = [&online.values[..], &target.values];
                gradient(weights, |shard| networks.loss(shard, experience, drawn, of)).0
            };
            let [own, other] = [&online, &target].map(|all| utility(&all.values));
            let (sample, map) = (method.replay.sample(sample), Map(symmetry as u8));
            let want = squared_error(&own, &other, &sample, map, subtask);
            let what = format!("{subtask:?}, skip {skip}, record {number}, map {symmetry}");
            assert_near(&what, losses(&[drawn], 1), want);
            assert_near(&what, losses(&[drawn; 3], 3), want);
            ended += usize::from(sample.discount == 0.0);
        }
        assert!(subtask == Conditioning::None || ended < 100, "{ended} ended");
    }
}

fn allocator_config(skip: bool) -> Config {
    let mut config = usual();
    // Decisions that differ from one another.
    (config.allocator.moved, config.allocator.moved_decisions) = (0.5, 1.0);
    (config.allocator.network.width, config.allocator.network.base) = (8, 6);
    config.allocator.network.skip = skip;
    (config.network.width, config.network.base) = (8, 6);
    config.environment.settings.insert("episode_limit".into(), 40.into());
    config
}

/// What a network expects of the team that a decision sends to a building.
fn value(network: &UtilityNetwork, decision: Moment<'_>, task: usize, map: Map) -> f64 {
    with_city(decision.state, |city| value_in(network, city, decision.allocation, task, map))
}

fn value_in(
    network: &UtilityNetwork,
    city: City<'_>,
    allocation: &[u8],
    task: usize,
    map: Map,
) -> f64 {
    let columns = FEATURES + 2 + RELATIONS;
    let building = map.building(&city.buildings[task]);
    let mut own = building_row(&building, columns);
    own[FEATURES] = 1.0;
    let mut seen = vec![own.clone()];
    for (agent, sent) in city.agents.iter().zip(allocation) {
        let agent = map.agent(agent);
        let mut row = agent_row(&agent, columns);
        row[FEATURES + 1] = f64::from(u8::from(usize::from(*sent) == task));
        row[FEATURES + 2 + agent_relation(&agent, &building)] = 1.0;
        seen.push(row);
    }
    for (number, other) in city.buildings.iter().enumerate() {
        if number != task && other.is_open() {
            let other = map.building(other);
            let mut row = building_row(&other, columns);
            row[FEATURES + 2 + building_relation(&other, &building)] = 1.0;
            seen.push(row);
        }
    }
    outputs(network, &own, &seen)[0]
}

#[test]
fn the_loss_of_every_segment_is_that_of_the_rules() {
    for (skip, credit) in [(false, Credit::Subtask), (true, Credit::Subtask), (true, Credit::Team)]
    {
        check_losses(skip, credit);
    }
}

fn check_losses(skip: bool, credit: Credit) {
    let config = allocator_config(skip);
    let (method, city) = (played(config.clone(), 100), city(&config));
    let network = |seed| TeamValues::new(&config.allocator, city.spec(), &mut generator(seed));
    let ((values, online), (_, target)) = (network(1), network(2));
    let utility = |parameters: &[f32]| UtilityNetwork {
        shape: values.shape,
        parameters: parameters.to_vec(),
    };
    let [own, other] = [&online, &target].map(|all| utility(&all.values));
    let segments = &method.allocator.as_ref().unwrap().segments;
    let experience = (&*city, segments);
    let (mut random, mut seen) = (generator(3), Default::default());
    let (mut moved, mut closed) = (0, 0);
    for number in 0..600 {
        let drawn = DrawnSegment::draw(experience, (credit, 8), &mut seen, &mut random).unwrap();
        let DrawnSegment { place, tasks, turn } = drawn;
        let map = Map(turn as u8);
        let agents = city.spec().shape.agents;
        let [now, next] =
            [place, place.after(1)].map(|place| Moment::read(segments.state(place), agents));
        let mut error = 0.0;
        for task in members(tasks.into()) {
            error += value(&own, now, task, map) - f64::from(segments.rewards(place).tasks[task]);
            let goes_on = segments.end(place) == sortie_learn::trajectory::End::Open
                && with_city(next.state, |city| city.open_tasks()) >> task & 1 == 1;
            if goes_on {
                error -= f64::from(*segments.note(place)) * value(&other, next, task, map);
                moved += usize::from(next.team(task) != now.team(task));
            } else {
                closed += 1;
            }
        }
        let what = format!("segment {number}, buildings {tasks:b}, map {turn}");
        for drawn in [&[drawn][..], &[drawn; 3]] {
            let weights = [&online.values[..], &target.values];
            let loss =
                gradient(weights, |shard| values.loss(shard, experience, drawn, drawn.len()));
            assert_near(&what, loss.0, error * error);
        }
    }
    assert!(moved > 100 && closed > 10, "{moved} other teams, {closed} closed");
}
