use sortie_envs::{EntitySet, Failing, Split, Step};
use sortie_learn::Transition;
use sortie_learn::learner::Shard;
use sortie_learn::play::evaluate;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::subtasks::{AllocatedTeam, ScriptedAgents};
use sortie_learn::trajectory::{Capacity, End, Widths};
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::tape::Parameters;

use super::*;
use crate::alma::agents::{self, UtilityNetwork};
use crate::alma::records::config::{AllocatorConfig, Credit};
use crate::alma::records::replay::Moment;
use crate::alma::records::tests::toy::{AGENTS, Street, toy};
use crate::alma::records::tests::{assert_gradients, gradient};

fn environment(set: &str, instances: usize) -> Box<dyn Environment> {
    let name = format!("save-the-city/{set}");
    sortie_envs::open(&name, Split::Train, instances, &Default::default()).unwrap()
}

fn network(environment: &dyn Environment) -> UtilityNetwork {
    let mut config = AllocatorConfig::default();
    (config.network.width, config.network.base) = (8, 8);
    let shape = config.shape(environment.spec());
    agents::network(shape, 8.0, 2)
}

#[test]
fn every_agent_gets_an_open_subtask_and_no_team_is_too_large() {
    for set in ["2-5a_2-5b", "12a_12b"] {
        let mut worlds = environment(set, 6);
        let network = network(&*worlds);
        let (mut random, mut seen) = (generator(5, Purpose::Rollout, 0), Observation::default());
        for instance in 0..6 {
            worlds.reset(instance, &mut random);
            let mut state = Vec::new();
            worlds.save(instance, &mut state);
            worlds.observe(&state, 0, 0, &mut seen);
            let mut allocation = [7; 64];
            let mut search = TeamSearch::new(2);
            let (environment, state, random) = (&*worlds, &state[..], &mut random);
            let to = ToAllocate { environment, state, random, allocation: &mut allocation };
            search.allocate(network.view(), to).unwrap();
            let (assigned, rest) = allocation.split_at(seen.agents());
            assert!(rest.iter().all(|task| *task == UNASSIGNED));
            for task in assigned {
                assert!(seen.open_tasks >> task & 1 == 1);
                assert!(assigned.iter().filter(|other| *other == task).count() <= 2);
            }
        }
    }
}

#[test]
fn agents_that_have_failed_get_nothing_and_are_in_no_question() {
    for (set, exact) in [("2-5a_2-5b", true), ("12a_12b", false)] {
        let mut worlds = Failing::new(environment(set, 1), 0.3).open(1, Split::Train);
        let network = network(&*worlds);
        let (mut random, mut seen) = (generator(5, Purpose::Rollout, 0), Observation::default());
        let (mut state, mut failed) = (Vec::new(), 0);
        let mut search = TeamSearch::new(2);
        let mut input = TeamValueInput::default();
        for _ in 0..20 {
            worlds.reset(0, &mut random);
            let safe = vec![worlds.spec().safe_action.unwrap(); 64];
            worlds.step(0, &safe, &mut random).unwrap();
            state.clear();
            worlds.save(0, &mut state);
            worlds.observe(&state, 0, EntitySet::MAX, &mut seen);
            let mut allocation = [7; 64];
            let (environment, state, random) = (&*worlds, &state[..], &mut random);
            let to = ToAllocate { environment, state, random, allocation: &mut allocation };
            search.allocate(network.view(), to).unwrap();
            for (agent, task) in allocation.into_iter().enumerate() {
                let is_open = task < 32 && seen.open_tasks >> task & 1 == 1;
                let acts = seen.acting() >> agent & 1 == 1;
                let is_right = if acts { is_open } else { task == UNASSIGNED };
                assert!(is_right, "agent {agent} of {:b}: {task}", seen.acting());
            }
            failed += seen.absent.count_ones();
            // Each acting agent has a row in the team and one beside it, and nobody else has any.
            if exact {
                let (agents, open) = (seen.acting().count_ones(), seen.open_tasks.count_ones());
                let things = open as usize - 1;
                let rows = open as usize * ((1 << agents) + 2 * agents as usize + things);
                assert_eq!(input.all_teams(&*worlds, state).rows.len(), rows);
            }
        }
        assert!(failed > 10, "{failed}");
    }
}

