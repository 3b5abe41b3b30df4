//! Windows drawn from whole episodes.
//!
//! As in the public code, the states of the drawn episodes are laid end to end and every window begins
//! somewhere in its own stretch of them, so that windows may reach over the ends of episodes. What the
//! public code gets wrong there is not repeated: no transition leads from one episode to the next, and
//! actions and allocations before a window's first state are the true ones.

use sortie_envs::random::below;
use sortie_envs::{AgentSet, EntitySet, Environment, Observation};
use sortie_nn::random::Generator;

use super::batch::{NO_ACTION, NO_TASK, WindowShape, Windows};
use super::replay::{Episode, Replay};

/// How a batch is cut, and what is added to its rewards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleShape {
    /// Episodes to draw, and windows to cut.
    pub windows: usize,
    /// States of a window.
    pub steps: usize,
    /// What is added to its rewards.
    pub shaping: Shaping,
}

/// Rewards for coming nearer, by the environment's potential; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shaping {
    /// Potential of a step that is missing between an agent and its subtask.
    pub scale: f32,
    /// Discount of a step.
    pub discount: f32,
}

/// Draws distinct episodes among those that `may_be_drawn`, as indices, or `None` if there are too few.
pub fn draw_episodes(
    replay: &Replay,
    count: usize,
    generator: &mut Generator,
    may_be_drawn: impl Fn(&Episode) -> bool,
) -> Option<Vec<usize>> {
    let episodes = replay.episodes().iter().enumerate();
    let mut candidates: Vec<usize> =
        episodes.filter(|(_, episode)| may_be_drawn(episode)).map(|(index, _)| index).collect();
    if candidates.len() < count {
        return None;
    }
    for place in 0..count {
        let chosen = place + below(generator, candidates.len() - place);
        candidates.swap(place, chosen);
    }
    candidates.truncate(count);
    Some(candidates)
}

/// Cuts windows from some episodes of an environment.
pub fn cut_windows(
    environment: &dyn Environment,
    replay: &Replay,
    drawn: &[usize],
    sample: SampleShape,
    generator: &mut Generator,
) -> Windows {
    let episodes: Vec<&Episode> = drawn.iter().map(|index| &replay.episodes()[*index]).collect();
    let longest = episodes.iter().map(|episode| episode.states()).max().unwrap_or(0);
    let steps = sample.steps.min(longest);
    let sizes = WindowShape::of(environment.spec().shape);
    let shape = WindowShape { windows: drawn.len(), steps, ..sizes };
    let mut windows = Windows::new(shape);
    windows.features.clear();
    // Every state of all windows, by episode and its number there.
    let places: Vec<Option<(&Episode, usize)>> = if longest <= sample.steps {
        padded(&episodes, steps).collect()
    } else {
        stretches(&episodes, steps, generator)
    };
    let mut writer =
        Writer { environment, shaping: sample.shaping, windows, seen: Default::default() };
    for (state, place) in places.into_iter().enumerate() {
        match place {
            Some(place) => writer.write(state, place),
            None => (0..sizes.entities).for_each(|_| writer.windows.features.end_row()),
        }
    }
    writer.windows
}

/// Every episode as a window of its own, padded to the same length.
fn padded<'a>(
    episodes: &'a [&'a Episode],
    steps: usize,
) -> impl Iterator<Item = Option<(&'a Episode, usize)>> {
    episodes.iter().flat_map(move |episode| {
        (0..steps).map(|at| (at < episode.states()).then_some((*episode, at)))
    })
}

/// One window from each of as many equal stretches of all states.
fn stretches<'a>(
    episodes: &[&'a Episode],
    steps: usize,
    generator: &mut Generator,
) -> Vec<Option<(&'a Episode, usize)>> {
    let all: Vec<(&Episode, usize)> = episodes
        .iter()
        .flat_map(|episode| (0..episode.states()).map(|at| (*episode, at)))
        .collect();
    let count = episodes.len();
    // The starts from which a whole window fits.
    let starts = all.len() - steps + 1;
    let edge =
        |index: usize| (starts as f64 * index as f64 / count as f64).round_ties_even() as usize;
    let mut places = Vec::with_capacity(count * steps);
    for window in 0..count {
        let (from, to) = (edge(window), edge(window + 1));
        let start = (from + below(generator, (to - from).max(1))).min(starts - 1);
        places.extend(all[start..][..steps].iter().copied().map(Some));
    }
    places
}

