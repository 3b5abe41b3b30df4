//! What holds in every state of every episode.

use std::collections::HashSet;

use sortie_envs::Environment;
use sortie_envs::UNASSIGNED;
use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    AgentKind, BuildingState, SaveTheCity, Status, random_allocation,
};

use super::{environment, for_random_states, play_randomly};

#[test]
fn no_two_objects_share_a_cell() {
    for_random_states(4, |city, label| {
        let mut cells = HashSet::new();
        let city = city.city(0);
        let agents = city.agents.iter().map(|agent| (agent.x, agent.y));
        for cell in agents.chain(city.buildings.iter().map(|it| (it.x, it.y))) {
            assert!(cell.0 < 16 && cell.1 < 16 && cells.insert(cell), "{label}: {cell:?}");
        }
    });
}

#[test]
fn buildings_keep_their_invariants() {
    for_random_states(4, |city, label| {
        for it in city.city(0).buildings {
            assert!((0.0..=1.0).contains(&it.health), "{label}: {it:?}");
            assert!((0.0..=1.0).contains(&it.fire), "{label}: {it:?}");
            assert_eq!(it.status, Status::of_health(it.health), "{label}");
            let clock = (it.to_next_fire, it.since_last_fire);
            if it.is_open() {
                assert!((1..=it.period).contains(&clock.0), "{label}: {it:?}");
                assert_eq!(clock.0 + clock.1, it.period, "{label}");
            } else {
                assert_eq!((it.fire, clock), (0.0, (1000, 0)), "{label}");
            }
        }
    });
}

#[test]
fn closed_buildings_never_change() {
    for seed in 0..40 {
        let mut city = environment("2-5a_2-5b", seed);
        let mut before: Vec<BuildingState> = city.city(0).buildings.to_vec();
        play_randomly(&mut city, seed, |city, _| {
            let now = city.city(0).buildings;
            for (was, is) in before.iter().zip(now).filter(|(was, _)| !was.is_open()) {
                assert_eq!(was, is, "seed {seed}");
            }
            before = now.to_vec();
        });
    }
}

#[test]
fn availability_follows_from_the_kind_and_the_fire() {
    for_random_states(4, |city, label| {
        for agent in city.city(0).agents {
            let can = |action: u16| agent.available >> action & 1 == 1;
            assert!(can(0) && !(can(9) && can(10)), "{label}");
            assert_eq!(can(11), agent.kind == AgentKind::Generalist && can(9), "{label}");
            assert!(agent.kind == AgentKind::Generalist || (5..9).all(|far| !can(far)), "{label}");
        }
    });
}

#[test]
fn health_rewards_add_up_to_the_change_of_health() {
    for seed in 0..40 {
        let mut city = environment("2-5a_2-5b", seed);
        let health = |city: &SaveTheCity| -> f64 {
            city.city(0).buildings.iter().map(|building| building.health).sum()
        };
        let before = health(&city);
        let mut rewards = 0.0;
        play_randomly(&mut city, seed, |city, _| {
            rewards += city.task_rewards(0).iter().sum::<f64>()
        });
        let metrics = city.metrics(0);
        let events = 0.5 * f64::from(metrics.fires_extinguished)
            - 20.0 * f64::from(metrics.buildings_burned)
            + 20.0 * f64::from(metrics.buildings_completed);
        let expected = (10.0 * (health(&city) - before) + events) * 20.0 / 56.0;
        assert!((rewards - expected).abs() < 1e-9, "seed {seed}: {rewards} and {expected}");
    }
}

#[test]
fn open_tasks_are_the_open_buildings() {
    for_random_states(2, |city, label| {
        assert_eq!(city.open_tasks(0), city.city(0).open_tasks(), "{label}");
        for (task, building) in city.city(0).buildings.iter().enumerate() {
            assert_eq!(city.open_tasks(0) >> task & 1 == 1, building.is_open(), "{label}");
        }
    });
}

#[test]
fn the_random_allocation_gives_open_buildings_or_nothing() {
    let mut rng = generator(7);
    for_random_states(2, |city, label| {
        let mut allocation = [0; 64];
        random_allocation(city.city(0), &mut rng, &mut allocation);
        let open = city.open_tasks(0);
        let team = city.agent_count(0);
        for &task in &allocation[..team] {
            let fits = if open == 0 { task == UNASSIGNED } else { open >> task & 1 == 1 };
            assert!(fits, "{label}: {task}");
        }
        assert!(allocation[team..].iter().all(|&task| task == UNASSIGNED), "{label}");
    });
}

#[test]
fn the_same_seed_gives_the_same_episodes() {
    let (mut one, mut other) = (environment("2-8a_2-8b", 5), environment("2-8a_2-8b", 5));
    for episode in 0..5 {
        let mut states = Vec::new();
        play_randomly(&mut one, episode, |city, _| states.push(format!("{:?}", city.city(0))));
        let mut states = states.into_iter();
        play_randomly(&mut other, episode, |city, _| {
            assert_eq!(states.next(), Some(format!("{:?}", city.city(0))));
        });
        assert_eq!(states.next(), None);
        one.reset(0, &mut generator(episode));
        other.reset(0, &mut generator(episode));
    }
}

#[test]
fn instances_do_not_disturb_each_other() {
    let set = sortie_envs::save_the_city::ScenarioSet::named("2-8a_2-8b").unwrap();
    let constants = Default::default();
    let mut many = SaveTheCity::new(set.clone(), constants, 5, 3).unwrap();
    let mut single = SaveTheCity::new(set, constants, 1, 3).unwrap();
    many.reset(2, &mut generator(9));
    single.reset(0, &mut generator(9));
    let (mut random, mut same) = (generator(4), generator(4));
    for step in 0..20 {
        assert_eq!(format!("{:?}", many.city(2)), format!("{:?}", single.city(0)), "step {step}");
        for instance in [0, 1, 3, 4] {
            many.step(instance, &[0; 8], &mut generator(step)).unwrap();
        }
        let outcome = many.step(2, &[0; 8], &mut random);
        assert_eq!(single.step(0, &[0; 8], &mut same), outcome);
        assert_eq!(many.task_rewards(2), single.task_rewards(0));
    }
    many.reset(0, &mut random);
    assert_eq!(format!("{:?}", many.city(2)), format!("{:?}", single.city(0)));
}
