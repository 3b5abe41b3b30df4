//! Routing against recorded instances, against every order of few customers, and against its rules.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::environment::Routing;
use super::observation::{FEATURES, Layout};
use super::*;
use crate::decisions::UNASSIGNED;
use crate::random::generator;
use crate::registry::Setting;
use crate::{
    EntitySet, Environment, Frame, FrameError, Observation, Rule, Shape, Split, StateError,
    conformance, open,
};

#[derive(Deserialize)]
struct Recorded {
    seed: u64,
    n: usize,
    redraws: usize,
    depot: Option<[f64; 2]>,
    customers: Option<Vec<[f64; 2]>>,
    demands: Option<Vec<u8>>,
    optimum_le4_routes: f64,
    greedy: f64,
    greedy_reloads: usize,
    ortools_default: Option<f64>,
}

fn recorded() -> Vec<Recorded> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/cvrp/instances.json");
    serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
}

fn settings(settings: &[(&str, Setting)]) -> BTreeMap<String, Setting> {
    settings.iter().map(|(name, value)| ((*name).into(), value.clone())).collect()
}

fn opened(set: &str, own: &[(&str, Setting)]) -> Box<dyn Environment> {
    open(&format!("routing/{set}"), Split::Test, 1, &settings(own)).unwrap()
}

const TOGETHER: &str = "";
const ONE_BY_ONE: &str = "-sequential";

/// An environment that plays this instance, by its own type.
fn playing(instance: Instance, leaving: &str) -> Routing {
    let own = [("capacity", Setting::Whole(instance.capacity.into()))];
    let mut routing = typed(&format!("{}{leaving}", instance.customers()), &own);
    routing.begin(0, instance);
    routing
}

fn typed(set: &str, own: &[(&str, Setting)]) -> Routing {
    let settings = settings(own);
    let choice =
        crate::Choice { set: Some(set), split: Split::Test, instances: 1, settings: &settings };
    environment::open(&choice).unwrap()
}

fn saved(routing: &dyn Environment) -> Vec<u8> {
    let mut state = Vec::new();
    routing.save(0, &mut state);
    state
}

/// What a message tells of a state: rows `[N, d]`, and which actions are available `[A, U]`.
fn told(routing: &dyn Environment, state: &[u8]) -> (Vec<f32>, Vec<u16>, Observation) {
    let (shape, mut seen) = (routing.spec().shape, Observation::default());
    routing.observe(state, 0, EntitySet::MAX, &mut seen);
    let mut rows = vec![0.0; shape.entities * shape.features];
    for entity in crate::observation::members(seen.entities) {
        let row = &mut rows[entity * shape.features..][..shape.features];
        seen.rows.write_dense(seen.row_of(entity), row);
    }
    let codes = |set: &u128| (0..shape.actions).map(|action| (*set >> action & 1) as u16).collect();
    let available: Vec<Vec<u16>> = seen.available.iter().map(codes).collect();
    (rows, available.concat(), seen)
}

/// Plays by a rule to the end: how often vehicles were sent home, customers left.
fn follow(routing: &mut dyn Environment, rule: usize) -> usize {
    let mut random = generator(1);
    let agents = routing.spec().shape.agents;
    let depot = routing.spec().shape.tasks as u8 - 1;
    let (mut allocation, mut actions, mut sent_home) = (vec![0; agents], vec![0; agents], 0);
    while !routing.episode(0).done {
        let state = saved(routing);
        routing.allocate(rule, &state, &mut random, &mut allocation);
        assert!(routing.scripted(&state, &allocation, &mut random, &mut actions));
        sent_home += allocation.iter().filter(|task| **task == depot).count();
        let step = routing.step(0, &actions, &mut random).unwrap();
        assert!(step.tasks_changed && step.reward <= 0.0);
    }
    sent_home
}

