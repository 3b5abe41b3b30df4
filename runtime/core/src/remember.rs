//! Policies with memory, for callers that keep none.

use crate::policy::{DecideError, Decision, Observation, Policy};

/// Keeps the recurrent states of a policy's agents, and clears them where an episode begins.
///
/// To its caller it is a policy without memory: the state belongs to the agent that observes.
#[derive(Debug)]
pub struct Remembering<'m, P> {
    policy: P,
    memory: &'m mut [f32],
}

impl<'m, P: Policy> Remembering<'m, P> {
    /// `memory`, `[agents, R]`, holds the states of the first agents, of which the largest index counts.
    pub fn new(policy: P, memory: &'m mut [f32]) -> Self {
        memory.fill(0.0);
        Self { policy, memory }
    }

    /// The policy and the state of the agent that observes.
    fn recall(
        &mut self,
        observation: &Observation<'_>,
    ) -> Result<(&mut P, &mut [f32]), DecideError> {
        let size = self.policy.hidden();
        let got = self.memory.len();
        let start = observation.self_index.saturating_mul(size);
        let end = start.saturating_add(size);
        let state = self.memory.get_mut(start..end);
        Ok((&mut self.policy, state.ok_or(DecideError::HiddenState { want: end, got })?))
    }

    /// Decides for agents whose indexes follow each other, so that their states do.
    fn decide_in_turn(
        &mut self,
        observations: &[Observation<'_>],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        let size = self.policy.hidden();
        let first = observations.first().map_or(0, |observation| observation.self_index);
        let start = first.saturating_mul(size);
        let end = start.saturating_add(observations.len().saturating_mul(size));
        if let Some(states) = self.memory.get_mut(start..end) {
            return self.policy.decide_batch_with(observations, states, decisions);
        }
        // Whoever has no state gets that error, the others decide.
        for (observation, decision) in observations.iter().zip(decisions) {
            *decision = self.decide(observation);
        }
    }
}

impl<P: Policy> Policy for Remembering<'_, P> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let (policy, state) = self.recall(observation)?;
        policy.utilities_with(observation, state, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let (policy, state) = self.recall(observation)?;
        policy.decide_with(observation, state)
    }

    fn decide_batch(
        &mut self,
        observations: &[Observation<'_>],
        mut decisions: &mut [Result<Decision, DecideError>],
    ) {
        if self.policy.hidden() == 0 {
            return self.policy.decide_batch(observations, decisions);
        }
        let follows = |a: &Observation<'_>, b: &Observation<'_>| {
            a.self_index.checked_add(1) == Some(b.self_index)
        };
        for observations in observations.chunk_by(follows) {
            let of_these = decisions.split_off_mut(..observations.len().min(decisions.len()));
            self.decide_in_turn(observations, of_these.unwrap_or_default());
        }
    }

    fn warm(&self) {
        self.policy.warm();
    }

    fn begin_episode(&mut self) -> bool {
        self.memory.fill(0.0);
        !self.memory.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EntityMask;

    /// Adds one to its state with every decision, and tells it.
    struct Counting;

    impl Policy for Counting {
        fn actions(&self) -> usize {
            1
        }

        fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
            Err(DecideError::HiddenState { want: 1, got: 0 })
        }

        fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
            Err(DecideError::HiddenState { want: 1, got: 0 })
        }

        fn hidden(&self) -> usize {
            1
        }

        fn decide_with(
            &mut self,
            _: &Observation<'_>,
            hidden: &mut [f32],
        ) -> Result<Decision, DecideError> {
            hidden[0] += 1.0;
            Ok(Decision { action: 0, utility: hidden[0] })
        }
    }

    #[test]
    fn every_agent_remembers_for_itself_until_the_episode_ends() {
        let mut memory = [5.0; 2];
        let mut policy = Remembering::new(Counting, &mut memory);
        let observed = |self_index| Observation {
            rows: &[],
            stride: 0,
            last_actions: &[],
            visible: EntityMask::EMPTY,
            self_index,
            available: &[1],
        };
        let count = |policy: &mut Remembering<'_, _>, agent| {
            policy.decide(&observed(agent)).map(|decision| decision.utility)
        };
        assert_eq!(count(&mut policy, 0), Ok(1.0));
        assert_eq!(count(&mut policy, 0), Ok(2.0));
        assert_eq!(count(&mut policy, 1), Ok(1.0));
        assert_eq!(count(&mut policy, 2), Err(DecideError::HiddenState { want: 3, got: 2 }));
        assert!(policy.begin_episode());
        assert_eq!(count(&mut policy, 0), Ok(1.0));
        let mut together = [Err(DecideError::BadLength); 4];
        policy.decide_batch(&[1, 0, 1, 2].map(observed), &mut together);
        let counts = together.map(|decision| decision.map(|decision| decision.utility));
        let missing = Err(DecideError::HiddenState { want: 3, got: 2 });
        assert_eq!(counts, [Ok(1.0), Ok(2.0), Ok(2.0), missing]);
        assert_eq!((policy.hidden(), policy.actions()), (0, 1));
    }
}
