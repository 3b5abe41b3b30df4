//! The batch that the benches of both levels learn from.

use std::error::Error;

use sortie_envs::DecisionPoints;
use sortie_envs::random::{below, generator as draws};
use sortie_envs::save_the_city::{
    Constants, SaveTheCity, ScenarioSet, random_actions, random_allocation, scripted_actions,
};
use sortie_envs::{EntitySet, Environment, Observation};
use sortie_methods::alma::windows::{NO_ACTION, NO_TASK, WindowShape, Windows};

const WINDOWS: usize = 32;
const STEPS: usize = 64;

/// A batch of windows of real episodes: random allocations every five steps, every other episode played
/// by script.
pub(crate) fn record() -> Result<Windows, Box<dyn Error>> {
    let mut world =
        SaveTheCity::new(ScenarioSet::named("2-5a_2-5b")?, Constants::default(), WINDOWS, 1)?;
    let shape = world.shape();
    let sizes = WindowShape { windows: WINDOWS, steps: STEPS, ..WindowShape::of(world.spec()) };
    let mut windows = Windows::new(sizes);
    windows.features.clear();
    let mut draws = draws(2);
    let (mut state, mut seen) = (Vec::new(), Observation::new(&shape));
    for window in 0..WINDOWS {
        let (mut decisions, mut changed) = (DecisionPoints::default(), false);
        let mut allocation = vec![NO_TASK; sizes.agents];
        let mut last = vec![NO_ACTION; sizes.agents];
        let mut finished = vec![false; sizes.tasks];
        let mut over = false;
        // The windows of a batch begin anywhere in their episodes.
        let warm_up = below(&mut draws, 80);
        for moment in 0..warm_up + STEPS {
            let last_allocation = allocation.clone();
            let decision = !over && decisions.is_due(changed);
            if decision {
                random_allocation(world.city(window), &mut draws, &mut allocation);
            }
            let mut actions = vec![0; sizes.agents];
            if window % 2 == 0 {
                scripted_actions(world.city(window), &allocation, &mut draws, &mut actions);
            } else {
                random_actions(world.city(window), &mut draws, &mut actions);
            }
            state.clear();
            world.save(window, &mut state);
            world.observe(&state, 0, EntitySet::MAX, &mut seen);
            let kept = moment.checked_sub(warm_up).map(|step| window * STEPS + step);
            if let Some(state) = kept {
                note(&mut windows, state, &seen, &allocation);
                let agents = state * sizes.agents..(state + 1) * sizes.agents;
                windows.last_actions[agents.clone()].copy_from_slice(&last);
                windows.last_allocation[agents.clone()].copy_from_slice(&last_allocation);
                windows.decision[state] = decision;
                for (own, action) in windows.actions[agents].iter_mut().zip(&actions) {
                    *own = *action as u8;
                }
                let tasks = state * sizes.tasks..(state + 1) * sizes.tasks;
                for (own, finished) in windows.task_unfinished[tasks].iter_mut().zip(&finished) {
                    *own = !finished;
                }
            }
            if over {
                world.reset(window, &mut draws);
                decisions.restart();
                (changed, over) = (false, false);
                last.fill(NO_ACTION);
                allocation.fill(NO_TASK);
                finished.fill(false);
                continue;
            }
            let outcome = world.step(window, &actions, &mut draws)?;
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
fn note(windows: &mut Windows, state: usize, seen: &Observation, allocation: &[u8]) {
    let shape = windows.shape;
    for entity in 0..shape.entities {
        let at = state * shape.entities + entity;
        windows.present[at] = seen.present >> entity & 1 == 1;
        if windows.present[at] {
            windows.features.push_row(&seen.rows, seen.row_of(entity));
        }
        windows.features.end_row();
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
    for task in 0..shape.tasks {
        windows.open[state * shape.tasks + task] = seen.open_tasks >> task & 1 == 1;
    }
    windows.available[state * shape.agents..][..shape.agents].copy_from_slice(&seen.available);
}