#[test]
fn instances_optimum_and_greedy_are_the_recorded_ones() {
    let mut with_places = 0;
    for Recorded { seed, n, redraws, depot, customers, demands, .. } in recorded() {
        let (instance, drawn_again) = Instance::drawn(seed, n, 25, 4);
        assert_eq!(drawn_again, redraws, "{seed}");
        let (Some(depot), Some(customers), Some(demands)) = (depot, customers, demands) else {
            continue;
        };
        with_places += 1;
        assert_eq!(instance.places, [vec![depot], customers].concat(), "{seed}");
        assert_eq!(instance.demands, [vec![0], demands].concat(), "{seed}");
    }
    assert_eq!(with_places, 44);
    for record in recorded() {
        let seed = record.seed;
        let instance = Instance::drawn(seed, record.n, 25, 4).0;
        let mut routing = playing(instance.clone(), ONE_BY_ONE);
        let sent_home = follow(&mut routing, 1);
        let episode = routing.episode(0);
        let length = -episode.episode_return;
        assert!((length - record.greedy).abs() < 1e-9, "{seed}: {length}");
        assert_eq!(sent_home, record.greedy_reloads, "{seed}");
        let best = optimum(&instance, 4).unwrap();
        assert!((best - record.optimum_le4_routes).abs() < 1e-9, "{seed}: {best}");
        assert_eq!(episode.metrics[0], Some(length / best));
        assert!(record.ortools_default.is_none_or(|length| length > best - 1e-6), "{seed}");
    }
}

/// Means over all thousand instances of a size, from another program.
#[test]
fn one_vehicle_to_the_nearest_is_as_far_off_as_measured_elsewhere() {
    for (customers, measured) in [(5, 1.1383), (8, 1.2121), (10, 1.2422)] {
        let mut routing = playing(Instance::drawn(1, customers, 25, 4).0, ONE_BY_ONE);
        let ratio = |number: usize| {
            let instance = routing.measured(customers, number);
            routing.begin(0, instance);
            follow(&mut routing, 0);
            let episode = routing.episode(0);
            assert_eq!(episode.metrics[2], Some(1.0), "one vehicle drives everything");
            episode.metrics[0].unwrap()
        };
        let mean = (0..1_000).map(ratio).sum::<f64>() / 1_000.0;
        assert!((mean - measured).abs() < 1e-4, "{customers} customers: {mean}");
    }
}

/// The shortest way through all customers from where a vehicle is, if it may go home whenever it likes.
fn by_all_orders(instance: &Instance, left: &[usize], at: usize, room: u8, trips: usize) -> f64 {
    if left.is_empty() {
        return instance.distance(at, 0);
    }
    let go = |next: usize, from: usize, room: u8, trips: usize| {
        let rest: Vec<usize> = left.iter().copied().filter(|other| *other != next).collect();
        let room = room - instance.demands[next];
        instance.distance(from, next) + by_all_orders(instance, &rest, next, room, trips)
    };
    let onward = left.iter().filter(|next| instance.demands[**next] <= room);
    let onward = onward.map(|next| go(*next, at, room, trips)).fold(f64::INFINITY, f64::min);
    if at == 0 || trips == 1 {
        return onward;
    }
    let home = instance.distance(at, 0);
    let again = left.iter().map(|next| home + go(*next, 0, instance.capacity, trips - 1));
    again.fold(onward, f64::min)
}

#[test]
fn nothing_is_shorter_than_the_optimum() {
    for seed in 0..12 {
        let customers = 1 + seed as usize % 6;
        let instance = Instance::drawn(seed, customers, 12, 4).0;
        for trips in 1..=4 {
            let left: Vec<usize> = (1..=customers).collect();
            let best = by_all_orders(&instance, &left, 0, 12, trips);
            let found = optimum(&instance, trips);
            match found {
                Some(found) => assert!((found - best).abs() < 1e-12, "{seed}: {found}, {best}"),
                None => assert_eq!(best, f64::INFINITY),
            }
        }
    }
    assert_eq!(optimum(&Instance::drawn(1, 16, 30, 4).0, 4), None, "it would take too long");
    assert_eq!(optimum(&Instance::default(), 4), None);
}

