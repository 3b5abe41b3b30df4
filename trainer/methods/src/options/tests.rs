//! Steps written down one by one and values computed alone, for tests.

use sortie_envs::{Environment, Split, Step};
use sortie_learn::Transition;
use sortie_learn::trajectory::{End, Place};
use sortie_nn::layers::SparseRows;
use sortie_nn::tape::Tape;

use super::replay::{NONE, Note, Replay};
use crate::pictures::{Network, Shown, naive};

/// A state of an instance, and what was done in it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    pub(crate) reached: u8,
    pub(crate) changed_nothing: bool,
    pub(crate) ends_option: bool,
    pub(crate) terminated: bool,
    /// Whether it is the last of its episode, in which nothing was done.
    pub(crate) is_last: bool,
}

impl Default for Moment {
    fn default() -> Self {
        let [changed_nothing, ends_option, terminated, is_last] = [false; 4];
        Self { reached: NONE, changed_nothing, ends_option, terminated, is_last }
    }
}

pub(crate) fn world() -> Box<dyn Environment> {
    sortie_envs::open("crafting/iron", Split::Train, 1, &Default::default()).unwrap()
}

/// Keeps a step between two states that are the same.
pub(crate) fn keep(
    replay: &mut Replay,
    environment: &dyn Environment,
    (instance, state): (usize, &[u8]),
    (action, note): (u16, Note),
    end: End,
) -> Place {
    let (terminated, timed_out) = (end == End::Over, end == End::TimedOut);
    let step = Step { terminated, timed_out, ..Step::default() };
    let (task_rewards, agent_rewards, actions) = (&[][..], &[][..], &[action][..]);
    let transition = Transition {
        environment,
        instance,
        state,
        actions,
        step,
        task_rewards,
        agent_rewards,
        next: state,
    };
    replay.push(&transition, note)
}

/// A replay of one instance whose states are their numbers.
pub(crate) fn kept(moments: &[Moment]) -> Replay {
    let (mut replay, world) = (Replay::new(1, 100, 3), world());
    let mut met = Vec::new();
    for (index, moment) in moments.iter().enumerate().filter(|(_, moment)| !moment.is_last) {
        let is_over = moments.get(index + 1).is_some_and(|next| next.is_last);
        let end = match moment.terminated {
            true => End::Over,
            false if is_over => End::TimedOut,
            false => End::Open,
        };
        let Moment { reached, changed_nothing, ends_option, .. } = *moment;
        let is_first = reached != NONE && !met.contains(&reached);
        met.push(reached);
        if end != End::Open {
            met.clear();
        }
        let option_reached = NONE;
        let note =
            Note { goal: 0, reached, is_first, option_reached, changed_nothing, ends_option };
        let place = keep(&mut replay, &*world, (0, &[index as u8]), (0, note), end);
        assert_eq!(place, at(index));
    }
    replay
}

/// A state of the first instance.
pub(crate) fn at(number: usize) -> Place {
    Place::default().after(number)
}

/// The values of a head's actions in a state by some weights.
pub(crate) fn values(
    (network, weights): (&Network, &[f32]),
    (replay, shown): (&Replay, &Shown),
    (place, is_mirrored, goal): (Place, bool, usize),
) -> Vec<f32> {
    let (mut rows, mut tape) = (SparseRows::default(), Tape::default());
    shown.push(replay.steps.state(place), is_mirrored, &mut rows);
    let mut pass = tape.begin(weights);
    let hidden = network.hidden(&mut pass, &rows);
    naive::values((network, weights), pass.values(hidden), goal)
}

/// The first of the largest numbers.
pub(crate) fn greedy(values: &[f32]) -> usize {
    (0..values.len()).rev().max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap()
}
