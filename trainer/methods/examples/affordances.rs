//! Learns HAL, and looks at what it believes it can reach: `affordances [METHOD[/PRESET]] [ENV/SET] [SEED] [STEPS]
//! [KEY=VALUE]...`
//!
//! Prints how training goes, then the mask beside the truth in states of measured episodes, and the success with all
//! combinations of chance in actions and goals.

#![expect(clippy::print_stdout, reason = "it prints what it finds")]

use std::error::Error;

use sortie_envs::{Environment, Split};
use sortie_learn::play::{Play, evaluate};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;
use sortie_learn::session::Opening;
use sortie_learn::{Method, Now};
use sortie_methods::find;
use sortie_methods::hal::{Hal, MaskCounts, MeasuredConfig};

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let (keys, words): (Vec<_>, Vec<_>) = words.into_iter().partition(|word| word.contains('='));
    let word = |place: usize, usual: &str| words.get(place).map_or(usual.to_owned(), String::clone);
    let (name, environment) = (word(0, "hal"), word(1, "crafting/iron"));
    let (name, preset) = name.split_once('/').unwrap_or((&name, "fast"));
    let entry = find(name).ok_or("no such method")?;
    let mut setup = entry.preset(preset)?;
    let (seed, steps): (u64, u64) = (word(2, "1").parse()?, word(3, "5000000").parse()?);
    for key in &keys {
        setup = entry.set(&setup, key)?;
    }
    let settings = &setup.environment.settings;
    let world = sortie_envs::open(&environment, Split::Train, 1, settings)?;
    let opening = Opening { setup: &setup, environment: &*world, seed, threads: 1 };
    let mut hal = Hal::new(setup.own()?, &opening)?;
    learn(&mut hal, &*world, setup.environment.instances, seed, steps)?;
    look(&hal, &*world, keys.iter().any(|key| key == "run.final_episodes=0"))
}

fn learn(
    hal: &mut Hal,
    world: &dyn Environment,
    instances: usize,
    seed: u64,
    steps: u64,
) -> Result<(), Box<dyn Error>> {
    let random = (0..instances as u64).map(|index| generator(seed, Purpose::Rollout, index));
    let mut play = Play::new(world, hal, random.collect());
    let (mut now, mut counts) = (Now { env_steps: 0, of: steps }, EpisodeCounts::default());
    let every = (steps / 10).max(1);
    while now.env_steps < steps {
        let before = now.env_steps / every;
        now.env_steps += play.round(hal, now, &mut counts)?;
        hal.update(play.environment(), now)?;
        if now.env_steps / every > before {
            let share = counts.solved as f64 / counts.episodes.max(1) as f64;
            let team = hal.measured(MeasuredConfig::default());
            let result = evaluate(world, &mut { team }, 50, 7)?;
            println!(
                "{:>8} steps: {share:.2} of {} training episodes solved, {:.2} of 50 measured ones, {:.1} milestones",
                now.env_steps, counts.episodes, result.success, result.metrics["milestones"]
            );
            counts = EpisodeCounts::default();
        }
    }
    Ok(())
}

fn look(hal: &Hal, world: &dyn Environment, is_short: bool) -> Result<(), Box<dyn Error>> {
    let mut team = hal.measured(MeasuredConfig::default());
    evaluate(world, &mut team, 100, 3)?;
    let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
    let all = |count: fn(&MaskCounts) -> u64| team.masks.iter().map(count).sum();
    let masks = world.spec().milestones.iter().map(String::as_str).zip(team.masks.iter().copied());
    let total = MaskCounts {
        afforded: all(|it| it.afforded),
        over_pruned: all(|it| it.over_pruned),
        others: all(|it| it.others),
        under_pruned: all(|it| it.under_pruned),
    };
    for (name, counts) in masks.chain([("all", total)]) {
        println!(
            "mask of {name}: {:.3} of {} over-pruned, {:.3} of {} under-pruned",
            share(counts.over_pruned, counts.afforded),
            counts.afforded,
            share(counts.under_pruned, counts.others),
            counts.others
        );
    }
    let chances = [(0.05, 0.05), (0.05, 0.0), (0.0, 0.05), (0.0, 0.0)];
    let all = chances.map(|(actions, goals)| {
        [false, true].map(|varied| MeasuredConfig { actions, goals, varied })
    });
    for chances in all.into_iter().flatten() {
        let mut team = hal.measured(chances.clone());
        let episodes = if is_short { 100 } else { 2_000 };
        let result = evaluate(world, &mut team, episodes, 1)?;
        println!(
            "{chances:?}: success {:.3} {:.3?}, {:.0} steps, {:?}",
            result.success, result.success_ci95, result.length_mean, result.failures
        );
    }
    Ok(())
}