#[test]
fn all_sets_hold_to_the_laws() {
    for set in ["5-15x1", "50x8", "100x1"] {
        assert_eq!(conformance::check(&*opened(set, &[]), 3, 4), Ok(()), "{set}");
    }
    for set in ["5-15", "1", "10", "20", "31"] {
        for leaving in [TOGETHER, ONE_BY_ONE] {
            for vehicles in [4, 24] {
                let own =
                    [("vehicles", Setting::Whole(vehicles)), ("capacity", Setting::Whole(60))];
                let routing = opened(&format!("{set}{leaving}"), &own);
                assert_eq!(conformance::check(&*routing, 3, 4), Ok(()), "{set}{leaving}");
            }
        }
    }
}

#[test]
fn rules_give_the_same_from_a_state_and_from_its_rows() {
    let (mut reader, mut random) = (frames::reader(), generator(5));
    for leaving in [TOGETHER, ONE_BY_ONE] {
        for (rule, Rule { name, .. }) in rules::RULES.iter().enumerate() {
            let mut routing = opened(&format!("5-15{leaving}"), &[]);
            routing.reset(0, &mut random);
            while !routing.episode(0).done {
                let state = saved(&*routing);
                let (rows, available, Observation { present, open_tasks, .. }) =
                    told(&*routing, &state);
                let frame = Frame {
                    rows: &rows,
                    stride: FEATURES.len(),
                    agents: 4,
                    tasks: 16,
                    present,
                    open_tasks: open_tasks as u32,
                    available: &available,
                };
                let (mut own, mut read) = ([0; 4], [0; 6]);
                routing.allocate(rule, &state, &mut random, &mut own);
                reader.read(&frame).unwrap();
                reader.allocate(rule, &mut random, &mut read).unwrap();
                assert_eq!(read[..4], own, "{name}");
                assert_eq!(read[4..], [UNASSIGNED; 2]);
                // A vehicle that nobody drives is sent nowhere, and the others have all customers.
                reader.read(&Frame { present: present & !1, ..frame }).unwrap();
                reader.allocate(rule, &mut random, &mut read).unwrap();
                assert_eq!(read[0], UNASSIGNED);
                let mut actions = [0; 4];
                routing.scripted(&state, &own, &mut random, &mut actions);
                routing.step(0, &actions, &mut random).unwrap();
            }
        }
    }
}

/// What is rebuilt from rows is played on as the tour that they show: the same may be done, and the same way is left.
#[test]
fn tours_are_rebuilt_from_their_rows() {
    let mut random = generator(6);
    // Shares of 47 come to a little less than whole numbers.
    for (leaving, capacity) in [(TOGETHER, 25), (ONE_BY_ONE, 47)] {
        let capacity = [("capacity", Setting::Whole(capacity))];
        let mut routing = opened(&format!("5-15{leaving}"), &capacity);
        let mut other = routing.open(1, Split::Test);
        routing.reset(0, &mut random);
        let mut rounds = 0;
        while !routing.episode(0).done {
            let state = saved(&*routing);
            let rebuilt = |state: &[u8], hidden: EntitySet| {
                let (rows, available, Observation { present, open_tasks, .. }) =
                    told(&*routing, state);
                let present = present & !hidden;
                let (stride, agents, tasks) = (FEATURES.len(), 4, 16);
                let frame = Frame {
                    rows: &rows,
                    stride,
                    agents,
                    tasks,
                    present,
                    open_tasks: open_tasks as u32,
                    available: &available,
                };
                // Others than this environment's, and what no tour comes to: a vehicle is laden beyond what it holds.
                let mut laden = rows.clone();
                laden[observation::LOAD] = 1.5;
                assert_eq!(routing.rebuilt(&Frame { agents: 3, ..frame }), None);
                assert_eq!(routing.rebuilt(&Frame { tasks: 15, ..frame }), None);
                assert_eq!(routing.rebuilt(&Frame { rows: &laden, ..frame }), None);
                routing.rebuilt(&frame)
            };
            let shown = rebuilt(&state, 0).unwrap();
            assert_eq!(rebuilt(&shown, 0).as_ref(), Some(&shown));
            // Without a vehicle, or the depot, nothing is known.
            assert_eq!((rebuilt(&state, 1), rebuilt(&state, 1 << 19)), (None, None));
            let (rows, available, seen) = told(&*routing, &state);
            let (own_rows, own_available, own) = told(&*routing, &shown);
            assert_eq!((own_available, own.open_tasks), (available, seen.open_tasks));
            assert!(rows.iter().zip(&own_rows).all(|(one, other)| (one - other).abs() < 1e-6));
            other.load(0, &shown).unwrap();
            let left = |routing: &mut dyn Environment| {
                let before = -routing.episode(0).episode_return;
                follow(routing, 0);
                -routing.episode(0).episode_return - before
            };
            let mut own = routing.open(1, Split::Test);
            own.load(0, &state).unwrap();
            assert!((left(&mut *own) - left(&mut *other)).abs() < 1e-5);
            let (mut goals, mut actions) = ([0; 4], [0; 4]);
            routing.allocate(1, &state, &mut random, &mut goals);
            routing.scripted(&state, &goals, &mut random, &mut actions);
            routing.step(0, &actions, &mut random).unwrap();
            rounds += 1;
        }
        assert!(rounds > 2);
    }
}

