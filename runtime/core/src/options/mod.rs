//! Agents that go from milestone to milestone (hierarchical affordance learning, dissertation chapter 6).
//!
//! A *meta-controller* chooses which milestone to go for, a *controller* acts until one is reached or its time is over (an
//! *option*), and a classifier says which milestones can be reached next. [`OptionPolicy`] is such an agent over its three
//! networks: a [`Policy`] whose memory is the running option. Nothing is allocated, and the same bits come out everywhere.

mod choices;
mod memory;
mod networks;
mod rules;
mod shown;
#[cfg(test)]
mod tests;

pub use choices::{best, least_missed};
pub use memory::Pursuit;
pub use networks::{OptionNetworks, PlanNetworks};
pub use rules::{Affordance, MILESTONES, Milestone, OptionRules};
pub use shown::{LEVELS, PictureShape, Shown, view_of};

use crate::choose::masked_argmax;
use crate::limits;
use crate::math::all_finite;
use crate::policy::{DecideError, Decision, Observation, Policy};
use memory::Memory;
use rules::bit;

/// What is drawn in a tick, by number.
const GOAL: u64 = 0;
const WHICH_GOAL: u64 = 1;
const ACTION: u64 = 2;
const WHICH_ACTION: u64 = 3;

/// An agent that runs options. `row` is room for the columns that its networks are shown, [`Shown::columns`] of them.
#[derive(Debug)]
pub struct OptionPolicy<N, R> {
    rules: OptionRules,
    shown: Shown,
    networks: N,
    row: R,
}

/// What a tick comes to, before it is remembered.
struct Tick {
    /// The goal, where an option begins.
    begun: Option<usize>,
    /// Whether the goal before was missed, where one begins.
    missed: Option<usize>,
    /// A drawn action; else the values are to be ranked.
    drawn: Option<u16>,
    /// How many better actions are passed over.
    passed_over: usize,
}

impl<N: OptionNetworks, R: AsMut<[f32]>> OptionPolicy<N, R> {
    /// None where the rules' picture cannot be shown, or the row is of another length.
    pub fn new(rules: OptionRules, networks: N, mut row: R) -> Option<Self> {
        let shown = Shown::new(rules.picture)?;
        let fits = row.as_mut().len() == shown.columns() && rules.actions <= limits::ACTIONS;
        fits.then_some(Self { rules, shown, networks, row })
    }

    /// The rules.
    pub fn rules(&self) -> &OptionRules {
        &self.rules
    }

    /// Writes how likely an agent with such a row believes each milestone can be reached next.
    pub fn likelihoods(
        &mut self,
        observation: &Observation<'_>,
        likelihoods: &mut [f32],
    ) -> Result<(), DecideError> {
        if likelihoods.len() != self.rules.milestones().len() {
            return Err(DecideError::BadLength);
        }
        self.look(observation)?;
        self.networks.affordances(self.row.as_mut(), likelihoods)
    }

    fn mask_of_seen(&mut self) -> Result<u32, DecideError> {
        let mut likelihoods = [0.0; MILESTONES];
        let likelihoods = likelihoods.get_mut(..self.rules.milestones().len());
        let likelihoods = likelihoods.ok_or(DecideError::BadLength)?;
        self.networks.affordances(self.row.as_mut(), likelihoods)?;
        Ok(self.rules.mask(likelihoods))
    }

    /// Lays out what the networks are shown; returns what stands for it.
    fn look(&mut self, observation: &Observation<'_>) -> Result<u32, DecideError> {
        let row = own_row(observation, self.rules.picture.features())?;
        self.shown.lay_out(row, self.row.as_mut()).ok_or(DecideError::BadLength)
    }

    /// Computes a tick and the values of its actions, and remembers it.
    fn tick(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        values: &mut [f32],
    ) -> Result<Tick, DecideError> {
        let (want, got) = (self.hidden(), hidden.len());
        if observation.available.len() != self.rules.actions {
            return Err(DecideError::BadLength);
        }
        let open = observation.available.iter().filter(|code| **code != 0).count();
        if open == 0 {
            return Err(DecideError::NoAvailableAction);
        }
        let view = self.look(observation)?;
        let picture = self.rules.picture;
        let row = own_row(observation, picture.features())?;
        let carried = row.get(picture.features() - picture.counts..).unwrap_or_default();
        let memory = Memory::of(hidden, &self.rules);
        let mut memory = memory.ok_or(DecideError::HiddenState { want, got })?;
        let mut tick = Tick { begun: None, missed: None, drawn: None, passed_over: 0 };
        let goal = match self.running(&memory, carried) {
            Ok(goal) => goal,
            Err(missed) => {
                tick.missed = missed;
                *tick.begun.insert(self.choose(&memory, missed)?)
            }
        };
        self.networks.actions(self.row.as_mut(), goal, values)?;
        let rules = &self.rules;
        let draw = |what| draw(rules.seed, memory.ticks(), what);
        if unit(draw(ACTION)) < rules.action_chance {
            let place = below(draw(WHICH_ACTION), open);
            let available = observation.available.iter().enumerate();
            let drawn = available.filter(|(_, code)| **code != 0).nth(place);
            tick.drawn = drawn.map(|(action, _)| action as u16);
        } else if rules.varied && tick.begun.is_none() {
            tick.passed_over = memory.meetings(view).checked_rem(open).unwrap_or(0);
        }
        if let Some(goal) = tick.begun {
            memory.begin(goal);
            if rules.varied {
                memory.miss(tick.missed);
            }
        }
        memory.pass(carried);
        if tick.drawn.is_none() && rules.varied {
            memory.meet(view);
        }
        Ok(tick)
    }

