//! The laws of all environments, sets and settings, rewards, and what is observed.

use std::collections::BTreeMap;

use super::super::scenarios::SETS;
use crate::random::generator;
use crate::registry::Setting;
use crate::{Environment, EnvironmentError, Split, conformance, open};

fn opened(set: &str, settings: &[(&str, Setting)]) -> Box<dyn Environment> {
    try_open(set, settings).unwrap_or_else(|error| panic!("{set}: {error}"))
}

fn try_open(
    set: &str,
    settings: &[(&str, Setting)],
) -> Result<Box<dyn Environment>, EnvironmentError> {
    let settings: BTreeMap<_, _> =
        settings.iter().map(|(name, value)| (name.to_string(), value.clone())).collect();
    open(&format!("skirmish/{set}"), Split::Train, 1, &settings)
}

fn text(value: &str) -> Setting {
    Setting::Text(value.into())
}

#[test]
fn all_sets_hold_to_the_laws() {
    for set in SETS.split(' ').chain(["1m", "5m_vs_6m", "1c3s5z", "16s16z", "12-16sz-symmetric"]) {
        for aim in ["entities", "distance", "tags"] {
            let checked = conformance::check(&*opened(set, &[("aim", text(aim))]), 3, 1);
            assert_eq!(checked, Ok(()), "{set} {aim}");
        }
    }
    let odd = [
        ("rules", text("smaclite")),
        ("intents", Setting::Flag(false)),
        ("spread", Setting::Flag(true)),
        ("extra_seed", Setting::Whole(7)),
    ];
    assert_eq!(conformance::check(&*opened("6-8MMM-disadvantage", &odd), 5, 3), Ok(()));
}

#[test]
fn what_cannot_be_set_up_is_refused_in_a_line() {
    for set in ["", "3-8xy", "0m", "m", "9-3sz", "40m", "3d", "2s3z_vs_", "3-8sz-hard", "25m8d"] {
        let error = try_open(set, &[]).map(|_| ()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("no set `{set}`")) && !error.contains('\n'), "{error}");
    }
    for setting in [("own_losses", Setting::Number(-1.0)), ("aim", text("nobody"))] {
        assert!(matches!(try_open("2s3z", &[setting]), Err(EnvironmentError::Setting(_))));
    }
}

fn played(set: &str, seed: u64, rule: usize) -> crate::Episode {
    let mut skirmish = opened(set, &[]);
    let agents = skirmish.spec().shape.agents;
    let mut random = generator(seed);
    skirmish.reset(0, &mut random);
    let (mut allocation, mut actions) = (vec![u8::MAX; agents], vec![0; agents]);
    let mut state = Vec::new();
    while !skirmish.episode(0).done {
        state.clear();
        skirmish.save(0, &mut state);
        skirmish.allocate(rule, &state, &mut random, &mut allocation);
        assert!(skirmish.scripted(&state, &allocation, &mut random, &mut actions));
        skirmish.step(0, &actions, &mut random).unwrap();
    }
    skirmish.episode(0)
}

#[test]
fn scripts_win_some_battles() {
    for set in [
        "3-8sz",
        "3-8csz",
        "3-8MMM",
        "2s3z",
        "6-8sz-symmetric",
        "6-8sz-disadvantage",
        "6-8MMM-symmetric",
        "6-8MMM-disadvantage",
    ] {
        for rule in 0..3 {
            let episodes: Vec<_> = (0..400).map(|seed| played(set, seed, rule)).collect();
            let share = |holds: &dyn Fn(&crate::Episode) -> bool| {
                episodes.iter().filter(|e| holds(e)).count() as f64 / 400.0
            };
            let mean = episodes.iter().map(|e| e.episode_return).sum::<f64>() / 400.0;
            let steps = episodes.iter().map(|e| f64::from(e.steps)).sum::<f64>() / 400.0;
            println!(
                "{set} {rule}: won {:.3} killed {:.3} infiltrated {:.3} time {:.3} return {mean:.2} steps {steps:.1}",
                share(&|e| e.solved),
                share(&|e| e.cause == Some("killed")),
                share(&|e| e.cause == Some("infiltrated")),
                share(&|e| e.timed_out)
            );
        }
    }
}
