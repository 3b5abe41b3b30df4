//! How a coach learns what to tell its players.
//!
//! A recognition network that is of use in training only guesses the strategy back from what the agents
//! see and do, so that strategies differ where actions do, and a term keeps the coach from telling with
//! certainty too early.

mod loss;
#[cfg(test)]
mod tests;

use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::RmsProp;
use sortie_nn::random::{Generator, normals};

use super::{CHUNK, LANES};
use crate::alma::agents::{TaskOrder, UtilityInput};
use crate::alma::coach::{Coach, CoachShape, Recognition, RecognitionShape};
use crate::alma::windows::Windows;
use loss::{ENTROPY, Holdings, Strategies};

pub use crate::alma::windows::config::CoachConfig;
pub(super) use loss::{CoachLane, Guess, Held};

/// Writes some states: the agents of all of them first, who query, each seeing everything that exists in
/// its state.
///
/// With `recognises`, agents come with the action that they take.
pub fn state_input(
    shape: CoachShape,
    windows: &Windows,
    states: &[usize],
    order: &TaskOrder,
    recognises: bool,
    input: &mut UtilityInput,
) {
    let sizes = windows.shape;
    input.clear();
    let mut write = |state: usize, entity: usize| {
        let row = state * sizes.entities + entity;
        windows.features.row(row).for_each(|(column, value)| input.rows.push(column, value));
        if let Some(mark) = order.0.get(usize::from(windows.entity_task[row])) {
            input.rows.push(shape.features + usize::from(*mark), 1.0);
        }
        if recognises && entity < sizes.agents {
            let action = usize::from(windows.actions[state * sizes.agents + entity]);
            input.rows.push(shape.features + shape.marks + action, 1.0);
        }
        input.rows.end_row();
    };
    let present = |state: usize, entities: std::ops::Range<usize>| {
        entities.filter(move |entity| windows.present[state * sizes.entities + entity])
    };
    let agents = |state: usize| present(state, 0..sizes.agents);
    let others = |state: usize| present(state, sizes.agents..sizes.entities);
    for state in states {
        agents(*state).for_each(|agent| write(*state, agent));
    }
    for state in states {
        others(*state).for_each(|other| write(*state, other));
    }
    let (mut own, mut other) = (0, states.iter().map(|state| agents(*state).count()).sum());
    for state in states {
        let (own_end, other_end) = (own + agents(*state).count(), other + others(*state).count());
        for _ in own..own_end {
            (own..own_end).chain(other..other_end).for_each(|row| input.visible.push(row));
            input.visible.end_list();
        }
        (own, other) = (own_end, other_end);
    }
}

/// Coach, recognition network and their optimisers. All state is open, to be saved and restored.
#[derive(Clone, Debug, PartialEq)]
pub struct Coaching {
    config: CoachConfig,
    /// The coach that learns and tells.
    pub online: Coach,
    /// The coach of the players that value what comes next.
    pub target: Coach,
    /// Guesses strategies.
    pub recognition: Recognition,
    /// The optimisers of coach and recognition.
    pub optimisers: [RmsProp; 2],
}

/// What has been told in a batch of windows.
pub(super) struct Told {
    holdings: Holdings,
    online: Strategies,
    target: Strategies,
    coach_order: TaskOrder,
    recognition_order: TaskOrder,
}

impl Told {
    /// What the players that learn hold.
    pub(super) fn online(&self) -> Held<'_> {
        Held { holdings: &self.holdings, strategies: &self.online }
    }

    /// What the players that value hold.
    pub(super) fn target(&self) -> Held<'_> {
        Held { holdings: &self.holdings, strategies: &self.target }
    }
}

impl Coaching {
    /// A new coach for players of so many actions.
    pub(super) fn new(
        config: CoachConfig,
        shape: CoachShape,
        actions: usize,
        generator: &mut Generator,
    ) -> Self {
        let online = Coach::initialise(shape, generator);
        let recognition =
            Recognition::initialise(RecognitionShape { coach: shape, actions }, generator);
        let counts = [online.parameters().len(), recognition.parameters().len()];
        Self {
            config,
            target: online.clone(),
            online,
            recognition,
            optimisers: counts.map(RmsProp::new),
        }
    }

    /// Number of parameters that learn.
    pub(super) fn parameters(&self) -> usize {
        self.online.parameters().len() + self.recognition.parameters().len()
    }

    /// Draws the strategies of all decisions of a batch.
    pub(super) fn tell(
        &self,
        windows: &Windows,
        threads: usize,
        lanes: &mut [impl AsMut<CoachLane> + AsRef<CoachLane> + Send],
        generator: &mut Generator,
    ) -> Told {
        let counts = [self.online.parameters().len(), self.recognition.parameters().len()];
        lanes.iter_mut().for_each(|lane| lane.as_mut().begin(counts[0], counts[1]));
        let shape = self.online.shape();
        let holdings = Holdings::new(windows);
        let mut order = || TaskOrder::shuffled(shape.marks, generator);
        let [coach_order, target_order, recognition_order] = [order(), order(), order()];
        let networks = [(&self.online, &coach_order), (&self.target, &target_order)];
        let [online, target] = networks.map(|(coach, order)| {
            let rows = rows(coach, (windows, order), &holdings, threads, lanes);
            let noise = normals(generator, holdings.count() * shape.strategy);
            Strategies::draw(shape.strategy, rows, noise)
        });
        Told { holdings, online, target, coach_order, recognition_order }
    }

