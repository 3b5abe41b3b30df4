use rand_core::SeedableRng;
use sortie_envs::random::member;
use sortie_envs::{Split, Step, members};

use super::*;

const SAMPLE: SampleShape = SampleShape { windows: 4, steps: 8, shaping: 0.0, discount: 0.0 };

fn city() -> Box<dyn Environment> {
    sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, &Default::default()).unwrap()
}

/// Keeps an episode of so many steps, the number of the next of which is its reward; actions are random, agents work for
/// one of two subtasks in turns.
fn keep(replay: &mut Replay, number: u64, steps: usize) {
    let mut city = city();
    let Shape { agents, tasks, .. } = city.spec().shape;
    let mut draws = sortie_envs::random::generator(number);
    city.reset(0, &mut draws);
    let mut seen = Observation::new(&city.spec().shape);
    let [mut state, mut next] = [Vec::new(), Vec::new()];
    city.save(0, &mut state);
    for step in 0..steps {
        city.observe(&state, 0, 0, &mut seen);
        let mut draw = |available: &u128| member(&mut draws, *available).unwrap() as u16;
        let actions: Vec<u16> = seen.available.iter().map(&mut draw).collect();
        city.step(0, &actions, &mut draws).unwrap();
        next.clear();
        city.save(0, &mut next);
        let (last, is_over) = (step + 1 == steps, number.is_multiple_of(2));
        let rewards: Vec<f64> = (0..tasks).map(|task| (step * tasks + task) as f64).collect();
        let transition = Transition {
            environment: &*city,
            instance: 0,
            state: &state,
            actions: &actions,
            step: Step {
                reward: (step + 1) as f64,
                terminated: last && is_over,
                timed_out: last && !is_over,
                ..Step::default()
            },
            task_rewards: &rewards,
            agent_rewards: &[],
            next: &next,
        };
        let note = Note { decision: step.is_multiple_of(2), added: 1_000 * number };
        replay.push(&transition, &vec![step as u8 % 2; agents], note);
        std::mem::swap(&mut state, &mut next);
    }
}

fn replay(lengths: &[usize]) -> Replay {
    let mut replay = Replay::new(100, 1, &city().spec().shape);
    (1..).zip(lengths).for_each(|(number, steps)| keep(&mut replay, number, *steps));
    replay
}

fn cut(replay: &Replay, drawn: &[usize], sample: SampleShape, seed: u64) -> Windows {
    let drawn: Vec<Episode> = drawn.iter().map(|index| replay.episodes()[*index]).collect();
    cut_windows(&*city(), replay, &drawn, sample, &mut Generator::seed_from_u64(seed))
}

/// The episode that a state of a window is of, and its number there.
fn origin(replay: &Replay, windows: &Windows, state: usize) -> (Episode, usize) {
    let is_of = |it: &Episode| replay.steps.note(it.first).added == windows.added[state];
    let episode = replay.episodes().into_iter().find(is_of).unwrap();
    match windows.reward[state] {
        0.0 => (episode, episode.steps),
        reward => (episode, reward as usize - 1),
    }
}

#[test]
fn short_episodes_are_padded_whole() {
    let replay = replay(&[3, 5, 2]);
    let windows = cut(&replay, &[2, 0, 1], SAMPLE, 1);
    assert_eq!((windows.shape.windows, windows.shape.steps), (3, 6));
    let transitions: Vec<usize> = windows
        .has_transition
        .chunks(6)
        .map(|window| window.iter().filter(|has| **has).count())
        .collect();
    assert_eq!(transitions, [2, 3, 5]);
    // The third episode ran out of time, as did the first; the second came to its end.
    assert!(!windows.terminated[1] && windows.reset[1]);
    assert!(windows.terminated[2 * 6 + 4]);
    assert_eq!(windows.reward[..3], [1.0, 2.0, 0.0]);
    assert_eq!(windows.features.len(), windows.present.len());
    // What stands for no state shows nothing.
    let entities = windows.shape.entities;
    assert!(
        windows.present[2 * entities]
            && !windows.present[3 * entities..6 * entities].contains(&true)
    );
}

