//! Keeps decisions of a policy as golden cases.

use sortie_bundle::{GoldenCase, GoldenEpisode, GoldenTick, OwnedObservation};
use sortie_core::options::Pursuit;
use sortie_core::{DecideError, Decision, Observation, Policy};

use crate::error::LearnError;

/// Golden observations of a bundle.
const GOLDEN_CASES: usize = 256;
/// One of so many decisions becomes golden, so that they come from many episodes.
const GOLDEN_STRIDE: usize = 37;

/// A policy whose decisions a function takes in its place, with what the agent remembers, and may keep.
pub struct DecoratedPolicy<P, D> {
    policy: P,
    decide: D,
}

impl<P, D> DecoratedPolicy<P, D>
where
    P: Policy,
    D: FnMut(&mut P, &Observation<'_>, &mut [f32]) -> Result<Decision, DecideError>,
{
    /// Decides by this function.
    pub fn new(policy: P, decide: D) -> Self {
        Self { policy, decide }
    }
}

impl<P, D> Policy for DecoratedPolicy<P, D>
where
    P: Policy,
    D: FnMut(&mut P, &Observation<'_>, &mut [f32]) -> Result<Decision, DecideError>,
{
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.policy.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn begin_episode(&mut self) -> bool {
        self.policy.begin_episode()
    }

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        (self.decide)(&mut self.policy, observation, hidden)
    }
}

/// Episodes that are played at a time until there is enough that is golden, and how often at most.
pub const EPISODES: usize = 20;
pub(super) const ROUNDS: u64 = 100;

/// Keeps every so many-th decision: the answer of an agent with an empty memory.
#[derive(Debug)]
pub struct Recorder {
    features: usize,
    decisions: usize,
    /// What was kept.
    pub cases: Vec<GoldenCase>,
}

impl Recorder {
    /// Keeps decisions on rows of so many features.
    pub fn new(features: usize) -> Self {
        Self { features, decisions: 0, cases: Vec::new() }
    }

    /// Plays by seeds from this one on, [`EPISODES`] of each, until enough is kept.
    ///
    /// # Errors
    /// Those of a round.
    pub fn fill(
        &mut self,
        seed: u64,
        mut round: impl FnMut(&mut Self, u64) -> Result<(), LearnError>,
    ) -> Result<(), LearnError> {
        let mut seeds = (0..ROUNDS).map(|number| seed.wrapping_add(number));
        seeds.try_for_each(|seed| if self.is_full() { Ok(()) } else { round(self, seed) })
    }

    /// A policy of whose decisions some are kept.
    pub fn of<'a>(&'a mut self, policy: impl Policy + 'a) -> impl Policy + 'a {
        DecoratedPolicy::new(policy, |policy, observation, hidden| {
            self.decisions += 1;
            if self.decisions % GOLDEN_STRIDE == 1 && !self.is_full() {
                let mut utilities = vec![0.0; policy.actions()];
                let mut empty = vec![0.0; hidden.len()];
                policy.utilities_with(observation, &mut empty, &mut utilities)?;
                empty.fill(0.0);
                let action = policy.decide_with(observation, &mut empty)?.action;
                let observation = OwnedObservation::copy_of(observation, self.features);
                self.cases.push(GoldenCase { observation, utilities, action });
            }
            policy.decide_with(observation, hidden)
        })
    }

    fn is_full(&self) -> bool {
        self.cases.len() >= GOLDEN_CASES
    }
}

/// Keeps every tick of the episode of a policy that runs options.
pub(super) fn recorded_episode(policy: impl Policy, episode: &mut GoldenEpisode) -> impl Policy {
    DecoratedPolicy::new(policy, move |policy, observation, hidden| {
        let decision = policy.decide_with(observation, hidden)?;
        let (ones, others) = GoldenTick::sparse(observation.rows);
        if let Some(Pursuit { goal, steps }) = Pursuit::of(hidden) {
            let (goal, chose, action) = (goal as u16, steps == 1, decision.action);
            episode.ticks.push(GoldenTick { ones, others, goal, chose, action });
        }
        Ok(decision)
    })
}