    /// What shapes strategies in a step.
    pub(super) fn guess<'a>(&'a self, told: &'a Told) -> Guess<'a> {
        Guess {
            network: &self.recognition,
            order: &told.recognition_order,
            held: told.online(),
            beta: self.config.beta,
        }
    }

    /// Goes back from the strategies to the coach, once all lanes have found their slopes.
    pub(super) fn descend(
        &self,
        told: &Told,
        windows: &Windows,
        threads: usize,
        lanes: &mut [impl AsMut<CoachLane> + AsRef<CoachLane> + Send],
    ) {
        let Told { holdings, online, coach_order, .. } = told;
        let shape = self.online.shape();
        let mut slopes = vec![0.0; holdings.count() * shape.strategy];
        let mut entropies = vec![0.0; holdings.count()];
        for CoachLane { places, shares, slopes: own, .. } in lanes.iter().map(AsRef::as_ref) {
            let agents = places.iter().zip(shares).zip(own.chunks_exact(shape.strategy));
            for ((place, share), own) in agents {
                let Some(place) = *place else { continue };
                let sums = &mut slopes[place * shape.strategy..][..shape.strategy];
                sums.iter_mut().zip(own).for_each(|(sum, slope)| *sum += slope);
                entropies[place] -= self.config.beta * ENTROPY * share;
            }
        }
        let d_rows = online.backward(&slopes, &entropies);
        in_lanes(threads, lanes, |index, lane| {
            let CoachLane { input, coach_pass, coach, rows, .. } = lane.as_mut();
            for (states, strategies) in chunks(holdings).skip(index).step_by(LANES) {
                state_input(shape, windows, states, coach_order, false, input);
                coach_pass.forward(&self.online, input);
                let width = 2 * shape.strategy;
                rows.clear();
                rows.extend_from_slice(&d_rows[strategies.start * width..strategies.end * width]);
                coach_pass.backward(&self.online, input, rows, coach);
            }
        });
    }

    /// Writes the gradients of coach and recognition: those of all lanes, added in order.
    pub(super) fn write_gradient(&self, lanes: &[impl AsRef<CoachLane>], gradient: &mut [f32]) {
        gradient.fill(0.0);
        let (coach, recognition) = gradient.split_at_mut(self.online.parameters().len());
        for lane in lanes.iter().map(AsRef::as_ref) {
            coach.iter_mut().zip(&lane.coach).for_each(|(sum, value)| *sum += value);
            recognition.iter_mut().zip(&lane.recognition).for_each(|(sum, value)| *sum += value);
        }
    }

    /// Follows the gradient.
    pub(super) fn follow(&mut self, gradient: &[f32], learning_rate: f32) {
        let (coach, recognition) = gradient.split_at(self.online.parameters().len());
        let [of_coach, of_recognition] = &mut self.optimisers;
        of_coach.step(self.online.parameters_mut(), coach, learning_rate);
        of_recognition.step(self.recognition.parameters_mut(), recognition, learning_rate);
    }

    /// Renews the coach of the players that value what comes next.
    pub(super) fn copy_target(&mut self) {
        self.target.clone_from(&self.online);
    }
}

/// The decisions in parts that fit the cache, with the range of their strategies.
fn chunks(holdings: &Holdings) -> impl Iterator<Item = (&[usize], std::ops::Range<usize>)> {
    holdings.decisions.chunks(CHUNK).enumerate().map(|(chunk, states)| {
        let first = chunk * CHUNK;
        (states, holdings.ends[first]..holdings.ends[first + states.len()])
    })
}

/// What a coach gives at all decisions, `[strategies, 2 R]`.
fn rows(
    coach: &Coach,
    (windows, order): (&Windows, &TaskOrder),
    holdings: &Holdings,
    threads: usize,
    lanes: &mut [impl AsMut<CoachLane> + AsRef<CoachLane> + Send],
) -> Vec<f32> {
    in_lanes(threads, lanes, |index, lane| {
        let CoachLane { input, coach_pass, rows, .. } = lane.as_mut();
        rows.clear();
        for (states, _) in chunks(holdings).skip(index).step_by(LANES) {
            state_input(coach.shape(), windows, states, order, false, input);
            rows.extend_from_slice(coach_pass.forward(coach, input));
        }
    });
    let width = 2 * coach.shape().strategy;
    let mut all = Vec::with_capacity(holdings.count() * width);
    let mut unread: Vec<&[f32]> = lanes.iter().map(|lane| &*lane.as_ref().rows).collect();
    for (chunk, (_, strategies)) in chunks(holdings).enumerate() {
        let own = unread[chunk % LANES].split_off(..strategies.len() * width);
        all.extend_from_slice(own.expect("a lane has the rows of its chunks"));
    }
    all
}
