//! Windows drawn from whole episodes.
//!
//! As in the public code, the states of the drawn episodes are laid end to end and every window begins
//! somewhere in its own stretch of them, so that windows may reach over the ends of episodes. What the
//! public code gets wrong there is not repeated: no transition leads from one episode to the next, and
//! actions and allocations before a window's first state are the true ones.

use sortie_envs::random::below;
use sortie_envs::save_the_city::{
    ACTIONS, FEATURES, UNASSIGNED, agent_features, building_features, potential,
};
use sortie_nn::random::Generator;

use super::batch::{NO_ACTION, NO_TASK, WindowShape, Windows};
use super::replay::{Episode, Replay};

/// Sizes of a batch, and what is added to its rewards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleShape {
    /// Episodes to draw, and windows to cut.
    pub windows: usize,
    /// States of a window.
    pub steps: usize,
    /// Agents A, at most as many as an episode has.
    pub agents: usize,
    /// Buildings and subtasks T, at most as many as an episode has.
    pub tasks: usize,
    /// What is added to its rewards.
    pub shaping: Shaping,
}

/// Rewards for coming nearer, by the potential of `returns.shaping`; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shaping {
    /// Potential of one cell between an agent and its building.
    pub cell: f32,
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

/// Cuts windows from some episodes.
pub fn cut_windows(
    replay: &Replay,
    drawn: &[usize],
    sample: SampleShape,
    generator: &mut Generator,
) -> Windows {
    let episodes: Vec<&Episode> = drawn.iter().map(|index| &replay.episodes()[*index]).collect();
    let longest = episodes.iter().map(|episode| episode.states()).max().unwrap_or(0);
    let steps = sample.steps.min(longest);
    let SampleShape { agents, tasks, .. } = sample;
    let mut windows = Windows::new(WindowShape {
        windows: drawn.len(),
        steps,
        agents,
        entities: agents + tasks,
        tasks,
        actions: ACTIONS,
        features: FEATURES,
    });
    // Every state of all windows, by episode and its number there.
    let places: Vec<Option<(&Episode, usize)>> = if longest <= sample.steps {
        padded(&episodes, steps).collect()
    } else {
        stretches(&episodes, steps, generator)
    };
    windows.features.clear();
    for (state, place) in places.into_iter().enumerate() {
        match place {
            Some((episode, at)) => {
                write_state(&mut windows, state, episode, at);
                if sample.shaping.cell != 0.0 && at < episode.steps() {
                    sample.shaping.add(&mut windows, state, (episode, at));
                }
            }
            None => (0..agents + tasks).for_each(|_| windows.features.end_row()),
        }
    }
    windows
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

/// Writes a state of a window from one of an episode. Rows of features are added in order.
fn write_state(windows: &mut Windows, state: usize, episode: &Episode, at: usize) {
    let WindowShape { steps, agents, entities, tasks, .. } = windows.shape;
    let city = episode.city(at);
    for agent in 0..agents {
        if let Some(agent) = city.agents.get(agent) {
            agent_features(agent, |column, value| windows.features.push(column, value));
        }
        windows.features.end_row();
    }
    for building in 0..tasks {
        if let Some(building) = city.buildings.get(building) {
            building_features(building, |column, value| windows.features.push(column, value));
        }
        windows.features.end_row();
    }

    let present = &mut windows.present[state * entities..][..entities];
    present[..episode.agents].fill(true);
    present[agents..][..episode.buildings].fill(true);
    let entity_task = &mut windows.entity_task[state * entities..][..entities];
    for (task, allocated) in entity_task.iter_mut().zip(episode.allocation(at)) {
        *task = named(*allocated);
    }
    for (task, index) in entity_task[agents..].iter_mut().zip(0..episode.buildings as u8) {
        *task = index;
    }
    for agent in 0..episode.agents {
        let own = state * agents + agent;
        windows.observable[own * entities..][..entities]
            .copy_from_slice(&windows.present[state * entities..][..entities]);
        let available = city.agents[agent].available;
        for (action, code) in windows.available[own * ACTIONS..][..ACTIONS].iter_mut().enumerate() {
            *code = available >> action & 1;
        }
        windows.actions[own] = episode.actions(at)[agent];
        windows.last_actions[own] =
            if at == 0 { NO_ACTION } else { episode.actions(at - 1)[agent] };
        windows.last_allocation[own] =
            if at == 0 { NO_TASK } else { named(episode.allocation(at - 1)[agent]) };
    }
    windows.decision[state] = episode.decision(at);
    windows.added[state] = episode.added;

    let own_tasks = state * tasks..(state + 1) * tasks;
    windows.task_terminated[own_tasks.clone()].fill(true);
    for (task, building) in city.buildings.iter().enumerate() {
        windows.open[own_tasks.start + task] = building.is_open();
        windows.task_unfinished[own_tasks.start + task] = building.is_open();
    }
    if at >= episode.steps() {
        return;
    }
    for (task, building) in episode.city(at + 1).buildings.iter().enumerate() {
        windows.task_terminated[own_tasks.start + task] = !building.is_open();
    }
    windows.reward[state] = episode.reward(at);
    windows.task_reward[own_tasks][..episode.buildings].copy_from_slice(episode.task_reward(at));
    let last = at + 1 == episode.steps();
    windows.reset[state] = last;
    windows.terminated[state] = last && episode.terminated;
    windows.has_transition[state] = state % steps + 1 < steps;
}

impl Shaping {
    /// Adds to the rewards of a step what its end is nearer than its beginning.
    fn add(self, windows: &mut Windows, state: usize, (episode, at): (&Episode, usize)) {
        let Self { cell, discount } = self;
        let allocation = episode.allocation(at);
        let gain = |task: Option<usize>, ends: bool| {
            let works =
                |agent: &usize| task.is_none_or(|task| usize::from(allocation[*agent]) == task);
            let team = (0..episode.agents).filter(works);
            let before = potential(cell, episode.city(at), team.clone(), task);
            let later = potential(cell, episode.city(at + 1), team, task);
            if ends { -before } else { discount * later - before }
        };
        let first = state * windows.shape.tasks;
        for task in 0..episode.buildings {
            let ends = windows.task_terminated[first + task];
            windows.task_reward[first + task] += gain(Some(task), ends);
        }
        windows.reward[state] += gain(None, windows.terminated[state]);
    }
}

/// The environment's word for no building, as windows have it.
fn named(task: u8) -> u8 {
    if task == UNASSIGNED { NO_TASK } else { task }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::windows::replay::Moment;
    use rand_core::SeedableRng;
    use sortie_envs::Environment;
    use sortie_envs::save_the_city::{AgentState, SaveTheCity, ScenarioSet};

    const SAMPLE: SampleShape = SampleShape {
        windows: 4,
        steps: 8,
        agents: 5,
        tasks: 6,
        shaping: Shaping { cell: 0.0, discount: 0.0 },
    };

    /// An episode of so many steps in which agents stay; its number is its reward.
    fn episode(number: u64, steps: usize) -> Episode {
        let set = ScenarioSet::named("2-5a_2-5b").unwrap();
        let mut city = SaveTheCity::new(set, Default::default(), 1, number).unwrap();
        let mut draws = sortie_envs::random::generator(number);
        let mut episode = Episode::default();
        episode.begin(city.city(0), 1_000 * number);
        for step in 0..=steps {
            let allocation = [step as u8 % 2; 5];
            let moment = Moment {
                city: city.city(0),
                allocation: &allocation,
                decision: step % 2 == 0,
                actions: &[0; 5],
            };
            episode.push_state(moment);
            if step < steps {
                city.step(0, &[0; 5], &mut draws).unwrap();
                episode.push_rewards(number as f64, &[0.5; 6]);
            }
        }
        episode.terminated = number.is_multiple_of(2);
        episode
    }

    fn replay(lengths: &[usize]) -> Replay {
        let mut replay = Replay::new(100);
        (1..).zip(lengths).for_each(|(number, steps)| replay.push(episode(number, *steps)));
        replay
    }

    #[test]
    fn short_episodes_are_padded_whole() {
        let replay = replay(&[3, 5, 2]);
        let windows = cut_windows(&replay, &[2, 0, 1], SAMPLE, &mut Generator::seed_from_u64(1));
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
        assert_eq!(windows.reward[..3], [3.0, 3.0, 0.0]);
        assert_eq!(windows.features.len(), windows.present.len());
    }

    #[test]
    fn windows_come_from_every_stretch_and_know_what_was_before() {
        let replay = replay(&[9, 12, 30, 17]);
        let mut generator = Generator::seed_from_u64(2);
        let total: usize = replay.episodes().iter().map(Episode::states).sum();
        let mut reached = [0; 5];
        for _ in 0..50 {
            let windows = cut_windows(&replay, &[0, 1, 2, 3], SAMPLE, &mut generator);
            assert_eq!((windows.shape.windows, windows.shape.steps), (4, 8));
            for state in 0..windows.shape.states() {
                reached[(windows.added[state] / 1_000) as usize] += 1;
                let final_state = windows.reward[state] == 0.0;
                let last = state % 8 == 7;
                assert_eq!(windows.has_transition[state], !final_state && !last, "{state}");
                let begins = windows.last_actions[state * 5] == NO_ACTION;
                let before = windows.last_allocation[state * 5];
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
    fn shaping_pays_for_cells_and_takes_them_back_at_the_end() {
        let replay = replay(&[12]);
        let stored = &replay.episodes()[0];
        let shaping = Shaping { cell: 0.5, discount: 1.0 };
        let shaped = SampleShape { steps: 20, shaping, ..SAMPLE };
        let windows = cut_windows(&replay, &[0], shaped, &mut Generator::seed_from_u64(4));
        // Without discount all that was added for the whole team is what its last state has and its
        // first had not; agents stay, so that this is nothing: the episode ran out of time.
        let plain: f32 = (0..12).map(|step| stored.reward(step)).sum();
        assert!(!windows.terminated[11]);
        assert!((windows.reward[..12].iter().sum::<f32>() - plain).abs() < 1e-3);

        // With discount, agents that stay lose a tenth of their distance's potential in every step.
        let shaping = Shaping { discount: 0.9, ..shaping };
        let shaped = SampleShape { shaping, ..shaped };
        let windows = cut_windows(&replay, &[0], shaped, &mut Generator::seed_from_u64(4));
        let city = stored.city(0);
        let task = usize::from(stored.allocation(0)[0]);
        let cells = |agent: &AgentState| agent.distance_to(&city.buildings[task]).saturating_sub(1);
        let cells: u16 = city.agents.iter().map(|agent| u16::from(cells(agent))).sum();
        let added = windows.task_reward[task] - 0.5;
        assert!(
            cells > 0 && (added - 0.1 * 0.5 * f32::from(cells)).abs() < 1e-3,
            "{added} {cells}"
        );
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