#[test]
fn frames_that_show_no_tour_are_refused() {
    let mut routing = opened("5", &[]);
    routing.reset(0, &mut generator(5));
    let (rows, available, Observation { present, .. }) = told(&*routing, &saved(&*routing));
    let frame = Frame {
        rows: &rows,
        stride: FEATURES.len(),
        agents: 4,
        tasks: 16,
        present,
        open_tasks: 1,
        available: &available,
    };
    let mut reader = frames::reader();
    let mut read = |frame: &Frame<'_>| reader.read(frame);
    assert_eq!(read(&frame), Ok(()));
    assert_eq!(read(&Frame { available: &[], ..frame }), Err(FrameError::BadLength));
    assert_eq!(read(&Frame { rows: &rows[..30], ..frame }), Err(FrameError::BadLength));
    assert_eq!(read(&Frame { stride: 11, ..frame }), Err(FrameError::BadLength));
    for (entity, column, value, refusal) in [
        (0, 3, f32::NAN, FrameError::NonFinite { entity: 0 }),
        (2, 0, 0.0, FrameError::BadRow { entity: 2 }),
        (4, 1, 0.0, FrameError::BadRow { entity: 4 }),
    ] {
        let mut rows = rows.clone();
        rows[FEATURES.len() * entity + column] = value;
        assert_eq!(read(&Frame { rows: &rows, ..frame }), Err(refusal));
    }
    let many = vec![1; 4 * 34];
    assert_eq!(read(&Frame { tasks: 33, available: &many, ..frame }), Err(FrameError::TooLarge));
    reader.read(&frame).unwrap();
    assert_eq!(reader.allocate(0, &mut generator(0), &mut [0; 3]), Err(FrameError::BadLength));
}

/// Rows that no routing has: nothing is given but what is open and available.
#[test]
fn rules_stand_frames_without_a_depot_with_several_and_without_subtasks() {
    let mut routing = opened("9", &[]);
    routing.reset(0, &mut generator(5));
    let (mut rows, available, seen) = told(&*routing, &saved(&*routing));
    let (present, open_tasks) = (seen.present, seen.open_tasks as u32);
    let frame = Frame {
        rows: &rows.clone(),
        stride: FEATURES.len(),
        agents: 4,
        tasks: 16,
        present: present & !(1 << 19),
        open_tasks,
        available: &available,
    };
    // The first customer is a depot as well.
    rows[4 * FEATURES.len() + 1..][..2].copy_from_slice(&[0.0, 1.0]);
    let vehicles = Frame { tasks: 0, present: 0b1111, open_tasks: 0, available: &[1; 4], ..frame };
    let of_two = Frame { rows: &rows, present: present & !(1 << 19), ..frame };
    for (frame, given) in [(frame, true), (of_two, true), (vehicles, false)] {
        for rule in 0..rules::RULES.len() {
            let (mut reader, mut allocation) = (frames::reader(), [0; 4]);
            reader.read(&frame).unwrap();
            reader.allocate(rule, &mut generator(0), &mut allocation).unwrap();
            let offered = |(agent, task): (usize, &u8)| {
                *task == UNASSIGNED || available[agent * 17 + 1 + usize::from(*task)] != 0
            };
            assert!(allocation.iter().enumerate().all(offered), "{allocation:?}");
            assert_eq!(allocation.iter().any(|task| *task != UNASSIGNED), given, "{rule}");
        }
    }
}

