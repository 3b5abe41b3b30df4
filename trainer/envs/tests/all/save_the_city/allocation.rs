//! Allocation from a state and from its feature rows, and when it is due.

use sortie_envs::random::{below, generator};
use sortie_envs::save_the_city::{
    AgentKind, AgentState, AllocationRule, BuildingKind, BuildingState, City, CityDecoder,
    RELATIONS, SaveTheCity, Status, coordinated_allocation, write_relation,
};
use sortie_envs::{DecisionPoints, UNASSIGNED};
use sortie_envs::{Frame, FrameError, FrameReader, Random};

use super::{environment, for_random_states, observed};

/// What an allocator is shown: rows of 60 columns, absent ones as zeros.
#[derive(Clone)]
struct Buffers {
    rows: Vec<f32>,
    stride: usize,
    present: u128,
    open_tasks: u32,
}

const STRIDE: usize = 60;

/// The rules by their numbers.
const RULES: [AllocationRule; 3] =
    [AllocationRule::Coordinated, AllocationRule::Heuristic, AllocationRule::Random];

/// Allocates from a frame alone.
fn allocate(
    decoder: &mut CityDecoder,
    rule: usize,
    frame: &Frame<'_>,
    random: &mut Random,
    allocation: &mut [u8],
) -> Result<(), FrameError> {
    decoder.read(frame)?;
    decoder.allocate(rule, random, allocation)
}

fn observe(city: &SaveTheCity) -> Buffers {
    let seen = observed(city);
    let mut rows = vec![0.0; city.shape().entities * STRIDE];
    for (place, entity) in sortie_envs::members(seen.entities).enumerate() {
        seen.rows.write_dense(place, &mut rows[entity * STRIDE..][..STRIDE]);
    }
    Buffers { rows, stride: STRIDE, present: seen.present, open_tasks: seen.open_tasks as u32 }
}

fn frame<'a>(city: &SaveTheCity, buffers: &'a Buffers) -> Frame<'a> {
    Frame {
        rows: &buffers.rows,
        stride: buffers.stride,
        agents: city.shape().agents,
        tasks: city.shape().tasks,
        present: buffers.present,
        open_tasks: buffers.open_tasks,
        available: &[],
    }
}

#[test]
fn rules_give_the_same_from_a_state_and_from_its_rows() {
    let mut decoder = CityDecoder::new();
    for_random_states(2, |city, label| {
        let buffers = observe(city);
        for (number, rule) in RULES.into_iter().enumerate() {
            let (mut from_state, mut from_rows) = ([7; 24], [7; 24]);
            let mut rng = generator(3);
            rule.allocate(city.city(0), &mut rng.clone(), &mut from_state);
            let frame = frame(city, &buffers);
            allocate(&mut decoder, number, &frame, &mut rng, &mut from_rows).unwrap();
            assert_eq!(from_state, from_rows, "{label}, {rule:?}");
        }
    });
}

#[test]
fn decoded_cities_equal_the_observed_ones() {
    let mut decoder = CityDecoder::new();
    for_random_states(2, |city, label| {
        let buffers = observe(city);
        let decoded = decoder.decode(&frame(city, &buffers)).unwrap();
        assert_eq!(decoded.agents, city.city(0).agents, "{label}");
        for (got, want) in decoded.buildings.iter().zip(city.city(0).buildings) {
            let mut want = *want;
            (want.health, want.fire) = (f64::from(want.health as f32), f64::from(want.fire as f32));
            assert_eq!(*got, want, "{label}");
        }
    });
}

#[test]
fn relations_are_the_same_from_a_state_and_from_its_rows() {
    let mut decoder = CityDecoder::new();
    for_random_states(2, |city, label| {
        let (buffers, shape) = (observe(city), city.shape());
        let rows = frame(city, &buffers);
        decoder.decode(&rows).unwrap();
        let agents: Vec<usize> = (0..city.city(0).agents.len()).collect();
        let mut from_rows = vec![7.0; shape.entities * RELATIONS];
        let mut from_state = from_rows.clone();
        for task in 0..shape.tasks {
            decoder.relate(task, &mut from_rows);
            write_relation(city.city(0), task, &agents, shape.agents, &mut from_state);
            assert_eq!(from_rows, from_state, "{label}, building {task}");
        }
    });
}

#[test]
fn absent_agents_leave_a_gap() {
    let mut city = environment("2-5a_2-5b", 4);
    city.reset_with_tasks(0, 6, &mut generator(2)).unwrap();
    let mut buffers = observe(&city);
    buffers.present &= !0b00100;
    let mut decoder = CityDecoder::new();
    let mut rng = generator(1);
    let mut allocation = [7; 5];
    allocate(&mut decoder, 1, &frame(&city, &buffers), &mut rng, &mut allocation).unwrap();
    let mut whole = [7; 5];
    RULES[1].allocate(city.city(0), &mut rng, &mut whole);
    whole[2] = UNASSIGNED;
    assert_eq!(allocation, whole);
}

