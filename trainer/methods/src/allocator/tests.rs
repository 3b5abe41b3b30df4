use sortie_envs::random::generator;
use sortie_envs::{Environment, Split, UNASSIGNED};
use sortie_learn::Now;
use sortie_learn::networks::{chances, draw};
use sortie_learn::play::{Play, Start, evaluate};
use sortie_learn::run::{EpisodeCounts, Reports};
use sortie_learn::subtasks::{AllocatedTeam, ScriptedAgents};
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::tape::Tape;

use super::deciding::{Asked, Group, Seen};
use super::greedy::Greedy;
use super::method::{Allocator, loss};
use super::*;

const INSTANCES: usize = 8;

fn routes(set: &str) -> Box<dyn Environment> {
    sortie_envs::open(&format!("routing/{set}"), Split::Train, 1, &Default::default()).unwrap()
}

/// A small method, four episodes from each start.
fn small(environment: &dyn Environment) -> Allocator {
    let mut setup = ALLOCATOR.preset("fast").unwrap();
    setup.environment.instances = INSTANCES;
    let mut config: Config = setup.own().unwrap();
    config.network = NetworkConfig { width: 16, layers: 1 };
    config.baseline.samples = 4;
    let opening = Opening { setup: &setup, environment, seed: 1, threads: 2 };
    Allocator::new(config, &opening).unwrap()
}

/// A method that has learned from so many rounds of episodes, and played one more.
fn played(environment: &dyn Environment, rounds: usize) -> Allocator {
    let mut method = small(environment);
    let random = (1..).map(generator).take(INSTANCES).collect();
    let mut play = Play::new(environment, &mut method, random);
    let now = Now { env_steps: 0, of: 100 };
    for round in 0..=rounds {
        play.round(&mut method, now, &mut EpisodeCounts::default()).unwrap();
        if round < rounds {
            method.update(environment, now).unwrap();
        }
    }
    method
}

#[test]
fn what_is_descended_has_the_slopes_of_advantage_times_logarithm_and_entropy() {
    let method = played(&*routes("4-6"), 0);
    // They do not add up to 0: episodes that chose alike would lose nothing.
    let advantages = [0.5, -1.0, 3.0, 1.5];
    let (network, group, weights) = (&method.network, &method.groups[0], &method.learner.online);
    let lost = |weights: &[f32]| {
        let mut tape = Tape::default();
        let mut pass = tape.begin(weights);
        loss(&mut pass, network, group, &advantages, (0.3, 0.25)).reported
    };
    let mut tape = Tape::default();
    let mut pass = tape.begin(&weights.values);
    let found = loss(&mut pass, network, group, &advantages, (0.3, 0.25));
    let mut gradient = vec![0.0; weights.values.len()];
    pass.backward(found.total, &mut gradient);
    for tensor in weights.tensors() {
        let mut slopes = gradient[tensor.range.clone()].iter();
        assert!(slopes.any(|slope| *slope != 0.0), "{}", tensor.name);
    }
    // Of all weights at once: those of single layers are too small for the rounding of the passes.
    assert_gradient("weights", &weights.values, &gradient, lost);
}