/// All vehicles leave at once, to the customers that are nearest to them together.
#[test]
fn by_the_hungarian_method_ways_are_shortest_together() {
    let mut routing = playing(in_a_row(6, 25), TOGETHER);
    let (state, mut allocation) = (saved(&routing), [0; 4]);
    routing.allocate(2, &state, &mut generator(0), &mut allocation);
    let mut sorted = allocation;
    sorted.sort_unstable();
    assert_eq!(sorted, [0, 1, 2, 3], "the four nearest of six");
    follow(&mut routing, 2);
    let told = routing.episode(0);
    assert_eq!((told.steps, told.metrics[2]), (2, Some(4.0)), "all four leave, and two go on");
}

/// Customers to the right of the depot in a row, which ask for 5 each.
fn in_a_row(customers: usize, capacity: u8) -> Instance {
    let places = (0..=customers).map(|place| [place as f64 / 16.0, 0.0]).collect();
    let demands = [vec![0], vec![5; customers]].concat();
    Instance { places, demands, capacity }
}

/// What agents may do now, as sets of places.
fn open_places(routing: &Routing) -> Vec<Vec<usize>> {
    let mut seen = Observation::default();
    routing.observe(&saved(routing), 0, EntitySet::MAX, &mut seen);
    let layout =
        Layout { vehicles: 4, customers: routing.spec().shape.tasks - 1, sequential: true };
    let places = |open: &u128| {
        (0..=layout.customers).filter(|place| open >> layout.action_to(*place) & 1 == 1).collect()
    };
    seen.available.iter().map(places).collect()
}

#[test]
fn a_vehicle_leaves_the_depot_while_nobody_is_outside() {
    let mut random = generator(1);
    let mut routing = playing(in_a_row(4, 10), TOGETHER);
    let all = vec![1, 2, 3, 4];
    assert_eq!(open_places(&routing), vec![all.clone(); 4]);
    // Action 2 leads to customer 2; agents 1 and 2 head for the same one, and the first gets it.
    let step = routing.step(0, &[0, 2, 2, 0], &mut random).unwrap();
    assert_eq!(step.reward, -0.125);
    assert_eq!(open_places(&routing), [vec![], vec![0, 1, 3, 4], vec![], vec![]]);
    routing.step(0, &[0, 4, 0, 0], &mut random).unwrap();
    assert_eq!(open_places(&routing)[1], [0], "it is full");
    // Nobody moves: all are sent home, since nobody may serve.
    routing.step(0, &[0; 4], &mut random).unwrap();
    assert_eq!(open_places(&routing), vec![vec![1, 3]; 4]);
    let step = routing.step(0, &[1, 3, 0, 0], &mut random).unwrap();
    assert!(step.terminated && !step.timed_out);
    let episode = routing.episode(0);
    // Out to 4 and back, to 1 and back, to 3 and back.
    assert_eq!(episode.episode_return, -(8.0 + 2.0 + 6.0) / 16.0);
    assert_eq!(episode.metrics[1..], [1.0, 2.0, 2.0, 3.0, 1.0].map(Some));
    assert!(episode.done && !episode.timed_out && episode.steps == 4);

    let mut routing = playing(in_a_row(4, 10), ONE_BY_ONE);
    routing.step(0, &[1, 0, 0, 0], &mut random).unwrap();
    assert_eq!(
        open_places(&routing),
        [vec![0, 2, 3, 4], vec![2, 3, 4], vec![2, 3, 4], vec![2, 3, 4]]
    );
    // Nobody moves: whoever has the shortest way to a customer goes.
    routing.step(0, &[0; 4], &mut random).unwrap();
    assert_eq!(open_places(&routing)[0], [0]);
}