/// Windows that are being written, state by state.
struct Writer<'a> {
    environment: &'a dyn Environment,
    shaping: Shaping,
    windows: Windows,
    seen: Observation,
}

impl Writer<'_> {
    /// Writes a state of a window from one of an episode. Rows of features are added in order.
    fn write(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        self.environment.observe(episode.state(at), 0, EntitySet::MAX, &mut self.seen);
        self.write_entities(state, (episode, at));
        self.write_agents(state, (episode, at));
        let Self { environment, windows, seen, .. } = self;
        windows.decision[state] = episode.decision(at);
        windows.added[state] = episode.added;
        let tasks = windows.shape.tasks;
        for task in 0..tasks {
            let open = seen.open_tasks >> task & 1 == 1;
            windows.open[state * tasks + task] = open;
            windows.task_unfinished[state * tasks + task] = open;
        }
        if at < episode.steps() {
            environment.observe(episode.state(at + 1), 0, 0, seen);
            self.write_outcome(state, (episode, at));
        } else {
            windows.task_terminated[state * tasks..][..tasks].fill(true);
        }
    }

    /// Features, existence and subtasks of all entities.
    fn write_entities(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { windows, seen, .. } = self;
        let first = state * windows.shape.entities;
        for entity in 0..windows.shape.entities {
            let exists = seen.present >> entity & 1 == 1;
            windows.present[first + entity] = exists;
            if exists {
                windows.features.push_row(&seen.rows, seen.row_of(entity));
                windows.entity_task[first + entity] = match episode.allocation(at).get(entity) {
                    Some(task) => *task,
                    None => seen.task_of(entity),
                };
            }
            windows.features.end_row();
        }
    }

    /// What the agents that exist observe, can do and did.
    fn write_agents(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { windows, seen, .. } = self;
        let WindowShape { agents, entities, actions, .. } = windows.shape;
        for agent in 0..seen.agents() {
            let own = state * agents + agent;
            let observable = &mut windows.observable[own * entities..][..entities];
            for (entity, observable) in observable.iter_mut().enumerate() {
                *observable = seen.observable[agent] >> entity & 1 == 1;
            }
            let codes = &mut windows.available[own * actions..][..actions];
            for (action, code) in codes.iter_mut().enumerate() {
                *code = (seen.available[agent] >> action & 1) as u16;
            }
            windows.actions[own] = episode.actions(at)[agent];
            let before = at.checked_sub(1);
            windows.last_actions[own] = before.map_or(NO_ACTION, |at| episode.actions(at)[agent]);
            windows.last_allocation[own] =
                before.map_or(NO_TASK, |at| episode.allocation(at)[agent]);
        }
    }

    /// What the step from a state came to; the state behind it is seen.
    fn write_outcome(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { windows, seen, shaping, .. } = self;
        let WindowShape { steps, tasks, .. } = windows.shape;
        let own_tasks = state * tasks..(state + 1) * tasks;
        for (task, terminated) in windows.task_terminated[own_tasks.clone()].iter_mut().enumerate()
        {
            *terminated = seen.open_tasks >> task & 1 == 0;
        }
        windows.reward[state] = episode.reward(at);
        windows.task_reward[own_tasks].copy_from_slice(episode.task_reward(at));
        let last = at + 1 == episode.steps();
        windows.reset[state] = last;
        windows.terminated[state] = last && episode.terminated;
        windows.has_transition[state] = state % steps + 1 < steps;
        if shaping.scale != 0.0 {
            self.shape(state, (episode, at));
        }
    }

    /// Adds to the rewards of a step what its end is nearer than its beginning.
    fn shape(&mut self, state: usize, (episode, at): (&Episode, usize)) {
        let Self { environment, windows, shaping: Shaping { scale, discount }, .. } = self;
        let WindowShape { agents, entities, tasks, .. } = windows.shape;
        let gain = |team: AgentSet, task: Option<usize>, ends: bool| {
            let potential = |at| environment.potential(episode.state(at), *scale, team, task);
            let before = potential(at);
            if ends { -before } else { *discount * potential(at + 1) - before }
        };
        let present = &windows.present[state * entities..][..agents];
        let team = |task: Option<usize>| {
            let works = |agent: &usize| {
                let allocated = usize::from(episode.allocation(at)[*agent]);
                present[*agent] && task.is_none_or(|task| allocated == task)
            };
            (0..agents).filter(works).fold(0, |team, agent| team | 1 << agent)
        };
        for task in 0..tasks {
            let own = state * tasks + task;
            match team(Some(task)) {
                0 => {}
                team => {
                    let ends = windows.task_terminated[own];
                    windows.task_reward[own] += gain(team, Some(task), ends);
                }
            }
        }
        windows.reward[state] += gain(team(None), None, windows.terminated[state]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::windows::replay::Moment;
    use rand_core::SeedableRng;
    use sortie_envs::random::member;
    use sortie_envs::{Shape, Split, members};

    const SAMPLE: SampleShape =
        SampleShape { windows: 4, steps: 8, shaping: Shaping { scale: 0.0, discount: 0.0 } };

    fn city() -> Box<dyn Environment> {
        sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, &Default::default()).unwrap()
    }

    /// An episode of so many steps, the number of the next of which is its reward; actions are random, agents work for
    /// one of two subtasks in turns.
    fn episode(number: u64, steps: usize) -> Episode {
        let mut city = city();
        let Shape { agents, tasks, .. } = city.spec().shape;
        let mut draws = sortie_envs::random::generator(number);
        city.reset(0, &mut draws);
        let mut seen = Observation::new(&city.spec().shape);
        let mut episode = Episode::begin(agents, tasks, 1_000 * number);
        for step in 0..=steps {
            let mut state = Vec::new();
            city.save(0, &mut state);
            city.observe(&state, 0, 0, &mut seen);
            let mut draw =
                |available: &u64| member(&mut draws, (*available).into()).unwrap() as u16;
            let actions: Vec<u16> = seen.available.iter().map(&mut draw).collect();
            let allocation = vec![step as u8 % 2; agents];
            let decision = step % 2 == 0;
            let state = &state;
            let moment = Moment { state, allocation: &allocation, decision, actions: &actions };
            if step == steps {
                episode.end(moment, number.is_multiple_of(2));
            } else {
                episode.push_state(moment);
                city.step(0, &actions, &mut draws).unwrap();
                let rewards: Vec<f64> =
                    (0..tasks).map(|task| (step * tasks + task) as f64).collect();
                episode.push_rewards((step + 1) as f64, &rewards);
            }
        }
        episode
    }

    fn replay(lengths: &[usize]) -> Replay {
        let mut replay = Replay::new(100);
        (1..).zip(lengths).for_each(|(number, steps)| replay.push(episode(number, *steps)));
        replay
    }

    fn cut(replay: &Replay, drawn: &[usize], sample: SampleShape, seed: u64) -> Windows {
        cut_windows(&*city(), replay, drawn, sample, &mut Generator::seed_from_u64(seed))
    }

    /// The episode that a state of a window is of, and its number there.
    fn origin<'a>(replay: &'a Replay, windows: &Windows, state: usize) -> (&'a Episode, usize) {
        let mut all = replay.episodes().iter();
        let episode = all.find(|episode| episode.added == windows.added[state]).unwrap();
        match windows.reward[state] {
            0.0 => (episode, episode.steps()),
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
        let WindowShape { agents, entities, tasks, actions, features, .. } = windows.shape;
        let [mut now, mut next] = [(); 2].map(|()| Observation::new(&city.spec().shape));
        let mut finished = 0;
        for state in 0..windows.shape.states() {
            let (episode, at) = origin(&replay, &windows, state);
            city.observe(episode.state(at), 0, EntitySet::MAX, &mut now);
            for entity in 0..entities {
                let place = state * entities + entity;
                let exists = now.present >> entity & 1 == 1;
                assert_eq!(windows.present[place], exists);
                let [mut row, mut shown] = [(); 2].map(|()| vec![0.0; features]);
                windows.features.write_dense(place, &mut row);
                if exists {
                    now.rows.write_dense(now.row_of(entity), &mut shown);
                }
                assert_eq!(row, shown);
                let task = match entity.checked_sub(agents) {
                    _ if !exists => NO_TASK,
                    None => episode.allocation(at)[entity],
                    Some(task) => task as u8,
                };
                assert_eq!(windows.entity_task[place], task);
            }
            for agent in members(now.present & ((1 << agents) - 1)) {
                let own = state * agents + agent;
                let observable = &windows.observable[own * entities..][..entities];
                assert!(
                    (0..entities).all(|e| observable[e] == (now.observable[agent] >> e & 1 == 1))
                );
                let codes = &windows.available[own * actions..][..actions];
                let available = |action: usize| now.available[agent] >> action & 1;
                assert!((0..actions).all(|action| u64::from(codes[action]) == available(action)));
                let before = at.checked_sub(1);
                let (last, allocated) = before.map_or((NO_ACTION, NO_TASK), |before| {
                    (episode.actions(before)[agent], episode.allocation(before)[agent])
                });
                assert_eq!(windows.actions[own], episode.actions(at)[agent]);
                assert_eq!(
                    (windows.last_actions[own], windows.last_allocation[own]),
                    (last, allocated)
                );
            }
            assert_eq!(windows.decision[state], episode.decision(at));
            next.open_tasks = 0;
            if at < episode.steps() {
                city.observe(episode.state(at + 1), 0, 0, &mut next);
                let earned = &windows.task_reward[state * tasks..][..tasks];
                assert_eq!(earned, episode.task_reward(at));
            }
            for task in 0..tasks {
                let place = state * tasks + task;
                let open = |seen: &Observation| seen.open_tasks >> task & 1 == 1;
                assert_eq!(
                    (windows.open[place], windows.task_unfinished[place]),
                    (open(&now), open(&now))
                );
                assert_eq!(windows.task_terminated[place], !open(&next));
                finished += usize::from(at < episode.steps() && open(&now) && !open(&next));
            }
        }
        assert!(finished > 1, "{finished}");
    }

    #[test]
    fn windows_come_from_every_stretch_and_know_what_was_before() {
        let replay = replay(&[9, 12, 30, 17]);
        let total: usize = replay.episodes().iter().map(Episode::states).sum();
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
                assert_eq!(before, if begins { NO_TASK } else { 1 - now });
                if state % 8 > 0 && begins {
                    assert!(!windows.has_transition[state - 1], "leads over an episode's end");
                }
            }
        }
        for (episode, reached) in replay.episodes().iter().zip(&reached[1..]) {
            let expected = 50.0 * 32.0 * episode.states() as f64 / total as f64;
            assert!((0.6..1.4).contains(&(f64::from(*reached) / expected)), "{reached} {expected}");
        }
    }

    #[test]
    fn shaping_pays_for_coming_nearer_and_takes_it_back_at_an_end() {
        let (city, replay) = (city(), replay(&[12, 12]));
        let (scale, steps) = (0.5, 12);
        for (index, episode) in replay.episodes().iter().enumerate() {
            let agents = city.spec().shape.agents;
            let mut seen = Observation::new(&city.spec().shape);
            city.observe(episode.state(0), 0, 0, &mut seen);
            let everybody = (1 << seen.agents()) - 1;
            let potential = |at, task| city.potential(episode.state(at), scale, everybody, task);
            let shaped = |discount| {
                let shaping = Shaping { scale, discount };
                cut(&replay, &[index], SampleShape { steps: 20, shaping, ..SAMPLE }, 4)
            };
            // Without discount all that was added for the whole team is what its last state has and its first has not;
            // what comes after a true end is worth nothing.
            let windows = shaped(1.0);
            let plain: f32 = (0..steps).map(|step| episode.reward(step)).sum();
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
                assert_eq!(windows.allocation(step)[..agents][0], episode.allocation(step)[0]);
                let at = |step| potential(step, Some(task));
                let ends = windows.task_terminated[step * windows.shape.tasks + task];
                let later = if ends { 0.0 } else { 0.9 * at(step + 1) };
                let mut want = episode.task_reward(step).to_vec();
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
        let mut drawn = draw_episodes(&replay, 5, &mut generator, |e| e.added > 5_000).unwrap();
        drawn.sort_unstable();
        assert_eq!(drawn, [5, 6, 7, 8, 9]);
        assert_eq!(draw_episodes(&replay, 6, &mut generator, |e| e.added > 5_000), None);
    }
}