/// What was decided when is looked up by the decisions' own passes, all at once, with the same scores.
#[test]
fn scores_do_not_depend_on_what_is_decided_beside_them() {
    let method = played(&*routes("5-15"), 0);
    let (network, group, weights) = (&method.network, &method.groups[0], &method.learner.online);
    let (made, mut tape) = (&group.made, Tape::default());
    assert!(made.len() > 20, "{}", made.len());
    let mut pass = tape.begin(&weights.values);
    let tables = network.encode(&mut pass, &group.subtasks.rows);
    let scores = network.scores(&mut pass, tables, made);
    let columns = pass.size(scores)[1];
    for (scores, (offered, chosen)) in
        pass.values(scores).chunks_exact(columns).zip(made.offered.iter().zip(&made.chosen))
    {
        assert!(offered.count_ones() > 1 && offered >> chosen & 1 == 1);
        let chances = chances(scores, *offered);
        assert!((chances.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        for (place, chance) in chances.iter().enumerate() {
            assert_eq!(*chance > 0.0, offered >> place & 1 == 1, "{chances:?}");
        }
    }
}

#[test]
fn episodes_of_a_group_have_one_start_and_others_another() {
    let environment = routes("5-15");
    let mut method = small(&*environment);
    let random: Vec<_> = (1..).map(generator).take(INSTANCES).collect();
    let mut begun = random.clone();
    for (instance, random) in begun.iter_mut().enumerate() {
        method.begins(instance, random);
    }
    assert!(begun[..4].iter().all(|it| *it == random[0]));
    assert!(begun[4..].iter().all(|it| *it == random[4]));
}

#[test]
fn an_episode_is_as_good_as_it_is_better_than_its_group() {
    let mut method = small(&*routes("5-15"));
    method.returns.copy_from_slice(&[-1.0, -2.0, -3.0, -2.0, 5.0, 5.0, 5.0, 5.0]);
    let root = 0.5_f32.sqrt();
    let wanted = [1.0 / root, 0.0, -1.0 / root, 0.0, 0.0, 0.0, 0.0, 0.0];
    for (found, wanted) in method.advantages().iter().zip(wanted) {
        assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
    }
}

/// In rounds of random play every agent gets what it is offered, alone if it is for one; and vehicles that are alike leave
/// in their order.
#[test]
fn whatever_is_given_was_offered() {
    for set in ["5-15", "5-15-sequential", "40x8"] {
        let mut environment = routes(set).open(1, Split::Train);
        let agents = environment.spec().shape.agents;
        let method = small(&*environment);
        let (network, weights) = (&method.network, &*method.learner.online.values);
        let mut group = Group::default();
        let (mut random, mut offers, mut left_out) = (generator(3), Vec::new(), 0);
        for episode in 0..40 {
            environment.reset(0, &mut Start::of(2, episode).world);
            let (mut begins, mut before) = (true, vec![UNASSIGNED; agents]);
            loop {
                let mut state = Vec::new();
                environment.save(0, &mut state);
                let asked = [Asked { episode: 0, state: &state, before: &before }];
                let seen = Seen { environment: &*environment, turn: 0, states: &asked };
                let given = group.allocate((network, weights), seen, |scores, offered| {
                    draw(scores, offered, &mut random)
                });
                let exclusive = environment.offers(&state, &mut offers);
                let mut taken = 0;
                for (offer, task) in offers.iter().zip(&given[0]) {
                    assert!(*offer == 0 || offer >> task & 1 == 1);
                    assert!((taken & exclusive) >> task & 1 == 0);
                    taken |= 1 << task;
                }
                before.clone_from(&given[0]);
                let mut actions = vec![0; agents];
                environment.scripted(&state, &given[0], &mut random, &mut actions);
                // At first all are alike: nobody leaves behind one that stays.
                let stays: Vec<bool> = actions.iter().map(|action| *action == 0).collect();
                if std::mem::take(&mut begins) {
                    assert!(stays.is_sorted(), "{actions:?}");
                    left_out += stays.iter().filter(|stays| **stays).count();
                }
                if environment.step(0, &actions, &mut random).unwrap().done() {
                    break;
                }
            }
        }
        assert!((1..39 * agents).contains(&left_out), "{left_out}");
    }
}

#[test]
fn the_best_of_several_symmetries_is_no_worse_than_each() {
    let environment = routes("8");
    let method = played(&*environment, 20);
    let network = (&method.network, &*method.learner.online.values);
    let measured = |turns| {
        let mut allocator = Greedy::new(network);
        assert!(sortie_learn::subtasks::Allocate::choose_among(
            &mut allocator,
            turns,
            environment.spec()
        ));
        let agents = Box::new(ScriptedAgents::new(1));
        let mut team = AllocatedTeam::new(agents, Box::new(allocator), 1);
        evaluate(&*environment, &mut team, 60, 1).unwrap().return_mean
    };
    let [usual, one, two, all, more] = [None, Some(1), Some(2), Some(8), Some(99)].map(measured);
    assert_eq!((usual, all), (one, more));
    assert!(one < two && two < all, "{one} {two} {all}");
}

/// Of more subtasks too than deployed teams have.
#[test]
fn a_round_is_learned_from_once_all_episodes_are_over() {
    for set in ["5-15", "40x1"] {
        let environment = routes(set);
        let mut method = played(&*environment, 0);
        let before = method.learner.online.values.clone();
        assert!(method.groups.iter().all(|group| group.made.len() > 0));
        let reports = method.update(&*environment, Now { env_steps: 0, of: 100 }).unwrap();
        let after = method.learner.online.values.clone();
        assert!(after != before && after.iter().all(|weight| weight.is_finite()));
        assert!(reports.agents.len() == 1 && reports.decisions > 40);
        assert!(method.groups.iter().all(|group| group.made.len() == 0));
        let reports = method.update(&*environment, Now { env_steps: 0, of: 100 }).unwrap();
        assert_eq!((reports, &method.learner.online.values), (Reports::default(), &after));
    }
}
