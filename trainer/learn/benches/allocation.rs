//! Times the steps of the published allocation learner on states of SaveTheCity.
//!
//! `cargo bench -p sortie-learn --bench allocation [-- STEPS]`: 32 windows of 64 steps as the learner draws
//! them, played half by script and half at random; the published sizes. Prints CPU-seconds of a step by one
//! thread and wall-seconds by two, and the share of the product kernel's own speed in the same run.

use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use sortie_envs::save_the_city::{
    AllocationRule, Constants, DecisionPoints, SaveTheCity, ScenarioSet, ScriptedTeam,
    random_actions,
};
use sortie_envs::{Environment, ObservationBuffers, StepOutcome};
use sortie_learn::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use sortie_learn::methods::paper::allocation::{
    AllocationLearning, AllocationLevel, AllocationShape,
};
use sortie_learn::methods::paper::{NO_TASK, WindowShape, Windows};
use sortie_learn::random::{Generator, Purpose, chance, generator};

const WINDOWS: usize = 32;
const STEPS: usize = 64;

fn main() {
    let rounds: usize = std::env::args().find_map(|word| word.parse().ok()).unwrap_or(20);
    let windows = play();
    let shape =
        AllocationShape { features: windows.shape.features, columns: 6, width: 128, heads: 4 };
    let learning = AllocationLearning::published(shape, 5.0);
    println!("product kernel: {:.0} GFLOP/s by one thread", kernel_speed());
    for threads in [1, 2] {
        let mut level = AllocationLevel::new(learning, 1);
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

/// Windows of consecutive steps, one city each.
fn play() -> Windows {
    let set = ScenarioSet::named("2-5a_2-5b").expect("a set of the environment");
    let mut city =
        SaveTheCity::new(set, Constants::default(), WINDOWS, 1).expect("a set that fits");
    let sizes = city.shape();
    let shape = WindowShape {
        windows: WINDOWS,
        steps: STEPS,
        agents: sizes.agents,
        entities: sizes.entities,
        tasks: sizes.tasks,
        actions: sizes.actions,
        features: sizes.features,
    };
    let mut windows = Windows::new(shape);
    windows.features.clear();
    let mut random = generator(1, Purpose::Rollout, 0);
    (0..WINDOWS).for_each(|window| play_window(&mut city, window, &mut windows, &mut random));
    windows
}

fn play_window(
    city: &mut SaveTheCity,
    window: usize,
    windows: &mut Windows,
    random: &mut Generator,
) {
    let shape = windows.shape;
    let decisions = || DecisionPoints::every(DecisionPoints::ACTION_LENGTH);
    let mut team = ScriptedTeam::new(AllocationRule::Random, decisions(), random.clone());
    let mut points = decisions();
    let mut before = StepOutcome::default();
    let mut allocation = vec![NO_TASK; shape.agents];
    let mut buffers = ObservationBuffers::new(&city.shape());
    // Windows begin anywhere in an episode.
    let begin = window * 3;
    for step in 0..begin + shape.steps {
        if city.is_done(window) {
            city.reset(window);
            team.restart();
            points.restart();
            before = StepOutcome::default();
            allocation.fill(NO_TASK);
        }
        let last = allocation.clone();
        let decision = points.is_due(before.tasks_changed);
        let (mut actions, mut explored) = (vec![0; shape.agents], vec![0; shape.agents]);
        city.observe(window, &mut buffers.lend());
        team.act(city.city(window), before.tasks_changed, &mut actions);
        random_actions(city.city(window), random, &mut explored);
        for (action, explored) in actions.iter_mut().zip(explored) {
            *action = if chance(random, 0.5) { explored } else { *action };
        }
        allocation.copy_from_slice(&team.allocation()[..shape.agents]);
        before = city.step(window, &actions).expect("available actions");
        if let Some(step) = step.checked_sub(begin) {
            let state = window * shape.steps + step;
            write_state(windows, state, &buffers, &allocation, &last);
            windows.decision[state] = decision;
            windows.reward[state] = before.reward as f32;
            windows.terminated[state] = before.terminated;
            windows.reset[state] = before.done();
            windows.has_transition[state] = step + 1 < shape.steps;
        }
    }
}

fn write_state(
    windows: &mut Windows,
    state: usize,
    seen: &ObservationBuffers,
    allocation: &[u8],
    last: &[u8],
) {
    let shape = windows.shape;
    for row in seen.rows.chunks_exact(shape.features) {
        windows.features.push_dense(row);
    }
    for entity in 0..shape.entities {
        let place = state * shape.entities + entity;
        windows.present[place] = seen.present >> entity & 1 == 1;
        let task = seen.entity_task[entity].trailing_zeros() as u8;
        windows.entity_task[place] = match allocation.get(entity) {
            Some(task) => *task,
            None if usize::from(task) < shape.tasks => task,
            None => NO_TASK,
        };
    }
    for task in 0..shape.tasks {
        windows.open[state * shape.tasks + task] = seen.open_tasks >> task & 1 == 1;
    }
    windows.last_allocation[state * shape.agents..][..shape.agents].copy_from_slice(last);
}
