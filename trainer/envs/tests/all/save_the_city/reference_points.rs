//! Success rates and returns that the dissertation's environment was measured to give.

use sortie_envs::DecisionPoints;
use sortie_envs::Environment;
use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    AllocationRule, EpisodeMetrics, SaveTheCity, ScriptedTeam, random_actions,
};

use super::environment;

/// Means over episodes: success, return, length.
struct Means {
    success: f64,
    episode_return: f64,
    length: f64,
}

fn means(episodes: u32, mut play: impl FnMut(&mut SaveTheCity) -> EpisodeMetrics) -> Means {
    let mut city = environment("2-5a_2-5b", 1);
    let mut means = Means { success: 0.0, episode_return: 0.0, length: 0.0 };
    let share = 1.0 / f64::from(episodes);
    let mut random = generator(3);
    for _ in 0..episodes {
        city.reset(0, &mut random);
        let metrics = play(&mut city);
        means.success += share * f64::from(u8::from(metrics.solved));
        means.episode_return += share * metrics.episode_return;
        means.length += share * f64::from(metrics.steps);
    }
    means
}

fn scripted(rule: AllocationRule, episodes: u32) -> Means {
    let mut random = generator(4);
    let mut team = ScriptedTeam::new(rule, DecisionPoints::default(), generator(2));
    means(episodes, |city| {
        team.restart();
        let mut actions = [0; 5];
        let mut tasks_changed = false;
        while !city.is_done(0) {
            team.act(city.city(0), tasks_changed, &mut actions);
            tasks_changed = city.step(0, &actions, &mut random).unwrap().tasks_changed;
        }
        *city.metrics(0)
    })
}

#[test]
fn scripted_teams_succeed_as_often_as_the_reference() {
    let random = scripted(AllocationRule::Random, 1000);
    assert!(random.success < 0.05, "{}", random.success);
    let heuristic = scripted(AllocationRule::Heuristic, 2000);
    assert!((heuristic.success - 0.496).abs() < 0.04, "{}", heuristic.success);
    assert!((heuristic.episode_return - 7.5).abs() < 1.5, "{}", heuristic.episode_return);
    let coordinated = scripted(AllocationRule::Coordinated, 2000);
    assert!((0.70..=0.80).contains(&coordinated.success), "{}", coordinated.success);
    assert!((coordinated.episode_return - 13.8).abs() < 1.5, "{}", coordinated.episode_return);
}

#[test]
fn teams_without_a_plan_lose_as_much_as_the_reference() {
    let mut rng = generator(2);
    let random = means(1000, |city| {
        let mut actions = [0; 5];
        while !city.is_done(0) {
            random_actions(city.city(0), &mut rng, &mut actions);
            city.step(0, &actions, &mut rng).unwrap();
        }
        *city.metrics(0)
    });
    assert_eq!(random.success, 0.0);
    assert!((random.episode_return + 43.3).abs() < 1.5, "{}", random.episode_return);
    assert!((random.length - 82.3).abs() < 4.0, "{}", random.length);
    let idle = means(1000, |city| {
        while !city.is_done(0) {
            city.step(0, &[0; 5], &mut rng).unwrap();
        }
        *city.metrics(0)
    });
    assert!((idle.episode_return + 44.2).abs() < 1.5, "{}", idle.episode_return);
    assert!((idle.length - 80.8).abs() < 4.0, "{}", idle.length);
}