#[test]
fn states_of_windows_show_what_their_episodes_do() {
    let (city, replay) = (city(), replay(&[9, 12, 50, 17]));
    let windows = cut(&replay, &[2, 0, 3, 1], SampleShape { steps: 40, ..SAMPLE }, 5);
    let WindowShape { agents, entities, tasks, features, .. } = windows.shape;
    let [mut now, mut next] = [(); 2].map(|()| Observation::new(&city.spec().shape));
    let mut finished = 0;
    for state in 0..windows.shape.states() {
        let (episode, at) = origin(&replay, &windows, state);
        let place = episode.first.after(at);
        let did = |place, agent: usize| replay.steps.actions(place)[agent] as u8;
        city.observe(replay.state(place), 0, EntitySet::MAX, &mut now);
        for entity in 0..entities {
            let own = state * entities + entity;
            let exists = now.present >> entity & 1 == 1;
            assert_eq!(windows.present[own], exists);
            let [mut row, mut shown] = [(); 2].map(|()| vec![0.0; features]);
            windows.features.write_dense(own, &mut row);
            if exists {
                now.rows.write_dense(now.row_of(entity), &mut shown);
            }
            assert_eq!(row, shown);
            let task = match entity.checked_sub(agents) {
                _ if !exists => NO_TASK,
                None => replay.allocation(place)[entity],
                Some(task) => task as u8,
            };
            assert_eq!(windows.entity_task[own], task);
        }
        for agent in members(now.present & ((1 << agents) - 1)) {
            let own = state * agents + agent;
            let observable = &windows.observable[own * entities..][..entities];
            assert!((0..entities).all(|e| observable[e] == (now.present >> e & 1 == 1)));
            assert_eq!(windows.available[own], now.available[agent]);
            let before = at.checked_sub(1).map(|before| episode.first.after(before));
            let (last, allocated) = before.map_or((NO_ACTION, NO_TASK), |before| {
                (did(before, agent), replay.allocation(before)[agent])
            });
            assert_eq!(windows.actions[own], did(place, agent));
            assert_eq!(
                (windows.last_actions[own], windows.last_allocation[own]),
                (last, allocated)
            );
        }
        assert_eq!(windows.decision[state], replay.steps.note(place).decision);
        next.open_tasks = 0;
        if at < episode.steps {
            city.observe(replay.state(place.after(1)), 0, 0, &mut next);
            let earned = &windows.task_reward[state * tasks..][..tasks];
            assert_eq!(earned, replay.steps.rewards(place).tasks);
        }
        for task in 0..tasks {
            let place = state * tasks + task;
            let open = |seen: &Observation| seen.open_tasks >> task & 1 == 1;
            assert_eq!(
                (windows.open[place], windows.task_unfinished[place]),
                (open(&now), open(&now))
            );
            assert_eq!(windows.task_terminated[place], !open(&next));
            finished += usize::from(at < episode.steps && open(&now) && !open(&next));
        }
    }
    assert!(finished > 1, "{finished}");
}

#[test]
fn windows_come_from_every_stretch_and_know_what_was_before() {
    let replay = replay(&[9, 12, 30, 17]);
    let total: usize = replay.episodes().iter().map(states).sum();
    let mut reached = [0; 5];
    for seed in 0..50 {
        let windows = cut(&replay, &[0, 1, 2, 3], SAMPLE, seed);
        assert_eq!((windows.shape.windows, windows.shape.steps), (4, 8));
        for state in 0..windows.shape.states() {
            reached[(windows.added[state] / 1_000) as usize] += 1;
            let final_state = windows.reward[state] == 0.0;
            let last = state % 8 == 7;
            assert_eq!(windows.has_transition[state], !final_state && !last, "{state}");
            let begins = windows.last_actions[state * windows.shape.agents] == NO_ACTION;
            let before = windows.last_allocation[state * windows.shape.agents];
            let now = windows.allocation(state)[0];
            // The state that an episode ends in keeps the allocation that it came with.
            let held = if final_state { now } else { 1 - now };
            assert_eq!(before, if begins { NO_TASK } else { held });
            if state % 8 > 0 && begins {
                assert!(!windows.has_transition[state - 1], "leads over an episode's end");
            }
        }
    }
    for (episode, reached) in replay.episodes().iter().zip(&reached[1..]) {
        let expected = 50.0 * 32.0 * states(episode) as f64 / total as f64;
        assert!((0.6..1.4).contains(&(f64::from(*reached) / expected)), "{reached} {expected}");
    }
}

