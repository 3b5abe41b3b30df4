//! Recorded batches of the reference's learners as windows.
//!
//! The reference's masks say what is absent, blocked or no member; they are turned round here. Its last
//! actions reach over the end of an episode, which is kept, so that the steps agree.

use crate::alma::windows::{NO_TASK, WindowShape, Windows};
use sortie_learn::networks::Targets;

use super::files::{Case, safetensors_case};

/// The windows of a recorded case.
pub(crate) fn windows(case: &Case) -> Windows {
    let sizes = |name: &str| &case.get(name).shape;
    let entities = sizes("in/entities");
    let shape = WindowShape {
        windows: entities[0],
        steps: entities[1],
        agents: sizes("in/actions")[2],
        entities: entities[2],
        tasks: sizes("in/task_mask")[2],
        actions: sizes("in/avail_actions")[3],
        features: entities[3],
        targets: Targets::NONE,
    };
    let numbers = |name: &str| &case.get(name).data;
    let yes = |name: &str| numbers(name).iter().map(|v| *v != 0.0).collect::<Vec<_>>();
    let no = |name: &str| numbers(name).iter().map(|v| *v == 0.0).collect::<Vec<_>>();
    let mut windows = Windows::new(shape);
    windows.features.clear();
    for row in case.get("in/entities").f32s().chunks(shape.features) {
        windows.features.push_dense(row);
    }
    windows.present = no("in/entity_mask");
    let square = shape.entities * shape.entities;
    let of_agents = shape.agents * shape.entities;
    let observable = no("in/obs_mask");
    windows.observable =
        observable.chunks(square).flat_map(|state| &state[..of_agents]).copied().collect();
    let member = no("in/entity2task_mask");
    windows.entity_task = member.chunks(shape.tasks).map(task_of).collect();
    windows.open = no("in/task_mask");
    let open =
        |codes: &[f64]| (0..).zip(codes).map(|(u, code)| u128::from(*code != 0.0) << u).sum();
    windows.available = numbers("in/avail_actions").chunks(shape.actions).map(open).collect();
    windows.actions = numbers("in/actions").iter().map(|v| *v as u8).collect();
    windows.decision = yes("in/hier_decision");
    windows.reward = case.get("in/reward").f32s();
    windows.task_reward = case.get("in/task_rewards").f32s();
    windows.terminated = yes("in/terminated");
    windows.reset = yes("in/reset");
    windows.task_terminated = yes("in/tasks_terminated");
    let filled = yes("in/filled");
    for (state, filled) in filled.into_iter().enumerate() {
        let (window, step) = (state / shape.steps, state % shape.steps);
        windows.added[state] = numbers("in/t_added")[window] as u64;
        windows.has_transition[state] = filled && step + 1 < shape.steps;
        let (tasks, agents) = (shape.tasks, shape.agents);
        windows.task_unfinished[state * tasks..][..tasks].fill(true);
        if step == 0 {
            continue;
        }
        windows.has_transition[state] &= !windows.reset[state - 1];
        for task in 0..tasks {
            windows.task_unfinished[state * tasks + task] =
                !windows.task_terminated[(state - 1) * tasks + task];
        }
        for agent in 0..agents {
            let before = (state - 1) * agents + agent;
            windows.last_actions[state * agents + agent] = windows.actions[before];
            let task = windows.entity_task[(state - 1) * shape.entities + agent];
            windows.last_allocation[state * agents + agent] = task;
        }
    }
    windows
}

/// The only subtask of a row of memberships.
pub(crate) fn task_of(member: &[bool]) -> u8 {
    let mut tasks = (0..).zip(member).filter(|(_, member)| **member).map(|(task, _)| task);
    let task = tasks.next().unwrap_or(NO_TASK);
    assert!(tasks.next().is_none(), "an entity of two subtasks");
    task
}

#[test]
fn recorded_windows_hold_what_the_files_say() {
    let windows = windows(&safetensors_case("learner", "low_alma_mask_0"));
    let WindowShape { windows: count, steps, agents, .. } = windows.shape;
    assert_eq!((count, steps, agents), (3, 8, 3));
    // Window 0 ends truly at step 3, window 1 runs out of time at step 4, window 2 is padded from 6.
    let ends: Vec<bool> = [3, 8 + 4].map(|state| windows.terminated[state]).into();
    assert_eq!(ends, [true, false]);
    assert!(windows.reset[8 + 4] && !windows.has_transition[8 + 5]);
    assert!(!windows.has_transition[2 * 8 + 6] && !windows.has_transition[7]);
    assert_eq!(windows.last_actions[agents..2 * agents], windows.actions[..agents]);
}
