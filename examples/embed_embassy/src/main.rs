//! A plan on a Cortex-M4F under embassy: a task that decides whenever its timer says so, and leaves the processor to
//! others in between. `embed_steps` is what it decides.
//!
//! `cargo run --release` plays five steps in QEMU.
#![no_std]
#![no_main]

mod timer;

use cortex_m::singleton;
use cortex_m_semihosting::{debug, hprintln};
use embassy_executor::Spawner;
use embassy_time::{Duration, Ticker};
use embed_steps::{ARENA, Arena, Steps};
use panic_halt as _;

/// A decision every so often.
const PERIOD: Duration = Duration::from_millis(20);

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    timer::start();
    // In static memory. There is one `main`, so that nobody else has it.
    let steps = singleton!(: Arena = ARENA).and_then(|arena| Steps::new(arena).ok());
    match steps.map(|steps| decide(steps)) {
        Some(Ok(task)) => spawner.spawn(task),
        _ => debug::exit(debug::EXIT_FAILURE),
    }
}

#[embassy_executor::task]
async fn decide(mut steps: Steps<'static>) {
    let mut ticker = Ticker::every(PERIOD);
    for _ in 0..5 {
        ticker.next().await;
        // And here your motors are told.
        steps.next(|decided| hprintln!("{}", decided));
    }
    debug::exit(debug::EXIT_SUCCESS);
}
