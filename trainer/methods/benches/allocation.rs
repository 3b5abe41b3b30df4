//! Times the steps of the published allocation learner on states of SaveTheCity.
//!
//! `cargo bench -p sortie-methods --bench allocation -- [STEPS]`. The published sizes. Prints the median of CPU-
//! and wall-seconds and of the arithmetic, and its share of the product kernel's own speed in the same
//! run. The networks learn nothing meanwhile: learning makes proposals alike, which saves work.
#![allow(clippy::print_stdout, reason = "a program of its own")]

mod windows;

use std::error::Error;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use sortie_learn::random::{Purpose, generator};
use sortie_methods::alma::windows::Config;
use sortie_methods::alma::windows::allocation::{AllocationLearning, AllocationLevel};
use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};

fn main() -> Result<(), Box<dyn Error>> {
    let rounds: usize = std::env::args().find_map(|word| word.parse().ok()).unwrap_or(20);
    let windows = windows::record()?;
    // Steps without length keep the networks as they were drawn.
    let usual = AllocationLearning::of(&Config::default(), windows.shape);
    let learning = AllocationLearning { learning_rate: 0.0, ..usual };
    println!("product kernel: {:.0} GFLOP/s by one thread", kernel_speed());
    for threads in [1, 2] {
        let mut level = AllocationLevel::new(learning.clone(), 1);
        let mut draws = generator(1, Purpose::Replay, 0);
        let (mut wall, mut cpu, mut last) = (Vec::new(), Vec::new(), None);
        for _ in 0..rounds {
            let (start, cpu_start) = (Instant::now(), cpu_time());
            last = level.learn(&windows, 0, &mut draws, threads);
            wall.push(start.elapsed().as_secs_f64());
            cpu.push((cpu_time() - cpu_start).as_secs_f64());
        }
        let (wall, cpu) = (median(&mut wall), median(&mut cpu));
        let report = last.expect("windows with decisions");
        let (gflop, peak) = (report.operations as f64 * 1e-9, kernel_speed());
        println!(
            "{threads} threads: {} rows, {cpu:.3} CPU-s and {wall:.3} s a step, {gflop:.2} GFLOP, \
             {:.0} GFLOP/s a core = {:.0} % of the kernel's {peak:.0}",
            report.rows,
            gflop / cpu,
            100.0 * gflop / cpu / peak
        );
    }
    Ok(())
}

fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The best of several products that fit into the cache.
fn kernel_speed() -> f64 {
    const SIDE: usize = 384;
    let (a, b) = (vec![0.5; SIDE * SIDE], vec![0.25; SIDE * SIDE]);
    let mut out = vec![0.0; SIDE * SIDE];
    let mut product = || {
        let start = Instant::now();
        let (a, b) = (Matrix::new(&a, SIDE, SIDE), Matrix::new(&b, SIDE, SIDE).transposed());
        multiply(MatrixMut::new(&mut out, SIDE, SIDE), Store::Replace, a, b);
        2.0 * (SIDE as f64).powi(3) / start.elapsed().as_secs_f64() * 1e-9
    };
    (0..50).map(|_| product()).fold(0.0, f64::max)
}