#[test]
fn rows_tell_how_often_vehicles_still_have_to_leave() {
    let mut random = generator(1);
    let mut routing = playing(in_a_row(4, 10), TOGETHER);
    let trips = |routing: &Routing| {
        let (rows, ..) = told(routing, &saved(routing));
        rows.chunks_exact(FEATURES.len()).take(4).map(|row| [row[12], row[13]]).collect::<Vec<_>>()
    };
    // Demands are 5 each.
    assert_eq!(trips(&routing), [[2.0, 2.0]; 4]);
    routing.step(0, &[0, 2, 0, 0], &mut random).unwrap();
    assert_eq!(trips(&routing), [[1.0, 1.0], [1.0, 2.0], [1.0, 1.0], [1.0, 1.0]]);
    routing.step(0, &[0, 4, 0, 0], &mut random).unwrap();
    assert_eq!(trips(&routing), [[1.0, 1.0]; 4], "it is full");
}

#[test]
fn while_learning_waves_after_the_first_cost_something() {
    let return_of = |split, set: &str| {
        let mut routing = open(&format!("routing/{set}"), split, 1, &settings(&[])).unwrap();
        routing.reset(0, &mut generator(4));
        follow(&mut *routing, 0);
        let episode = routing.episode(0);
        let [length, waves] = [1, 3].map(|metric| episode.metrics[metric].unwrap());
        (episode.episode_return + length, waves)
    };
    let (costs, waves) = return_of(Split::Train, "15");
    assert!(waves > 1.0 && (costs - (1.0 - waves)).abs() < 1e-9, "{costs}, {waves} waves");
    assert_eq!(return_of(Split::Test, "15").0, 0.0);
    assert_eq!(return_of(Split::Train, "15x1").0, 0.0, "trips of one vehicle are no waves");
    assert_eq!(return_of(Split::Train, "15-sequential").0, 0.0);
}

#[test]
fn symmetries_turn_the_square_and_nothing_else() {
    let routing = playing(Instance::drawn(7, 6, 25, 4).0, TOGETHER);
    let state = saved(&routing);
    let rows = |turn| {
        let mut seen = Observation::default();
        routing.observe(&state, turn, EntitySet::MAX, &mut seen);
        let mut dense = Vec::new();
        seen.rows.write_all(FEATURES.len(), &mut dense);
        dense
    };
    let plain = rows(0);
    let mut shown = vec![plain.clone()];
    for turn in 1..8 {
        let turned = rows(turn);
        for (one, other) in plain.chunks(FEATURES.len()).zip(turned.chunks(FEATURES.len())) {
            assert_eq!((&one[..3], &one[5..]), (&other[..3], &other[5..]));
            let middle = |row: &[f32]| (row[3] - 0.5).hypot(row[4] - 0.5);
            assert!((middle(one) - middle(other)).abs() < 1e-6);
        }
        assert!(!shown.contains(&turned), "turn {turn} is another one");
        shown.push(turned);
    }
    // The half turn comes first: whoever looks twice looks by it.
    for (one, other) in plain.chunks(FEATURES.len()).zip(shown[1].chunks(FEATURES.len())) {
        assert!([3, 4].iter().all(|part| (one[*part] + other[*part] - 1.0).abs() < 1e-6));
    }
}

#[test]
fn agents_without_a_place_to_go_to_stay() {
    let routing = playing(in_a_row(3, 25), TOGETHER);
    let (state, mut actions) = (saved(&routing), [9; 4]);
    let mut random = generator(1);
    // The depot, where it is already; nothing; a subtask that is none; a customer.
    assert!(routing.scripted(&state, &[3, UNASSIGNED, 30, 1], &mut random, &mut actions));
    assert_eq!(actions, [0, 0, 0, 2]);
}

