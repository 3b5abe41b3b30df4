//! Trains on an environment by value factorisation, and says how well and at what cost.
//!
//! `cargo bench -p sortie-learn --bench value_factorisation -- METHOD [key=value ...]`: METHOD is `qmix`, `vdn`,
//! `refil`, `fixed-oracle` or `randomised-oracle`, keys are `env`, `seed`, `steps`, `every` and those of the
//! configuration, as in `learning_rate=0.002`. Each line has environment steps, processor seconds without evaluation, success,
//! mean length and mean return of 200 greedy episodes; the last one those of 2,000.
#![allow(clippy::print_stdout, reason = "a program of its own")]

use std::error::Error;

use rustix::time::{ClockId, clock_gettime};
use sortie_envs::{Environment, Split};
use sortie_learn::methods::value_factorisation::{
    Config, MixerKind, Network, Partitions, evaluate, train,
};
use sortie_nn::random::stream;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut method, mut settings) = ("qmix".to_owned(), toml::Table::new());
    let (mut environment, mut seed, mut steps, mut every) =
        ("group-matching/8x6x2".to_owned(), 1, 100_000, 10_000);
    for argument in std::env::args().skip(1).filter(|argument| argument != "--bench") {
        match argument.split_once('=') {
            None => method = argument,
            Some(("env", name)) => environment = name.to_owned(),
            Some(("seed", number)) => seed = number.parse()?,
            Some(("steps", number)) => steps = number.parse()?,
            Some(("every", number)) => every = number.parse()?,
            Some(_) => settings.extend(argument.parse::<toml::Table>()?),
        }
    }
    let mut config: Config = settings.try_into()?;
    (config.mixer, config.partitions) = match &*method {
        "qmix" => (config.mixer, Partitions::None),
        "vdn" => (MixerKind::Sum, Partitions::None),
        "refil" => (config.mixer, Partitions::Drawn),
        "fixed-oracle" => (config.mixer, Partitions::Companions),
        "randomised-oracle" => (config.mixer, Partitions::DrawnCompanions),
        other => return Err(format!("no method `{other}`").into()),
    };
    let environment = sortie_envs::open(&environment, Split::Train, 1, &Default::default())?;

    let (mut spent, mut since, mut next) = (0.0, seconds(), every);
    let network = train(&*environment, &config, steps, seed, |progress| {
        if progress.steps >= next {
            next += every;
            spent += seconds() - since;
            tell(&*environment, progress.network, (progress.steps, spent), 200, seed);
            since = seconds();
        }
    });
    spent += seconds() - since;
    tell(&*environment, &network, (steps, spent), 2000, seed);
    Ok(())
}

/// Processor seconds of this program.
fn seconds() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Evaluates and prints a line.
fn tell(
    environment: &dyn Environment,
    network: &Network,
    (steps, spent): (u64, f64),
    episodes: usize,
    seed: u64,
) {
    let result = evaluate(environment, network, episodes, &mut stream(seed, 4, steps));
    let (success, length) = (result.success, result.length);
    println!("{steps:8} {spent:7.1} s {success:.4} {length:6.2} {:6.2}", result.episode_return);
}
