//! The terms of the loss that shape strategies, and what a lane of a step computes of them.
//!
//! With the public code: the recognition network guesses the strategy that an agent holds from what it
//! sees and does; the logarithm of the guess's density is to be large, and so is, a tenth as much, the
//! entropy of what the strategy was drawn from. Both are sums over a strategy's numbers, and means over
//! the agents of a state and over the states that can be learned from.
//!
//! Strategies of a batch of windows are drawn where they are decided, and held until the next decision.

use super::state_input;
use crate::alma::agents::{TaskOrder, UtilityInput};
use crate::alma::coach::{CoachPass, Recognition, RecognitionPass, gaussian};
use crate::alma::windows::Windows;

/// The coach's part of a lane: buffers, gradients, and the slopes of the strategies in its states.
#[derive(Clone, Debug, Default)]
pub(in crate::alma::windows::low_level) struct CoachLane {
    pub(super) input: UtilityInput,
    pub(super) coach_pass: CoachPass,
    recognition_pass: RecognitionPass,
    d_rows: Vec<f32>,
    /// What a coach gave for the decisions of this lane.
    pub(super) rows: Vec<f32>,
    /// Which strategies the agents of its states hold.
    pub(super) places: Vec<Option<usize>>,
    /// What part of the whole each agent is.
    pub(super) shares: Vec<f32>,
    /// Slopes of the loss by what they hold, `[agents, R]`.
    pub(super) slopes: Vec<f32>,
    pub(super) coach: Vec<f32>,
    pub(super) recognition: Vec<f32>,
    /// Its part of the terms.
    pub(in crate::alma::windows::low_level) loss: f64,
}

impl CoachLane {
    /// Forgets the step before; there are so many parameters of coach and recognition.
    pub(super) fn begin(&mut self, coach: usize, recognition: usize) {
        self.places.clear();
        self.shares.clear();
        self.slopes.clear();
        for (gradient, count) in [(&mut self.coach, coach), (&mut self.recognition, recognition)] {
            gradient.clear();
            gradient.resize(count, 0.0);
        }
        self.loss = 0.0;
    }
}

/// What the terms are computed with.
#[derive(Clone, Copy)]
pub(in crate::alma::windows::low_level) struct Guess<'a> {
    pub(super) network: &'a Recognition,
    pub(super) order: &'a TaskOrder,
    pub(super) held: Held<'a>,
    pub(super) beta: f32,
}

impl Guess<'_> {
    /// Adds to a lane the terms of some of so many states. The slopes of the rest of the loss by what
    /// their agents hold are `d_strategies [agents, R]`.
    pub(in crate::alma::windows::low_level) fn descend(
        &self,
        windows: &Windows,
        (states, of): (&[usize], usize),
        d_strategies: &[f32],
        lane: &mut CoachLane,
    ) {
        let shape = self.network.shape();
        let width = shape.coach.strategy;
        state_input(shape.coach, windows, states, self.order, true, &mut lane.input);
        let rows = lane.recognition_pass.forward(self.network, &lane.input);
        let first = lane.places.len();
        lane.slopes.extend_from_slice(d_strategies);
        for state in states {
            let present = &windows.present[state * windows.shape.entities..];
            let agents = (0..windows.shape.agents).filter(|agent| present[*agent]);
            let share = 1.0 / (of * agents.clone().count().max(1)) as f32;
            for agent in agents {
                lane.places.push(self.held.holdings.held(*state, agent));
                lane.shares.push(share);
            }
        }
        let nothing = vec![0.0; width];
        lane.d_rows.resize(rows.len(), 0.0);
        let agents = lane.places[first..].iter().zip(&lane.shares[first..]);
        let slopes = lane.slopes[first * width..].chunks_exact_mut(width);
        let rows = rows.chunks_exact(2 * width).zip(lane.d_rows.chunks_exact_mut(2 * width));
        for (((place, share), slopes), (row, d_row)) in agents.zip(slopes).zip(rows) {
            let strategies = self.held.strategies;
            let strategy = place.map_or(&*nothing, |place| strategies.at(place));
            let log_variances = place.map_or(&*nothing, |place| strategies.log_variances(place));
            let weight = -self.beta * share;
            let mut sum = 0.0;
            for index in 0..width {
                let (density, [by_number, by_mean, by_log_variance]) =
                    gaussian::log_density(strategy[index], row[index], row[width + index]);
                slopes[index] += weight * by_number;
                d_row[index] = weight * by_mean;
                d_row[width + index] = weight * by_log_variance;
                sum += density + ENTROPY * gaussian::entropy(log_variances[index]).0;
            }
            lane.loss += f64::from(weight * sum);
        }
        let CoachLane { input, recognition_pass, d_rows, recognition, .. } = lane;
        recognition_pass.backward(self.network, input, d_rows, recognition);
    }
}

