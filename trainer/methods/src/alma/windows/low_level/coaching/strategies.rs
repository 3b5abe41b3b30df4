//! The strategies of a batch of windows: drawn where they are decided, held until the next decision.

use crate::alma::coach::gaussian;
use crate::alma::windows::batch::Windows;

/// The place of an agent that has been told nothing.
const NOTHING: u32 = u32::MAX;

/// Where strategies are decided, and who holds which.
#[derive(Clone, Debug)]
pub(in super::super) struct Holdings {
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
pub(in super::super) struct Strategies {
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

    /// A strategy by its place.
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

/// The strategies that agents hold.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Held<'a> {
    pub(super) holdings: &'a Holdings,
    pub(super) strategies: &'a Strategies,
}

impl<'a> Held<'a> {
    /// What an agent holds in a state; before a first decision, nothing.
    pub(in super::super) fn of(self, state: usize, agent: usize) -> Option<&'a [f32]> {
        self.holdings.held(state, agent).map(|place| self.strategies.at(place))
    }
}
