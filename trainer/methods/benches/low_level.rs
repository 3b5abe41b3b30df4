//! Seconds and arithmetic of one step of the published low level at SaveTheCity's sizes.
//!
//! `cargo bench -p sortie-methods --bench low_level -- [alma|flat|copa] [STEPS]`. The batch is of real
//! episodes: random allocations every five steps, every other episode played by script.
#![allow(clippy::print_stdout, reason = "a program of its own")]

mod windows;

use std::error::Error;
use std::time::Instant;

use sortie_learn::random::{Purpose, generator};
use sortie_methods::alma::agents::Conditioning;
use sortie_methods::alma::windows::NO_TASK;
use sortie_methods::alma::windows::low_level::coaching::CoachConfig;
use sortie_methods::alma::windows::low_level::{LowLevel, LowLevelConfig};
use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};

fn main() -> Result<(), Box<dyn Error>> {
    let (mut method, mut rounds) = ("alma".to_owned(), 5_usize);
    for argument in std::env::args().skip(1).filter(|argument| argument != "--bench") {
        match &*argument {
            "alma" | "flat" | "copa" => method = argument,
            steps => rounds = steps.parse()?,
        }
    }
    let mut windows = windows::record()?;
    let mut config = LowLevelConfig::default();
    if method != "alma" {
        config.conditioning = Conditioning::None;
        let states = windows.entity_task.chunks_exact_mut(windows.shape.entities);
        states.for_each(|tasks| tasks[..windows.shape.agents].fill(NO_TASK));
    }
    let weights = &mut generator(1, Purpose::Weights, 0);
    let mut learner = LowLevel::new(config, windows.shape, weights);
    if method == "copa" {
        learner.add_coach(&CoachConfig::default(), weights);
    }
    let peak = peak();
    println!("matrix products reach {peak:.1} GFLOP/s on one thread");
    let mut draws = generator(1, Purpose::Replay, 0);
    let report = learner.learn(&windows, 1, &mut draws);
    println!("{} terms, loss {:.4}", report.terms, report.loss);
    for threads in [1, 2] {
        let mut seconds = Vec::new();
        for _ in 0..rounds {
            let before = learner.operations();
            let (start, worked) = (Instant::now(), processor_seconds());
            learner.learn(&windows, threads, &mut draws);
            let operations = (learner.operations() - before) as f64 / 1e9;
            let elapsed = start.elapsed().as_secs_f64();
            seconds.push((processor_seconds() - worked, elapsed, operations));
        }
        seconds.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (median, elapsed, operations) = seconds[rounds / 2];
        let rate = operations / median;
        println!(
            "{threads} threads: {median:.3} processor seconds a step (best {:.3}), {elapsed:.3} s by the \
             clock; {operations:.1} GFLOP, {rate:.1} GFLOP/s of a processor, {:.0} % of the peak",
            seconds[0].0,
            100.0 * rate / peak,
        );
    }
    Ok(())
}

/// What all threads of this process have worked.
fn processor_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

/// Billions of operations a second of one product of the size of many here.
fn peak() -> f64 {
    let (m, n, k) = (384, 384, 384);
    let (a, b, mut c) = (vec![0.5_f32; m * k], vec![0.25_f32; k * n], vec![0.0_f32; m * n]);
    let mut best = f64::INFINITY;
    for _ in 0..60 {
        let start = Instant::now();
        let (left, right) = (Matrix::new(&a, m, k), Matrix::new(&b, k, n));
        multiply(MatrixMut::new(&mut c, m, n), Store::Replace, left, right);
        best = best.min(start.elapsed().as_secs_f64());
    }
    2.0 * (m * n * k) as f64 / best / 1e9
}