/// What the entropy weighs beside the recognition.
pub(super) const ENTROPY: f32 = 0.1;

/// The place of an agent that has been told nothing.
const NOTHING: u32 = u32::MAX;

/// Where strategies are decided, and who holds which.
#[derive(Clone, Debug)]
pub(in crate::alma::windows::low_level) struct Holdings {
    /// States with a decision.
    pub(super) decisions: Vec<usize>,
    /// Agents of all decisions up to each of them; the first number is 0.
    pub(super) ends: Vec<usize>,
    /// `[W S, A]`: which of all strategies each agent holds, or [`NOTHING`].
    held: Vec<u32>,
    agents: usize,
}

impl Holdings {
    /// Follows the decisions of a batch. Who is absent where a decision is made is told nothing.
    pub(super) fn new(windows: &Windows) -> Self {
        let shape = windows.shape;
        let mut held: Vec<u32> = Vec::with_capacity(shape.states() * shape.agents);
        let (mut decisions, mut ends) = (Vec::new(), vec![0]);
        let mut told = 0_u32;
        for state in 0..shape.states() {
            if windows.decision[state] {
                let present = &windows.present[state * shape.entities..][..shape.agents];
                held.extend(present.iter().map(|present| {
                    told += u32::from(*present);
                    if *present { told - 1 } else { NOTHING }
                }));
                decisions.push(state);
                ends.push(told as usize);
            } else if state % shape.steps == 0 {
                held.resize(held.len() + shape.agents, NOTHING);
            } else {
                held.extend_from_within(held.len() - shape.agents..);
            }
        }
        Self { decisions, ends, held, agents: shape.agents }
    }

    /// Strategies of all decisions.
    pub(super) fn count(&self) -> usize {
        self.ends[self.decisions.len()]
    }

    /// Which strategy an agent holds in a state.
    pub(super) fn held(&self, state: usize, agent: usize) -> Option<usize> {
        let place = self.held[state * self.agents + agent];
        (place != NOTHING).then_some(place as usize)
    }
}

/// Strategies drawn by one coach.
#[derive(Clone, Debug)]
pub(in crate::alma::windows::low_level) struct Strategies {
    width: usize,
    /// Means and logarithms of variances `[strategies, 2 R]`.
    pub(super) rows: Vec<f32>,
    /// Standard normal numbers `[strategies, R]`.
    pub(super) noise: Vec<f32>,
    /// `[strategies, R]`
    drawn: Vec<f32>,
}

impl Strategies {
    /// Draws strategies of `width` numbers from what a coach gave.
    pub(super) fn draw(width: usize, rows: Vec<f32>, noise: Vec<f32>) -> Self {
        let mut drawn = Vec::with_capacity(noise.len());
        for (row, noise) in rows.chunks_exact(2 * width).zip(noise.chunks_exact(width)) {
            drawn.extend(gaussian::drawn(row, noise));
        }
        Self { width, rows, noise, drawn }
    }

    pub(super) fn at(&self, place: usize) -> &[f32] {
        &self.drawn[place * self.width..][..self.width]
    }

    /// The logarithms of its variances.
    pub(super) fn log_variances(&self, place: usize) -> &[f32] {
        &self.rows[(2 * place + 1) * self.width..][..self.width]
    }

    /// The slopes of a loss by what the coach gave, from those by the strategies, each of which has
    /// `entropies` times the slope of its entropy besides.
    pub(super) fn backward(&self, d_drawn: &[f32], entropies: &[f32]) -> Vec<f32> {
        let width = self.width;
        let mut d_rows = Vec::with_capacity(self.rows.len());
        for (place, (slopes, entropy)) in d_drawn.chunks_exact(width).zip(entropies).enumerate() {
            d_rows.extend_from_slice(slopes);
            let noise = &self.noise[place * width..][..width];
            let numbers = slopes.iter().zip(noise).zip(self.log_variances(place));
            d_rows.extend(numbers.map(|((slope, noise), log_variance)| {
                let drawn = 0.5 * slope * noise * gaussian::deviation(*log_variance);
                drawn + entropy * gaussian::entropy(*log_variance).1
            }));
        }
        d_rows
    }
}

#[derive(Clone, Copy, Debug)]
pub(in crate::alma::windows::low_level) struct Held<'a> {
    pub(super) holdings: &'a Holdings,
    pub(super) strategies: &'a Strategies,
}

impl<'a> Held<'a> {
    /// What an agent holds in a state; before a first decision, nothing.
    pub(in crate::alma::windows::low_level) fn of(
        self,
        state: usize,
        agent: usize,
    ) -> Option<&'a [f32]> {
        self.holdings.held(state, agent).map(|place| self.strategies.at(place))
    }
}