#[test]
fn rows_that_describe_no_city_are_refused() {
    let city = environment("2-5a_2-5b", 4);
    let buffers = observe(&city);
    let mut decoder = CityDecoder::new();
    let mut refusal = |change: &dyn Fn(&mut Buffers)| {
        let mut changed = buffers.clone();
        change(&mut changed);
        decoder.decode(&frame(&city, &changed)).err()
    };
    assert_eq!(refusal(&|_| {}), None);
    let first_building = 5 * 60;
    assert_eq!(refusal(&|b| b.rows[57] = f32::NAN), Some(FrameError::NonFinite { entity: 0 }));
    assert_eq!(refusal(&|b| b.rows[0..5].fill(0.0)), Some(FrameError::BadRow { entity: 0 }));
    assert_eq!(refusal(&|b| b.rows[37] = 1.0), Some(FrameError::BadRow { entity: 0 }));
    for (column, value) in [(57, -0.15), (56, 1.5), (56, -1.0), (38, -1.0)] {
        let refused = refusal(&|b| b.rows[first_building + column] = value);
        assert_eq!(refused, Some(FrameError::BadRow { entity: 5 }), "column {column}");
    }
    assert_eq!(refusal(&|b| b.rows.truncate(659)), Some(FrameError::BadLength));
    assert_eq!(refusal(&|b| b.stride = 57), Some(FrameError::BadLength));
    let too_large = Frame { tasks: 26, ..frame(&city, &buffers) };
    assert_eq!(decoder.decode(&too_large).err(), Some(FrameError::TooLarge));
}

#[test]
fn any_rows_and_masks_give_a_possible_allocation_or_a_refusal() {
    const STRANGE: [f32; 9] =
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e-40, -1.0, 0.0, 1.0, 17.0];
    let (mut decoder, mut rng) = (CityDecoder::new(), generator(8));
    let (mut allocated, mut refused) = (0, 0);
    for_random_states(1, |city, label| {
        let mut buffers = observe(city);
        let columns = buffers.rows.len();
        for _ in 0..below(&mut rng, 3) {
            buffers.rows[below(&mut rng, columns)] = STRANGE[below(&mut rng, STRANGE.len())];
        }
        let bits = |rng: &mut _| below(rng, usize::MAX) as u128 | below(rng, usize::MAX) as u128;
        buffers.present &= bits(&mut rng) | bits(&mut rng) << 64;
        buffers.open_tasks = bits(&mut rng) as u32 & bits(&mut rng) as u32;
        let frame = frame(city, &buffers);
        for (number, rule) in RULES.into_iter().enumerate() {
            let mut allocation = [7; 64];
            match allocate(&mut decoder, number, &frame, &mut rng, &mut allocation) {
                Ok(()) => allocated += 1,
                Err(_) => {
                    refused += 1;
                    continue;
                }
            }
            for (agent, task) in allocation.iter().enumerate().filter(|(_, t)| **t != UNASSIGNED) {
                let possible = frame.present >> agent & 1 == 1 && agent < frame.agents;
                assert!(possible, "{label}, {rule:?}: agent {agent}");
                let building = frame.agents + usize::from(*task);
                let open = frame.open_tasks >> task & 1 == 1 && frame.present >> building & 1 == 1;
                assert!(open, "{label}, {rule:?}: building {task}");
            }
        }
    });
    assert!(allocated > 1000 && refused > 100, "{allocated} allocated, {refused} refused");
}

fn house(x: u8, health: f64, fire: f64, to_next_fire: u16) -> BuildingState {
    BuildingState {
        health,
        fire,
        period: 80,
        to_next_fire,
        since_last_fire: 80 - to_next_fire,
        kind: BuildingKind::Fast,
        status: Status::of_health(health),
        x,
        y: 8,
    }
}

#[test]
fn the_coordinated_allocation_spreads_kinds_and_sees_the_clock() {
    // Two firefighters at equal distance from two fires: the second goes where the first does not.
    let team = [
        AgentState::at(AgentKind::Firefighter, 7, 8),
        AgentState::at(AgentKind::Firefighter, 7, 9),
    ];
    let fires = [house(4, 0.5, 1.0, 60), house(10, 0.5, 1.0, 60)];
    let mut allocation = [7; 3];
    coordinated_allocation(City { agents: &team, buildings: &fires }, &mut allocation);
    assert_eq!(allocation, [0, 1, UNASSIGNED]);

    // A builder prefers the farther house where the nearer one ignites before it arrives.
    let builder = [AgentState::at(AgentKind::Builder, 7, 8)];
    let houses = [house(4, 0.5, 0.0, 1), house(13, 0.5, 0.0, 60)];
    coordinated_allocation(City { agents: &builder, buildings: &houses }, &mut allocation);
    assert_eq!(allocation[0], 1);

    // Without an open building nobody is assigned.
    let closed = [house(4, 1.0, 0.0, 60), house(13, 0.0, 0.0, 60)];
    coordinated_allocation(City { agents: &builder, buildings: &closed }, &mut allocation);
    assert_eq!(allocation, [UNASSIGNED; 3]);
}

#[test]
fn decisions_are_due_at_first_then_every_five_steps_or_when_tasks_change() {
    let mut decisions = DecisionPoints::default();
    let due = |decisions: &mut DecisionPoints, changes: &[usize]| {
        (0..14).filter(|step| decisions.is_due(changes.contains(step))).collect::<Vec<_>>()
    };
    assert_eq!(due(&mut decisions, &[]), [0, 5, 10]);
    decisions.restart();
    assert_eq!(due(&mut decisions, &[3, 4]), [0, 3, 4, 9]);
    let mut always = DecisionPoints::every(1);
    assert_eq!(due(&mut always, &[]).len(), 14);
}
