//! Environment steps per core-second.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use clap::Args;
use sortie_envs::random::generator;
use sortie_envs::{ENVIRONMENTS, Split, observe_and_step, open, step_alone};

use super::{Figures, Measuring, Row, pin, thread_cpu_s};
use sortie_cli::failure::{Exit, Failure};

/// Instances that are stepped in turn.
const INSTANCES: usize = 16;
/// Rounds between two looks at the clock.
const ROUNDS: usize = 2_000;

/// Steps of an environment per core-second: random actions, features written at every step, and steps alone where any action is possible
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
    let (world, random) = (&mut *environment, &mut random);
    let seconds = arguments.measuring.seconds;
    let seen = rates(seconds, || Some(observe_and_step(world, random, ROUNDS)));
    let alone = rates(seconds, || step_alone(world, random, ROUNDS).ok());
    let named = |case: String, rates| Some(row(case, rates?));
    let alone = named(format!("{}, steps alone", arguments.env), alone);
    let rows = named(arguments.env.clone(), seen).into_iter().chain(alone).collect();
    Ok(Figures { rows, ..Figures::default() })
}

/// Million steps per core-second, the fastest first: the tails are the bad ones, as for latencies.
fn rates(seconds: f64, mut play: impl FnMut() -> Option<f64>) -> Option<Vec<f64>> {
    let mut rates = Vec::new();
    let until = Instant::now() + Duration::from_secs_f64(seconds);
    while rates.is_empty() || Instant::now() < until {
        let start_s = thread_cpu_s();
        std::hint::black_box(play()?);
        rates.push((ROUNDS * INSTANCES) as f64 / (thread_cpu_s() - start_s) / 1e6);
    }
    rates.sort_by(|one, other| other.total_cmp(one));
    Some(rates)
}

fn row(case: String, rates: Vec<f64>) -> Row {
    let at = |share: f64| rates[((rates.len() - 1) as f64 * share).round() as usize];
    Row {
        what: "env",
        case,
        engine: "sortie",
        version: env!("CARGO_PKG_VERSION").to_string(),
        p50: at(0.5),
        p99: at(0.99),
        p999: None,
        max: at(1.0),
        unit: "million steps per core-second",
    }
}
