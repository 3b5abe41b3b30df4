//! How a coach learns what to tell its players.
//!
//! Strategies are drawn where they are decided, and held until the next decision, at most to the end of a window. A
//! recognition network that is of use in training only guesses the strategy that an agent holds from what it sees and
//! does, so that strategies differ where actions do: the logarithm of the guess's density is to be large, and so is, a
//! tenth as much, the entropy of what the strategy was drawn from, which keeps the coach from telling with certainty too
//! early. Both are sums over a strategy's numbers, and means over the agents of a state and over the states that can be
//! learned from, as in the public code.

#[cfg(test)]
mod tests;

use std::ops::Range;

use sortie_nn::random::{Generator, normals, stream};
use sortie_nn::tape::{Parameters, Pass, Var};

use crate::alma::agents::{TaskOrder, UtilityInput};
use crate::alma::coach::{CoachLayers, CoachShape, RecognitionLayers, entropies};
use crate::alma::windows::Windows;

pub use crate::alma::windows::config::CoachConfig;

/// What the entropy weighs beside the recognition.
const ENTROPY: f32 = 0.1;

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
    let present = |state: usize, entities: Range<usize>| {
        entities.filter(move |entity| windows.present[state * sizes.entities + entity])
    };
    let kinds = [0..sizes.agents, sizes.agents..sizes.entities];
    for kind in &kinds {
        for state in states {
            present(*state, kind.clone()).for_each(|entity| write(*state, entity));
        }
    }
    let counts = |state: &usize| kinds.clone().map(|kind| present(*state, kind).count());
    let (mut own, mut other) = (0, states.iter().map(|state| counts(state)[0]).sum());
    for [agents, others] in states.iter().map(counts) {
        for _ in 0..agents {
            let rows = (own..own + agents).chain(other..other + others);
            rows.for_each(|row| input.visible.push(row));
            input.visible.end_list();
        }
        (own, other) = (own + agents, other + others);
    }
}

/// The layers of coach and recognition network.
#[derive(Clone, Copy, Debug)]
pub(super) struct CoachingLayers {
    pub(super) coach: CoachLayers,
    recognition: RecognitionLayers,
    beta: f32,
}

/// What some agents have been told: strategies, and the logarithms of the variances that they were drawn with,
/// `[agents, R]` each. Zeros are what those hold who have been told nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    pub(super) strategies: Var,
    log_variances: Var,
}

impl CoachingLayers {
    /// Adds tensors for players of so many actions.
    pub(super) fn new(
        config: &CoachConfig,
        (shape, actions): (CoachShape, usize),
        p: &mut Parameters,
        random: &mut Generator,
    ) -> Self {
        let coach = CoachLayers::new(shape, p, random);
        let recognition = RecognitionLayers::new(shape, actions, p, random);
        Self { coach, recognition, beta: config.beta }
    }

    /// Draws the strategies of all decisions of a window, and lists what some of its agents, by state and number, hold.
    pub(super) fn tell(
        self,
        t: &mut Pass<'_>,
        (windows, window): (&Windows, usize),
        (order, seed): (&TaskOrder, u64),
        agents: impl Iterator<Item = (usize, usize)>,
    ) -> Told {
        let width = self.coach.shape.strategy;
        let decisions = Decisions::of(windows, window);
        let nothing = t.input(width, &vec![0.0; width]);
        let (mut strategies, mut log_variances) = (nothing, nothing);
        if decisions.count > 0 {
            let mut input = UtilityInput::default();
            state_input(self.coach.shape, windows, &decisions.states, order, false, &mut input);
            let told = self.coach.strategies(t, &input);
            let noise = normals(&mut stream(seed, 0, window as u64), decisions.count * width);
            let drawn = told.draw(t, &noise);
            strategies = t.stack(&[nothing, drawn]);
            log_variances = t.stack(&[nothing, told.log_variances]);
        }
        let held = agents.map(|(state, agent)| decisions.held(state, agent));
        let held: Vec<u32> = held.collect();
        let [strategies, log_variances] =
            [strategies, log_variances].map(|all| t.gather(all, &held));
        Told { strategies, log_variances }
    }

    /// The terms of some of so many states that can be learned from, in all of which the agents that exist have been
    /// told this.
    pub(super) fn loss(
        self,
        t: &mut Pass<'_>,
        (windows, order): (&Windows, &TaskOrder),
        (states, of): (&[usize], usize),
        told: Told,
    ) -> Var {
        let mut input = UtilityInput::default();
        state_input(self.coach.shape, windows, states, order, true, &mut input);
        let guess = self.recognition.guess(t, &input);
        let densities = guess.log_density(t, told.strategies);
        let entropies = entropies(t, told.log_variances);
        let weighted = t.scale(entropies, ENTROPY);
        let numbers = t.add(densities, weighted);
        let sums = t.sum_columns(numbers);
        let mut weights = Vec::with_capacity(t.size(sums)[0]);
        for state in states {
            let present =
                &windows.present[state * windows.shape.entities..][..windows.shape.agents];
            let agents = present.iter().filter(|present| **present).count();
            let share = 1.0 / (of * agents.max(1)) as f32;
            weights.extend(std::iter::repeat_n(-self.beta * share, agents));
        }
        t.weighted_sum(sums, &weights)
    }
}

/// Where strategies are decided in a window, and who holds which.
#[derive(Debug)]
struct Decisions {
    /// States with a decision.
    states: Vec<usize>,
    /// Strategies of all of them.
    count: usize,
    /// `[S, A]`: the number of each agent's strategy, from 1 on; 0 where it has been told nothing.
    held: Vec<u32>,
    first: usize,
    agents: usize,
}

impl Decisions {
    /// Follows the decisions of a window. Who is absent where a decision is made is told nothing.
    fn of(windows: &Windows, window: usize) -> Self {
        let shape = windows.shape;
        let first = window * shape.steps;
        let (mut states, mut count, mut held) = (Vec::new(), 0, Vec::new());
        let mut now = vec![0; shape.agents];
        for state in first..first + shape.steps {
            if windows.decision[state] {
                states.push(state);
                let present = &windows.present[state * shape.entities..];
                for (now, present) in now.iter_mut().zip(present) {
                    count += u32::from(*present);
                    *now = if *present { count } else { 0 };
                }
            }
            held.extend_from_slice(&now);
        }
        Self { states, count: count as usize, held, first, agents: shape.agents }
    }

    fn held(&self, state: usize, agent: usize) -> u32 {
        self.held[(state - self.first) * self.agents + agent]
    }
}