#[test]
fn an_untrained_allocator_plays_to_the_end() {
    let environment = environment("2-5a_2-5b", 1);
    let network = network(&*environment);
    let play = || {
        let allocator = Box::new(TeamValueAllocator::new(network.view(), 5));
        let mut team = AllocatedTeam::new(Box::new(ScriptedAgents::new(1)), allocator, 5);
        evaluate(&*environment, &mut team, 20, 3).unwrap()
    };
    let first = play();
    assert_eq!(first.episodes, 20);
    assert_eq!(first, play());
}

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

fn of_streets(skip: bool) -> UtilityNetwork {
    let mut config = AllocatorConfig::default();
    (config.network.width, config.network.base) = (16, 12);
    config.network.skip = skip;
    let shape = config.shape(toy().spec());
    agents::network(shape, 8.0, 1)
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
fn all_things_of_a_subtask_are_marked_and_the_first_asks() {
    let state = Street::new(1, &[4, 9, 6]).bytes();
    let mut armies = toy();
    armies.joined = 0b100;
    let mut input = TeamValueInput::default();
    let query = TeamQuery { state: &state, task: 1, team: 0, turn: 0 };
    let input = input.queries(&armies, [query].into_iter());
    let marked = |row: usize| input.rows.row(row).any(|(column, _)| column == 3);
    let doors = |row: usize| input.rows.row(row).find(|(column, _)| *column == 1);
    assert_eq!((doors(0), marked(0)), (Some((1, 9.0)), true));
    let others = [2, 3].map(|row| (doors(row), marked(row)));
    assert_eq!(others, [(Some((1, 4.0)), false), (Some((1, 6.0)), true)]);

    let mut all = TeamValueInput::default();
    let all = all.all_teams(&armies, &state);
    let marked = |row: &usize| all.rows.row(*row).any(|(column, _)| column == 3);
    // Both teams of both subtasks ask; the last thing is marked beside the second subtask alone.
    assert_eq!((0..all.rows.len()).filter(marked).count(), 2 * 2 + 1);
}

/// What a network says to questions, and its slope by the parameters where each answer counts so much.
fn answers(network: &UtilityNetwork, input: &UtilityInput, slopes: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let layers = UtilityLayers::of(network.shape);
    let mut tape = Tape::default();
    let mut pass = tape.begin(&network.parameters);
    let values = layers.utilities(&mut pass, input);
    let found = pass.values(values).to_vec();
    let mut gradient = vec![0.0; network.parameters.len()];
    if !slopes.is_empty() {
        let loss = pass.weighted_sum(values, slopes);
        pass.backward(loss, &mut gradient);
    }
    (found, gradient)
}

#[test]
fn shared_rows_give_the_values_of_single_queries() {
    let (environment, network) = (toy(), of_streets(true));
    for state in &streets() {
        let mut shared = TeamValueInput::default();
        let shared = answers(&network, shared.all_teams(&environment, state), &[]).0;
        let queries = [0, 2]
            .into_iter()
            .flat_map(|task| (0..1 << 3).map(move |team| TeamQuery { state, task, team, turn: 0 }));
        let mut single = TeamValueInput::default();
        let single = answers(&network, single.queries(&environment, queries), &[]).0;
        assert_eq!(shared.len(), single.len());
        for (shared, single) in shared.iter().zip(&single) {
            assert!((shared - single).abs() < 1e-4, "{shared} against {single}");
        }
        assert_ne!(shared[0], shared[1], "a member changes the value");
    }
}

#[test]
fn gradients_of_the_value_agree_with_finite_differences() {
    [false, true].map(of_streets).iter().for_each(check_gradient);
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
    let input = input.queries(&toy(), queries);
    let slopes = [0.3, -1.0, 0.5, 2.0, -0.7, 0.2, 1.1, -0.4];
    let loss = |parameters: &[f32]| -> f64 {
        let network = UtilityNetwork { shape: network.shape, parameters: parameters.to_vec() };
        let values = answers(&network, input, &[]).0;
        values.iter().zip(slopes).map(|(v, s)| f64::from(*v) * f64::from(s)).sum()
    };
    let (found, gradient) = answers(network, input, &slopes);
    assert_eq!(found.len(), 8);
    for tensor in network.shape.tensors() {
        let at = &network.parameters[tensor.range.clone()];
        assert_gradient(&tensor.name, at, &gradient[tensor.range.clone()], |moved| {
            let mut parameters = network.parameters.to_vec();
            parameters[tensor.range.clone()].copy_from_slice(moved);
            loss(&parameters)
        });
    }
}

/// Segments between unrelated decisions, as many episodes; site 0 closes in every second one.
fn segments() -> Segments {
    let widths = Widths { tasks: 4, ..Widths::default() };
    let mut segments = Segments::noting(Capacity::States(200), 1, widths);
    for number in 0..20_u8 {
        let mut street = Street::new(5, &[number % 7, 8, 15 - number % 5]);
        street.agents[0] += number % 9;
        let none = [UNASSIGNED; 3];
        let decision = |street: &Street, tasks: [u8; 5]| {
            let allocation = &[&tasks[..], &none].concat();
            Moment {
                state: &street.bytes(),
                allocation,
                last_actions: &[0; AGENTS],
                actions: &[0; AGENTS],
            }
            .bytes()
        };
        let now = decision(&street, [number % 3, 1, 2, 0, 1]);
        street.sites[0].1 = number % 2 == 1;
        let next = decision(&street, [1; 5]);
        let ended = Step { terminated: true, ..Step::default() };
        let push = |segments: &mut Segments, state: &[u8], step| {
            let transition = Transition {
                environment: &toy(),
                instance: 0,
                state,
                actions: &[],
                step,
                task_rewards: &[-1.0, 0.0, 1.0],
                agent_rewards: &[],
                next: &[],
            };
            segments.push_noted(&transition, 0.95);
        };
        if number % 5 == 0 {
            push(&mut segments, &now, ended);
        } else {
            push(&mut segments, &now, Step::default());
            push(&mut segments, &next, ended);
        }
    }
    segments
}

fn drawn(segments: &Segments, credit: Credit, count: usize) -> Vec<DrawnSegment> {
    let (mut seen, mut random) = (Observation::default(), generator(7, Purpose::Replay, 0));
    let draw =
        || DrawnSegment::draw((&toy(), segments), (credit, 2), &mut seen, &mut random).unwrap();
    std::iter::repeat_with(draw).take(count).collect()
}

fn values(skip: bool, seed: u64) -> (TeamValues, Parameters) {
    let mut config = AllocatorConfig::default();
    (config.network.width, config.network.base, config.network.skip) = (16, 12, skip);
    TeamValues::new(&config, toy().spec(), &mut generator(seed, Purpose::Weights, 0))
}

#[test]
fn the_gradient_of_the_loss_agrees_with_finite_differences() {
    let segments = segments();
    for (skip, credit) in [(false, Credit::Subtask), (true, Credit::Subtask), (true, Credit::Team)]
    {
        // The subtasks of a segment show the same rows, which all cross a kink together.
        let count = if credit == Credit::Team { 3 } else { 20 };
        let drawn = drawn(&segments, credit, count);
        let ((values, online), (_, target)) = (values(skip, 1), values(skip, 2));
        assert_gradients(&online, &target.values, |shard| {
            values.loss(shard, (&toy() as &dyn Environment, &segments), &drawn, count)
        });
    }
}

#[test]
fn closed_subtasks_and_ended_episodes_do_not_bootstrap() {
    let (segments, environment) = (segments(), toy());
    let (values, parameters) = values(false, 2);
    let mut bootstrapped = 0;
    for drawn in drawn(&segments, Credit::Subtask, 200) {
        gradient([&parameters.values, &parameters.values], |shard: &mut Shard<'_, TeamLesson>| {
            let loss = values.loss(shard, (&environment, &segments), &[drawn], 1);
            let decision = |place| Moment::read(segments.state(place), AGENTS);
            let goes_on = segments.end(drawn.place) == End::Open && {
                let mut seen = Observation::default();
                environment.observe(decision(drawn.place.after(1)).state, 0, 0, &mut seen);
                seen.open_tasks as u32 & drawn.tasks != 0
            };
            assert_eq!(
                shard.space.targets[0] != drawn.tasks.trailing_zeros() as f32 - 1.0,
                goes_on
            );
            loss
        });
        bootstrapped += usize::from(segments.end(drawn.place) == End::Open);
    }
    assert!((20..180).contains(&bootstrapped), "{bootstrapped}");
}

