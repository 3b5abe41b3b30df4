//! Keeps decisions of a policy as golden cases.

use sortie_bundle::{GoldenCase, GoldenEpisode, GoldenTick, OwnedObservation};
use sortie_core::options::Pursuit;
use sortie_core::{DecideError, Decision, Observation, Policy};

/// Golden observations of a bundle.
const GOLDEN_CASES: usize = 256;
/// One of so many decisions becomes golden, so that they come from many episodes.
const GOLDEN_STRIDE: usize = 37;

/// Decides, and keeps every so many-th decision.
pub struct Recorder<P> {
    policy: P,
    features: usize,
    decisions: usize,
    /// What was kept.
    pub cases: Vec<GoldenCase>,
}

impl<P: Policy> Recorder<P> {
    /// Keeps decisions of this policy, which sees rows of so many features.
    pub fn new(policy: P, features: usize) -> Self {
        Self { policy, features, decisions: 0, cases: Vec::new() }
    }
}

impl<P: Policy> Policy for Recorder<P> {
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

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    /// What is kept is the answer of an agent with an empty memory.
    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions()];
        let mut empty = vec![0.0; hidden.len()];
        self.policy.utilities_with(observation, &mut empty, &mut utilities)?;
        empty.fill(0.0);
        let decision = self.policy.decide_with(observation, &mut empty)?;
        self.decisions += 1;
        if self.decisions % GOLDEN_STRIDE == 1 && self.cases.len() < GOLDEN_CASES {
            let observation = OwnedObservation::copy_of(observation, self.features);
            self.cases.push(GoldenCase { observation, utilities, action: decision.action });
        }
        if hidden.is_empty() { Ok(decision) } else { self.policy.decide_with(observation, hidden) }
    }
}

/// Decides for an agent that runs options, and keeps every tick of its episode.
pub struct EpisodeRecorder<P> {
    policy: P,
    /// What was kept.
    pub episode: GoldenEpisode,
}

impl<P: Policy> EpisodeRecorder<P> {
    /// Keeps the ticks of this policy.
    pub fn new(policy: P) -> Self {
        Self { policy, episode: GoldenEpisode::default() }
    }
}

impl<P: Policy> Policy for EpisodeRecorder<P> {
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
        self.policy.decide(observation)
    }

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let decision = self.policy.decide_with(observation, hidden)?;
        let (ones, others) = GoldenTick::sparse(observation.rows);
        if let Some(Pursuit { goal, steps }) = Pursuit::of(hidden) {
            let (goal, chose, action) = (goal as u16, steps == 1, decision.action);
            self.episode.ticks.push(GoldenTick { ones, others, goal, chose, action });
        }
        Ok(decision)
    }
}
