//! Returns, metrics and their means over many episodes, of teams that act at random and by the script.

use sortie_envs::random::{below, generator};

use super::{opened, saved};

/// Mean and standard error over so many episodes of the return and of each metric.
fn measured(set: &str, episodes: usize, is_scripted: bool) -> Vec<(f64, f64)> {
    let mut world = opened(set, &[]);
    let mut random = generator(7);
    let mut actions = vec![0; world.spec().shape.agents];
    let mut sums = vec![(0.0, 0.0); 1 + world.spec().metrics.len()];
    for _ in 0..episodes {
        world.reset(0, &mut random);
        while !world.episode(0).done {
            if is_scripted {
                assert!(world.scripted(&saved(&*world), &[], &mut random, &mut actions));
            } else {
                actions.iter_mut().for_each(|action| *action = below(&mut random, 5) as u16);
            }
            world.step(0, &actions, &mut random).unwrap();
        }
        let episode = world.episode(0);
        let values = episode.metrics.iter().map(|value| value.unwrap());
        for (sum, value) in sums.iter_mut().zip([episode.episode_return].into_iter().chain(values))
        {
            *sum = (sum.0 + value, sum.1 + value * value);
        }
    }
    let count = episodes as f64;
    let moments = sums.iter().map(|(sum, squares)| {
        let mean = sum / count;
        (mean, ((squares / count - mean * mean) / count).sqrt())
    });
    moments.collect()
}

/// Means and standard errors that an implementation of its own was measured to have.
fn assert_returns(set: &str, is_scripted: bool, (mean, error): (f64, f64)) -> Vec<(f64, f64)> {
    let measured = measured(set, 2000, is_scripted);
    let (own_mean, own_error) = measured[0];
    let apart = (own_mean - mean).abs() / own_error.hypot(error);
    assert!(apart < 4.0, "{set}: {own_mean:.2} +- {own_error:.2} against {mean} +- {error}");
    measured
}

#[test]
fn random_teams_find_few_treasures() {
    assert_returns("treasure-4", false, (-7.7, 0.2));
    assert_returns("treasure-8", false, (-2.5, 0.4));
    assert_returns("treasure-12", false, (5.5, 0.5));
}

#[test]
fn the_script_takes_treasures_to_their_banks() {
    assert_returns("treasure-4", true, (115.0, 0.7));
    let measured = assert_returns("treasure-8", true, (246.0, 1.1));
    for ((name, want), (got, _)) in
        [("treasures", 28.0), ("deliveries", 26.0), ("collisions", 15.0)].iter().zip(&measured[1..])
    {
        assert!((got - want).abs() < 1.0, "{got} {name}");
    }
}

#[test]
fn rovers_that_know_their_goals_are_there_for_half_of_the_time() {
    for (set, random, script) in [
        ("rover-tower-8", (-7.6, 2.1), (133.1, 2.1)),
        ("rover-tower-14", (-7.0, 1.7), (131.8, 1.7)),
    ] {
        let wander = assert_returns(set, false, random);
        assert!((2.4..3.0).contains(&wander[1].0), "{set}: {wander:?}");
        let lead = assert_returns(set, true, script);
        assert!((14.0..14.7).contains(&lead[1].0), "{set}: {lead:?}");
    }
}

/// The random return is a step's, -3.17 +- 0.03, over 25 steps. The script is ours alone.
#[test]
fn agents_that_share_out_the_landmarks_cover_them() {
    assert_returns("navigation-3", false, (25.0 * -3.17, 25.0 * 0.03));
    let shared = measured("navigation-3", 2000, true);
    assert!((shared[0].0 + 39.4).abs() < 0.7 && shared[1].0 < 0.55, "{shared:?}");
}
