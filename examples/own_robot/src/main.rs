//! A robot's program: a cart that is to come to rest at 0, whose policy another process serves.
//!
//! ```sh
//! sortie serve examples/embed_c/cart.plan --domain cart
//! SORTIE_DOMAIN=cart cargo run --manifest-path examples/own_robot/Cargo.toml
//! SORTIE_DOMAIN=cart cargo run --release --manifest-path examples/own_robot/Cargo.toml -- latency
//! ```

mod direct;
mod latency;

use std::env;
use std::error::Error;
use std::time::{Duration, Instant};

use sortie_core::wire::AnswerStatus;
use sortie_ipc::{ClientSettings, Domain, Expected, PolicyClient};

use crate::direct::Direct;

/// What the program gives and wants: a policy of anything else is refused.
const EXPECTED: Expected<'_> =
    Expected { inputs: &[("position", 1)], outputs: &[("force", 1)], actions: 0 };
const STEPS: u32 = 300;
/// Time from step to step.
const PERIOD: Duration = Duration::from_millis(5);
/// Seconds that a step takes for the simulated cart.
const SECONDS: f32 = 0.2;
/// Metres per second squared at a force of 1.
const PUSH: f32 = 3.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [] => drive(),
        ["latency"] => latency::measure(Duration::ZERO),
        ["latency", microseconds] => latency::measure(Duration::from_micros(microseconds.parse()?)),
        [latency::ANSWER, folder] => latency::answer(folder.as_ref()),
        _ => Err("expected nothing, or `latency [MICROSECONDS]`".into()),
    }
}

/// The policy of the domain that the environment names.
fn connect() -> Result<PolicyClient, sortie_ipc::Error> {
    let domain = Domain::new(&env::var("SORTIE_DOMAIN").unwrap_or("default".into()))?;
    PolicyClient::connect(&domain, &EXPECTED, &ClientSettings::default())
}

/// The control loop. Without an answer in time it acts by the fallback, and goes on.
fn drive() -> Result<(), Box<dyn Error>> {
    let mut policy = connect()?;
    let mut direct = Direct::new()?;
    let (mut same, mut took) = (0, Vec::new());
    let (mut position, mut velocity) = (1.0, 0.0);
    let mut next = Instant::now();
    for step in 0..STEPS {
        if step % 100 == 0 {
            (position, velocity) = (1.0, 0.0);
            policy.begin_episode();
            direct.begin_episode();
        }
        let asked = Instant::now();
        let action = policy.decide(&[&[position]], &[])?;
        took.push(asked.elapsed());
        let (status, force) = (action.status, action.outputs[0]);
        let is_same = force.to_bits() == direct.force(position)?.to_bits();
        same += u32::from(is_same && status == AnswerStatus::Answered);
        if step % 20 == 0 {
            println!("step {step:3}  position {position:7.4}  force {force:7.4}  {status:?}");
        }
        velocity += PUSH * force * SECONDS;
        position += velocity * SECONDS;
        next += PERIOD;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    latency::print("decision", &mut took);
    println!("{same} of {STEPS} answers are those of a direct call");
    Ok(())
}