#[test]
fn what_cannot_be_set_is_refused_and_named() {
    let refused = |set: &str, own: &[(&str, Setting)]| {
        let opened = open(&format!("routing/{set}"), Split::Train, 1, &settings(own));
        opened.map(drop).unwrap_err().to_string()
    };
    for set in ["0", "101", "5-", "15-5", "-", "many", "5-15-20", "-sequential", "15x", "x4"] {
        assert!(refused(set, &[]).starts_with(&format!("no set `{set}`; there are")), "{set}");
    }
    assert!(refused("5", &[("vehicles", Setting::Whole(25))]).contains("from 1 to 24"));
    assert!(refused("5x25", &[]).contains("from 1 to 24"));
    assert!(
        refused("31", &[]).contains("`capacity`") && opened("31x8", &[]).spec().shape.agents == 8
    );
    for (set, customers, capacity) in
        [("15x1", 15, 25), ("16x1", 31, 30), ("50x1", 50, 40), ("99-100x1", 100, 50)]
    {
        let routing = typed(set, &[]);
        let Shape { agents, tasks, .. } = routing.spec().shape;
        assert_eq!((agents, tasks), (1, customers + 1), "{set}");
        assert_eq!(routing.measured(15, 0).capacity, capacity, "{set}");
    }
    for (vehicles, capacity) in [(4, 8), (1, 22)] {
        let own = [("vehicles", Setting::Whole(vehicles)), ("capacity", Setting::Whole(capacity))];
        assert!(refused("15", &own).contains("`capacity` is at least 9"), "{vehicles}");
    }
    assert!(refused("5", &[("wave_cost", Setting::Number(-1.0))]).contains("from 0 to 100"));
    assert!(refused("5", &[("waves", Setting::Whole(1))]).contains("unknown field `waves`"));
}

/// The same instances as four vehicles have, whose optimum is of four trips; a rule that sends one of the four drives alike.
#[test]
fn one_vehicle_alone_drives_all_trips() {
    let [four, one] = ["13-sequential", "13x1"].map(|set| {
        let mut routing = typed(set, &[]);
        let mut lengths = Vec::new();
        for number in 0..20 {
            let instance = routing.measured(13, number);
            routing.begin(0, instance.clone());
            follow(&mut routing, 0);
            let episode = routing.episode(0);
            lengths.push((instance, episode.metrics[0], episode.episode_return));
        }
        lengths
    });
    assert_eq!(four, one);
    assert!(one.iter().all(|(_, over_optimum, _)| over_optimum.is_some_and(|over| over >= 1.0)));
}

/// A hundred customers are a hundred and one subtasks: sets of them are wider than those of messages, and every rule serves all.
#[test]
fn a_hundred_customers_are_served_by_every_rule() {
    for (set, vehicles) in [("100x1", 1), ("100x24", 24)] {
        let mut routing = typed(set, &[]);
        for rule in 0..routing.spec().rules.len() {
            let instance = routing.measured(100, rule);
            routing.begin(0, instance);
            let (mut offers, mut seen) = (Vec::new(), Observation::default());
            let state = saved(&routing);
            assert_eq!(routing.offers(&state, &mut offers).count_ones(), 100);
            routing.observe(&state, 0, EntitySet::MAX, &mut seen);
            assert_eq!((seen.tasks(), seen.rows.len()), (101, vehicles + 101));
            assert_eq!(offers, vec![seen.open_tasks; vehicles], "everybody may go everywhere");
            follow(&mut routing, rule);
            let episode = routing.episode(0);
            assert!(episode.done && episode.metrics[0].is_none(), "{set} {rule}");
        }
    }
}

#[test]
fn bytes_that_are_no_tour_are_refused() {
    let mut routing = playing(Instance::drawn(3, 5, 25, 4).0, TOGETHER);
    follow(&mut routing, 1);
    let state = saved(&routing);
    assert_eq!(routing.load(0, &state), Ok(()));
    assert!(matches!(routing.load(0, &[]), Err(StateError::Length { found: 0, .. })));
    assert!(matches!(routing.load(0, &[9]), Err(StateError::Version { found: 9, .. })));
    // Whatever byte changes: it is refused, or an episode goes on from there.
    let mut refused = 0;
    for place in 1..state.len() {
        for bit in 0..8 {
            let mut other = state.clone();
            other[place] ^= 1 << bit;
            if routing.load(0, &other).is_err() {
                refused += 1;
                continue;
            }
            if !routing.episode(0).done {
                follow(&mut routing, 1);
            }
        }
    }
    assert!(refused > 100, "{refused}");
    let mut larger = opened("6", &[]);
    assert!(matches!(larger.load(0, &state), Err(StateError::Impossible(_))));
}
