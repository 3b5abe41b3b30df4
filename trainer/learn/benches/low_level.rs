//! Seconds and arithmetic of one step of the published low level at SaveTheCity's sizes.
//!
//! `cargo bench -p sortie-learn --bench low_level -- [STEPS]`. The batch is of real episodes: random
//! allocations every five steps, every other episode played by script.

mod windows;

use std::error::Error;
use std::time::Instant;

use gemm::Parallelism;
use sortie_learn::methods::paper::low_level::{LowLevel, LowLevelConfig};
use sortie_learn::random::{Purpose, generator};

fn main() -> Result<(), Box<dyn Error>> {
<<<<<<< HEAD
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let rounds: usize = arguments.next_back().map_or(Ok(5), |rounds| rounds.parse())?;
    let windows = record()?;
=======
    let arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let rounds: usize = arguments.last().map_or(Ok(5), |rounds| rounds.parse())?;
    let windows = windows::record()?;
>>>>>>> allocation
    let mut learner = LowLevel::new(
        LowLevelConfig::default(),
        windows.shape,
        &mut generator(1, Purpose::Weights, 0),
    );
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
        // SAFETY: the vectors have exactly the rows and columns that are stated, row-major.
        unsafe {
            gemm::gemm(
                m,
                n,
                k,
                c.as_mut_ptr(),
                1,
                n as isize,
                false,
                a.as_ptr(),
                1,
                k as isize,
                b.as_ptr(),
                1,
                n as isize,
                0.0,
                1.0,
                false,
                false,
                false,
                Parallelism::None,
            );
        }
        best = best.min(start.elapsed().as_secs_f64());
    }
    2.0 * (m * n * k) as f64 / best / 1e9
}
<<<<<<< HEAD

/// A batch of windows of real episodes.
fn record() -> Result<Windows, Box<dyn Error>> {
    let mut world =
        SaveTheCity::new(ScenarioSet::named("2-5a_2-5b")?, Constants::default(), WINDOWS, 1)?;
    let shape = world.shape();
    let sizes = WindowShape {
        windows: WINDOWS,
        steps: STEPS,
        agents: shape.agents,
        entities: shape.entities,
        tasks: shape.tasks,
        actions: shape.actions,
        features: shape.features,
    };
    let mut windows = Windows::new(sizes);
    windows.features.clear();
    let mut draws = draws(2);
    let mut seen = ObservationBuffers::new(&shape);
    for window in 0..WINDOWS {
        let (mut decisions, mut changed) = (DecisionPoints::default(), false);
        let mut allocation = vec![NO_TASK; sizes.agents];
        let mut last = vec![NO_ACTION; sizes.agents];
        let mut finished = vec![false; sizes.tasks];
        let mut over = false;
        // The windows of a batch begin anywhere in their episodes.
        let warm_up = below(&mut draws, 80);
        for moment in 0..warm_up + STEPS {
            if decisions.is_due(changed) {
                random_allocation(world.city(window), &mut draws, &mut allocation);
            }
            let mut actions = vec![0; sizes.agents];
            if window % 2 == 0 {
                scripted_actions(world.city(window), &allocation, &mut draws, &mut actions);
            } else {
                random_actions(world.city(window), &mut draws, &mut actions);
            }
            world.observe(window, &mut seen.lend());
            let kept = moment.checked_sub(warm_up).map(|step| window * STEPS + step);
            if let Some(state) = kept {
                note(&mut windows, state, &seen, &allocation);
                let agents = state * sizes.agents..(state + 1) * sizes.agents;
                windows.last_actions[agents.clone()].copy_from_slice(&last);
                for (own, action) in windows.actions[agents].iter_mut().zip(&actions) {
                    *own = *action as u8;
                }
                let tasks = state * sizes.tasks..(state + 1) * sizes.tasks;
                for (own, finished) in windows.task_unfinished[tasks].iter_mut().zip(&finished) {
                    *own = !finished;
                }
            }
            if over {
                world.reset(window);
                decisions.restart();
                (changed, over) = (false, false);
                last.fill(NO_ACTION);
                finished.fill(false);
                continue;
            }
            let outcome = world.step(window, &actions)?;
            (changed, over) = (outcome.tasks_changed, outcome.done());
            let open = world.open_tasks(window);
            for (task, finished) in finished.iter_mut().enumerate() {
                *finished = open >> task & 1 == 0;
            }
            for (last, action) in last.iter_mut().zip(&actions) {
                *last = *action as u8;
            }
            if let Some(state) = kept {
                let tasks = state * sizes.tasks..(state + 1) * sizes.tasks;
                windows.task_terminated[tasks.clone()].copy_from_slice(&finished);
                let rewards = world.task_rewards(window);
                for (own, reward) in windows.task_reward[tasks].iter_mut().zip(rewards) {
                    *own = *reward as f32;
                }
                windows.reward[state] = outcome.reward as f32;
                windows.terminated[state] = outcome.terminated;
                windows.reset[state] = over;
                windows.has_transition[state] = moment + 1 < warm_up + STEPS;
            }
        }
    }
    Ok(windows)
}

/// Writes what there is to see of a state.
fn note(windows: &mut Windows, state: usize, seen: &ObservationBuffers, allocation: &[u8]) {
    let shape = windows.shape;
    for entity in 0..shape.entities {
        let at = state * shape.entities + entity;
        windows.features.push_dense(&seen.rows[entity * seen.stride..][..shape.features]);
        windows.present[at] = seen.present >> entity & 1 == 1;
        let task = seen.entity_task[entity];
        windows.entity_task[at] = match allocation.get(entity) {
            Some(task) if windows.present[at] => *task,
            None if task != 0 => task.trailing_zeros() as u8,
            _ => NO_TASK,
        };
        for agent in 0..shape.agents {
            let sees = seen.observable[agent] >> entity & 1 == 1;
            windows.observable[(state * shape.agents + agent) * shape.entities + entity] = sees;
        }
    }
    let codes = shape.agents * shape.actions;
    windows.available[state * codes..][..codes].copy_from_slice(&seen.available[..codes]);
}
=======
>>>>>>> allocation