    /// The goal of the option that goes on, or else what was missed by that which is over.
    fn running(&self, memory: &Memory<'_>, carried: &[f32]) -> Result<usize, Option<usize>> {
        let Some(pursuit) = memory.pursuit() else { return Err(None) };
        if self.rules.reached(memory.carried(), carried).is_some() {
            return Err(None);
        }
        let over = pursuit.steps >= usize::from(self.rules.steps);
        let known = pursuit.goal < self.rules.milestones().len();
        if over || !known { Err(Some(pursuit.goal)) } else { Ok(pursuit.goal) }
    }

    /// What to go for: the best of what can be reached, of those that were missed least often since the last milestone.
    fn choose(&mut self, memory: &Memory<'_>, missed: Option<usize>) -> Result<usize, DecideError> {
        let goals = self.rules.milestones().len();
        let mut mask = self.mask_of_seen()?;
        let draw = |what| draw(self.rules.seed, memory.ticks(), what);
        if unit(draw(GOAL)) < self.rules.goal_chance {
            let place = below(draw(WHICH_GOAL), mask.count_ones() as usize);
            let mut open = (0..goals).filter(|goal| mask & bit(*goal) != 0);
            return open.nth(place).ok_or(DecideError::NonFinite);
        }
        if self.rules.varied && missed.is_some() {
            let count = |goal: usize| memory.missed(goal) + usize::from(missed == Some(goal));
            mask = least_missed(mask, count);
        }
        let mut values = [0.0; MILESTONES];
        let values = values.get_mut(..goals).ok_or(DecideError::BadLength)?;
        self.networks.goals(self.row.as_mut(), values)?;
        best(values, |goal| mask & bit(goal) != 0).ok_or(DecideError::NonFinite)
    }
}

impl<N: OptionNetworks, R: AsMut<[f32]>> Policy for OptionPolicy<N, R> {
    fn actions(&self) -> usize {
        self.rules.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Err(DecideError::HiddenState { want: self.hidden(), got: 0 })
    }

    fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
        Err(DecideError::HiddenState { want: self.hidden(), got: 0 })
    }

    fn hidden(&self) -> usize {
        memory::floats(&self.rules)
    }

    /// The controller's values of the actions for the goal.
    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        if utilities.len() != self.rules.actions {
            return Err(DecideError::BadLength);
        }
        self.tick(observation, hidden, utilities).map(drop)
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let mut values = [0.0; limits::ACTIONS];
        let values = values.get_mut(..self.rules.actions).ok_or(DecideError::BadLength)?;
        let tick = self.tick(observation, hidden, values)?;
        if let Some(action) = tick.drawn {
            let utility = values.get(usize::from(action)).copied().unwrap_or(0.0);
            return Ok(Decision { action, utility });
        }
        let mut available = [0; limits::ACTIONS];
        let available = available.get_mut(..values.len()).ok_or(DecideError::BadLength)?;
        available.iter_mut().zip(observation.available).for_each(|(to, from)| *to = *from);
        for _ in 0..tick.passed_over {
            let better = masked_argmax(values, available)?.action;
            available.get_mut(usize::from(better)).into_iter().for_each(|code| *code = 0);
        }
        masked_argmax(values, available)
    }
}

/// The features of the agent that observes.
fn own_row<'o>(observation: &Observation<'o>, features: usize) -> Result<&'o [f32], DecideError> {
    let start = observation.self_index.saturating_mul(observation.stride);
    let row = observation.rows.get(start..start.saturating_add(features));
    let row = row.filter(|_| observation.stride >= features).ok_or(DecideError::BadLength)?;
    all_finite(row).then_some(row).ok_or(DecideError::NonFinite)
}

/// 32 random bits for a tick (SplitMix64).
fn draw(seed: u64, tick: u32, what: u64) -> u32 {
    let counter = u64::from(tick).wrapping_mul(4).wrapping_add(what).wrapping_add(1);
    let mut bits = seed.wrapping_add(counter.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((bits ^ (bits >> 31)) >> 32) as u32
}

/// A number in [0, 1).
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 / (1 << 24) as f32
}

/// A whole number below another.
fn below(bits: u32, most: usize) -> usize {
    ((u64::from(bits) * most as u64) >> 32) as usize
}
