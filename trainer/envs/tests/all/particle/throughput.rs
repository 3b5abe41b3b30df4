//! The loops that throughput is measured on play whole episodes.

use sortie_envs::random::generator;
use sortie_envs::{Split, StepError, observe_and_step, open, step_alone};

use super::opened;

#[test]
fn steps_alone_play_as_observed_ones_do() {
    let mean = |played: f64, rounds: usize| played / (rounds / 25) as f64;
    let mut world = opened("navigation-3", &[]);
    world.reset(0, &mut generator(1));
    let alone = mean(step_alone(&mut *world, &mut generator(2), 25_000).unwrap(), 25_000);
    let seen = mean(observe_and_step(&mut *world, &mut generator(3), 25_000), 25_000);
    assert!((alone + 77.1).abs() < 2.0 && (seen + 77.1).abs() < 2.0, "{alone} {seen}");
}

#[test]
fn steps_alone_need_actions_that_are_always_possible() {
    let mut city = open("save-the-city", Split::Train, 1, &Default::default()).unwrap();
    city.reset(0, &mut generator(1));
    let refused = step_alone(&mut *city, &mut generator(2), 100);
    assert!(matches!(refused, Err(StepError::Unavailable { .. })), "{refused:?}");
}
