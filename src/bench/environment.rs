//! Environment steps per core-second.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use clap::Args;
use sortie_envs::random::generator;
use sortie_envs::{ENVIRONMENTS, Split, observe_and_step, open};

use super::{Figures, Measuring, Row, pin, thread_cpu_s};
use crate::failure::{Exit, Failure};

/// Instances that are stepped in turn.
const INSTANCES: usize = 16;
/// Rounds between two looks at the clock.
const ROUNDS: usize = 2_000;

/// Steps of an environment per core-second: random actions, features written at every step
#[derive(Debug, Args)]
pub(super) struct EnvironmentArguments {
    /// Environment and set of starts; every environment is possible
    #[arg(long, default_value = ENVIRONMENTS[0].name, value_name = "ENV[/SET]")]
    env: String,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

pub(super) fn measure(arguments: &EnvironmentArguments) -> Result<Figures, Failure> {
    let seed = arguments.measuring.common.seed;
    let mut environment = open(&arguments.env, Split::Train, INSTANCES, &BTreeMap::new())
        .map_err(|error| Failure::new(Exit::Usage, error.to_string()))?;
    let mut random = generator(seed);
    (0..INSTANCES).for_each(|instance| environment.reset(instance, &mut random));
    pin(arguments.measuring.pin)?;
    let mut rates = Vec::new();
    let until = Instant::now() + Duration::from_secs_f64(arguments.measuring.seconds);
    while rates.is_empty() || Instant::now() < until {
        let start_s = thread_cpu_s();
        std::hint::black_box(observe_and_step(&mut *environment, &mut random, ROUNDS));
        rates.push((ROUNDS * INSTANCES) as f64 / (thread_cpu_s() - start_s) / 1e6);
    }
    rates.sort_by(f64::total_cmp);
    // Slowest last, as for latencies: the tails are the bad ones.
    let at = |share: f64| rates[((rates.len() - 1) as f64 * (1.0 - share)).round() as usize];
    let row = Row {
        what: "env",
        case: arguments.env.clone(),
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