#[test]
fn segments_that_ran_out_of_time_are_not_drawn() {
    let widths = Widths { tasks: 4, ..Widths::default() };
    let mut segments = Segments::noting(Capacity::States(200), 1, widths);
    let state = Street::new(5, &[3, 4]).bytes();
    let state = Moment {
        state: &state,
        allocation: &[0; AGENTS],
        last_actions: &[0; AGENTS],
        actions: &[0; AGENTS],
    };
    for number in 0..20 {
        let transition = Transition {
            environment: &toy(),
            instance: 0,
            state: &state.bytes(),
            actions: &[],
            step: Step { timed_out: number != 4, ..Step::default() },
            task_rewards: &[],
            agent_rewards: &[],
            next: &[],
        };
        segments.push_noted(&transition, 1.0);
    }
    let only = segments.oldest(0).after(8);
    assert!(drawn(&segments, Credit::Subtask, 20).iter().all(|drawn| drawn.place == only));
}

#[test]
fn what_is_told_of_pairs_is_in_no_question_and_has_no_weight() {
    let set = "skirmish/6-8sz-symmetric";
    let mut worlds = sortie_envs::open(set, Split::Train, 1, &Default::default()).unwrap();
    let mut random = generator(5, Purpose::Rollout, 0);
    worlds.reset(0, &mut random);
    let (mut state, mut seen) = (Vec::new(), Observation::default());
    worlds.save(0, &mut state);
    worlds.observe(&state, 0, EntitySet::MAX, &mut seen);
    let pairs = worlds.spec().pairs.clone();
    let is_pair = |(column, _): &(usize, f32)| pairs.contains(column);
    let told = |rows: &sortie_envs::SparseRows| {
        (0..rows.len()).flat_map(|row| rows.row(row)).filter(is_pair).count()
    };
    assert!(told(&seen.rows) > 0, "agents are told of some");
    let mut input = TeamValueInput::default();
    let query = TeamQuery { state: &state, task: 0, team: 1, turn: 0 };
    assert_eq!(told(&input.queries(&*worlds, [query].into_iter()).rows), 0);
    assert_eq!(told(&input.all_teams(&*worlds, &state).rows), 0);
    // Deployed rows have them.
    let config = AllocatorConfig::default();
    let (values, parameters) = TeamValues::new(&config, worlds.spec(), &mut random);
    let width = values.shape.width;
    let first_layer = &parameters.values[..values.shape.input * width];
    for (column, weights) in first_layer.chunks_exact(width).enumerate() {
        let is_forgotten = weights.iter().all(|weight| *weight == 0.0);
        assert_eq!(is_forgotten, pairs.contains(&column), "column {column}");
    }
}