#[test]
fn shaping_pays_for_coming_nearer_and_takes_it_back_at_an_end() {
    let (city, replay) = (city(), replay(&[12, 12]));
    let (scale, steps) = (0.5, 12);
    for (index, Episode { first, .. }) in replay.episodes().into_iter().enumerate() {
        let agents = city.spec().shape.agents;
        let mut seen = Observation::new(&city.spec().shape);
        city.observe(replay.state(first), 0, 0, &mut seen);
        let everybody = (1 << seen.agents()) - 1;
        let potential =
            |at, task| city.potential(replay.state(first.after(at)), scale, everybody, task);
        let rewards = |step| replay.steps.rewards(first.after(step));
        let shaped = |discount| {
            let sample = SampleShape { steps: 20, shaping: scale, discount, ..SAMPLE };
            cut(&replay, &[index], sample, 4)
        };
        // Without discount all that was added for the whole team is what its last state has and its first has not;
        // what comes after a true end is worth nothing.
        let windows = shaped(1.0);
        let plain: f32 = (0..steps).map(|step| rewards(step).team).sum();
        let added = windows.reward[..steps].iter().sum::<f32>() - plain;
        assert_eq!(windows.terminated[steps - 1], index == 1);
        let later = if index == 1 { 0.0 } else { potential(steps, None) };
        assert!((added - (later - potential(0, None))).abs() < 1e-3, "{added}");
        assert!(potential(0, None) < -1.0 && later != potential(0, None));

        // A team is paid by its own subtask, the others not at all.
        let windows = shaped(0.9);
        for (step, earned) in
            windows.task_reward.chunks(windows.shape.tasks).take(steps).enumerate()
        {
            let task = usize::from(windows.allocation(step)[0]);
            let allocation = replay.allocation(first.after(step));
            assert_eq!(windows.allocation(step)[..agents][0], allocation[0]);
            let at = |step| potential(step, Some(task));
            let ends = windows.task_terminated[step * windows.shape.tasks + task];
            let later = if ends { 0.0 } else { 0.9 * at(step + 1) };
            let mut want = rewards(step).tasks.to_vec();
            want[task] += later - at(step);
            let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-4;
            assert!(earned.iter().zip(&want).all(near), "{step}: {earned:?} {want:?}");
        }
    }
}

#[test]
fn episodes_are_drawn_once_and_by_condition() {
    let replay = replay(&[1; 10]);
    let mut generator = Generator::seed_from_u64(3);
    let late = |episode: Episode| replay.steps.note(episode.first).added > 5_000;
    let mut drawn = draw_episodes(&replay, 5, &mut generator, late).unwrap();
    drawn.sort_unstable_by_key(|episode| episode.first);
    assert_eq!(drawn, replay.episodes()[5..]);
    assert_eq!(draw_episodes(&replay, 6, &mut generator, late), None);
}

/// Whichever instance was first to end its episode.
#[test]
fn rounds_stand_one_behind_the_other_and_the_oldest_make_room() {
    let (city, mut replay) = (city(), Replay::new(4, 2, &city().spec().shape));
    let Shape { agents, .. } = city.spec().shape;
    for (round, order) in [[0, 1], [1, 0], [1, 0]].into_iter().enumerate() {
        for instance in order {
            let transition = Transition {
                environment: &*city,
                instance,
                state: &[],
                actions: &vec![0; agents],
                step: Step { terminated: true, ..Step::default() },
                task_rewards: &[],
                agent_rewards: &[],
                next: &[],
            };
            let note = Note { decision: true, added: round as u64 };
            replay.push(&transition, &vec![0; agents], note);
        }
    }
    let of = |episode: Episode| (replay.steps.note(episode.first).added, episode.first.instance());
    let kept: Vec<_> = replay.episodes().into_iter().map(of).collect();
    assert_eq!(kept, [(1, 0), (1, 1), (2, 0), (2, 1)]);
}
