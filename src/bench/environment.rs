//! Environment steps per core-second.

use std::time::{Duration, Instant};

use clap::Args;
use sortie_envs::random::generator;
use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet, observe_and_step};
use sortie_envs::{Environment, ObservationBuffers};

use super::{Figures, Measuring, Row, pin, thread_cpu_s};
use crate::environment::ScenarioSetName;
use crate::failure::Failure;

/// Cities that are stepped in turn.
const INSTANCES: usize = 16;
/// Rounds between two looks at the clock.
const ROUNDS: usize = 2_000;

/// Steps of an environment per core-second: random actions, features written at every step
#[derive(Debug, Args)]
pub(super) struct EnvironmentArguments {
    /// Environment and scenario set
    #[arg(long, default_value = "save-the-city", value_name = "ENV[/SET]")]
    env: String,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

pub(super) fn measure(arguments: &EnvironmentArguments) -> Result<Figures, Failure> {
    let name = ScenarioSetName::parse(&arguments.env)?;
    let set = ScenarioSet::named(name.set()).map_err(Failure::bug)?;
    let seed = arguments.measuring.common.seed;
    let mut city =
        SaveTheCity::new(set, Constants::default(), INSTANCES, seed).map_err(Failure::bug)?;
    let mut buffers = ObservationBuffers::new(&city.shape());
    let mut rng = generator(seed);
    pin(arguments.measuring.pin)?;
    let mut rates = Vec::new();
    let until = Instant::now() + Duration::from_secs_f64(arguments.measuring.seconds);
    while rates.is_empty() || Instant::now() < until {
        let start_s = thread_cpu_s();
        std::hint::black_box(observe_and_step(&mut city, &mut buffers, &mut rng, ROUNDS));
        rates.push((ROUNDS * INSTANCES) as f64 / (thread_cpu_s() - start_s) / 1e6);
    }
    rates.sort_by(f64::total_cmp);
    // Slowest last, as for latencies: the tails are the bad ones.
    let at = |share: f64| rates[((rates.len() - 1) as f64 * (1.0 - share)).round() as usize];
    let row = Row {
        what: "env",
        case: name.to_string(),
        engine: "sortie",
        version: env!("CARGO_PKG_VERSION").to_string(),
        p50: at(0.5),
        p99: at(0.99),
        p999: None,
        max: at(1.0),
        unit: "million steps per core-second",
    };
    Ok(Figures { rows: vec![row], ..Figures::default() })
}
