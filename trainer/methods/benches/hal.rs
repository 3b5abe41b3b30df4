//! Times the updates of HAL's presets on crafting, and the steps between them.
//!
//! `cargo bench -p sortie-methods --bench hal -- [UPDATES]`. One thread, published sizes. Prints CPU-seconds of an update, on
//! average over all networks as often as each learns, and of what an update's environment steps cost.
#![allow(clippy::print_stdout, reason = "a program of its own")]

use std::error::Error;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};
use sortie_envs::Split;
use sortie_learn::play::Play;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;
use sortie_learn::session::Opening;
use sortie_learn::{Method, Now};
use sortie_methods::find;
use sortie_methods::hal::{Config, Hal};

fn main() -> Result<(), Box<dyn Error>> {
    let updates: u64 = std::env::args().find_map(|word| word.parse().ok()).unwrap_or(300);
    for (name, preset) in [("hal", "fast"), ("hal", "paper"), ("h-dqn", "paper")] {
        let [learning, acting] = seconds(name, preset, updates)?;
        println!(
            "{name}, {preset}: {:.2} ms an update, {:.2} ms its steps",
            1e3 * learning,
            1e3 * acting
        );
    }
    Ok(())
}

/// CPU-seconds of an update and of the steps before it, once everything learns.
fn seconds(name: &str, preset: &str, updates: u64) -> Result<[f64; 2], Box<dyn Error>> {
    let setup = find(name).ok_or("no such method")?.preset(preset)?;
    let config: Config = setup.own()?;
    let world = sortie_envs::open("crafting/iron", Split::Train, 1, &setup.environment.settings)?;
    let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
    let mut hal = Hal::new(config.clone(), &opening)?;
    let random =
        (0..setup.environment.instances as u64).map(|index| generator(1, Purpose::Rollout, index));
    let mut play = Play::new(&*world, &mut hal, random.collect());
    let mut now = Now { env_steps: 0, of: setup.run.steps };
    // Until the meta-controller learns, goals are known whose classes can be told apart, and more than was drawn is kept.
    let first = config.replay.first.max(400);
    let warm = first + (config.meta.first + 400) * config.replay.steps_per_update;
    let end = warm + updates * config.replay.steps_per_update;
    let (mut learning, mut acting) = (Duration::ZERO, Duration::ZERO);
    while now.env_steps < end {
        let start = cpu_time();
        now.env_steps += play.round(&mut hal, now, &mut EpisodeCounts::default())?;
        let between = cpu_time();
        hal.update(play.environment(), now)?;
        if now.env_steps > warm {
            acting += between - start;
            learning += cpu_time() - between;
        }
    }
    Ok([learning, acting].map(|time| time.as_secs_f64() / updates as f64))
}

fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}
