//! Success rates, returns and lengths that the dissertation's environment was measured to give.

use sortie_envs::Environment;
use sortie_envs::group_matching::{GroupMatching, Parameters, RIGHT, Ring, STAY, walk};
use sortie_envs::random::{below, generator};

/// Means over 3,000 episodes: success, return, length; and the longest.
fn means(
    noise: f64,
    mut act: impl FnMut(&Parameters, Ring<'_>, &mut [u16]),
) -> (f64, f64, f64, u32) {
    const EPISODES: u32 = 3000;
    let parameters = Parameters { noise, ..Parameters::default() };
    let mut world = GroupMatching::new(parameters, 1).unwrap();
    let (mut random, mut actions) = (generator(11), [STAY; 8]);
    let (mut sums, mut longest) = ((0.0, 0.0, 0.0), 0);
    for _ in 0..EPISODES {
        world.reset(0, &mut random);
        while !world.is_done(0) {
            act(&parameters, world.ring(0), &mut actions);
            world.step(0, &actions, &mut random).unwrap();
        }
        let metrics = world.metrics(0);
        sums.0 += f64::from(u8::from(metrics.solved));
        sums.1 += metrics.episode_return;
        sums.2 += f64::from(metrics.steps);
        longest = longest.max(metrics.steps);
    }
    let mean = |sum: f64| sum / f64::from(EPISODES);
    (mean(sums.0), mean(sums.1), mean(sums.2), longest)
}

/// The third and fifth row of the table; standard errors are about 0.03 and 0.03.
#[test]
fn the_walking_team_is_as_good_as_the_reference() {
    let (success, episode_return, length, longest) = means(0.1, walk);
    assert_eq!(success, 1.0);
    assert!((episode_return - 3.64).abs() < 0.12, "{episode_return}");
    assert!((length - 3.40).abs() < 0.12, "{length}");
    assert!(longest < 25, "{longest}");
    let (success, episode_return, length, longest) = means(0.0, walk);
    assert_eq!((success, longest), (1.0, 3));
    assert!((episode_return - 3.72).abs() < 0.12, "{episode_return}");
    assert!((length - 2.33).abs() < 0.06, "{length}");
}

#[test]
fn teams_without_a_plan_lose_as_much_as_the_reference() {
    let mut random = generator(12);
    let mut at_random = |_: &Parameters, _: Ring<'_>, actions: &mut [u16]| {
        actions.iter_mut().for_each(|action| *action = below(&mut random, 3) as u16);
    };
    let still = |_: &Parameters, _: Ring<'_>, actions: &mut [u16]| actions.fill(STAY);
    let around = |_: &Parameters, _: Ring<'_>, actions: &mut [u16]| actions.fill(RIGHT);
    for (what, (success, episode_return, length, _)) in [
        ("stay", means(0.1, still)),
        ("around", means(0.1, around)),
        ("random", means(0.1, &mut at_random)),
        ("random without noise", means(0.0, &mut at_random)),
    ] {
        assert!(success < 0.01, "{what}: {success}");
        assert!((episode_return + 4.97).abs() < 0.08, "{what}: {episode_return}");
        assert!((length - 50.0).abs() < 0.25, "{what}: {length}");
    }
}
