//! Guards of a team's agents: a policy decides on nothing that lies outside of ranges.

use crate::policy::{DecideError, Decision, Observation, Policy};

/// A policy that refuses an observation in which a feature of a visible entity, or of the agent itself, lies outside of its
/// range: [`DecideError::BeyondGuards`] names it, and the agent's fallback acts in the same tick.
///
/// Around a policy with memory it lets nothing be remembered of what it refuses.
#[derive(Debug)]
pub struct Guarded<'r, P> {
    policy: P,
    ranges: &'r [[f32; 2]],
}

impl<'r, P: Policy> Guarded<'r, P> {
    /// `ranges`, `[d, 2]`: the lowest and the highest value of the first d features, the same for all entities. Both are
    /// within the range, NaN is within none.
    pub fn new(policy: P, ranges: &'r [[f32; 2]]) -> Self {
        Self { policy, ranges }
    }

    fn check(&self, seen: &Observation<'_>) -> Result<(), DecideError> {
        let others = seen.visible.iter().filter(|entity| *entity != seen.self_index);
        for entity in core::iter::once(seen.self_index).chain(others) {
            let row = seen.rows.get(entity.saturating_mul(seen.stride)..).unwrap_or_default();
            let mut pairs = self.ranges.iter().zip(row);
            // Of NaN nothing is true.
            let is_within =
                |([lowest, highest], value): (&[f32; 2], &f32)| lowest <= value && value <= highest;
            if let Some(feature) = pairs.position(|pair| !is_within(pair)) {
                return Err(DecideError::BeyondGuards { entity, feature });
            }
        }
        Ok(())
    }
}

impl<P: Policy> Policy for Guarded<'_, P> {
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.check(observation)?;
        self.policy.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.check(observation)?;
        self.policy.decide(observation)
    }

    /// Those between two that are refused decide together.
    fn decide_batch(
        &mut self,
        mut observations: &[Observation<'_>],
        mut decisions: &mut [Result<Decision, DecideError>],
    ) {
        loop {
            let refused = observations.iter().position(|seen| self.check(seen).is_err());
            let passing = refused.unwrap_or(observations.len()).min(decisions.len());
            let seen = observations.split_off(..passing).unwrap_or_default();
            let decided = decisions.split_off_mut(..passing).unwrap_or_default();
            self.policy.decide_batch(seen, decided);
            let next = observations.split_off_first().zip(decisions.split_off_first_mut());
            let Some((seen, decision)) = next else { return };
            *decision = self.decide(seen);
        }
    }

    fn warm(&self) {
        self.policy.warm();
    }

    fn begin_episode(&mut self) -> bool {
        self.policy.begin_episode()
    }

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.check(observation)?;
        self.policy.utilities_with(observation, hidden, utilities)
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        self.check(observation)?;
        self.policy.decide_with(observation, hidden)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EntityMask;

    /// Says how many decide with it, counted with every call.
    struct Together;

    impl Policy for Together {
        fn actions(&self) -> usize {
            1
        }

        fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
            Ok(())
        }

        fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
            Ok(Decision { action: 1, utility: 0.0 })
        }

        fn decide_batch(
            &mut self,
            observations: &[Observation<'_>],
            decisions: &mut [Result<Decision, DecideError>],
        ) {
            let action = observations.len() as u16;
            decisions.fill(Ok(Decision { action, utility: 0.0 }));
        }
    }

    /// Three entities of two features and a column that no feature fills.
    const ROWS: [f32; 9] = [0.0, 1.0, 9.0, 0.5, 2.0, 9.0, -1.0, f32::NAN, 9.0];
    const RANGES: [[f32; 2]; 2] = [[0.0, 1.0], [1.0, 2.0]];

    fn seen(self_index: usize, visible: u64) -> Observation<'static> {
        Observation {
            rows: &ROWS,
            stride: 3,
            last_actions: &[],
            visible: EntityMask::from_words(&[visible]),
            self_index,
            available: &[1],
        }
    }

    #[test]
    fn what_is_seen_must_lie_within_its_range_and_what_is_not_seen_may_not() {
        let mut policy = Guarded::new(Together, &RANGES);
        let beyond = |entity, feature| Err(DecideError::BeyondGuards { entity, feature });
        for (seen, decided) in [
            (seen(0, 0b011), Ok(1)),
            (seen(0, 0b001), Ok(1)),
            (seen(1, 0b000), Ok(1)),
            (seen(0, 0b111), beyond(2, 0)),
            (seen(2, 0b000), beyond(2, 0)),
        ] {
            let decision = policy.decide(&seen).map(|decision| decision.action);
            assert_eq!(decision, decided, "{:?}", seen.visible);
            assert_eq!(policy.utilities(&seen, &mut [0.0]).err(), decided.err());
            assert_eq!(policy.decide_with(&seen, &mut []).err(), decided.err());
            assert_eq!(policy.utilities_with(&seen, &mut [], &mut [0.0]).err(), decided.err());
        }
        let mut of_numbers = Guarded::new(Together, &[[f32::NEG_INFINITY, f32::INFINITY]; 2]);
        let refused = DecideError::BeyondGuards { entity: 2, feature: 1 };
        assert_eq!(of_numbers.decide(&seen(0, 0b111)), Err(refused));
    }

    #[test]
    fn who_passes_decides_together_and_who_does_not_alone() {
        let mut policy = Guarded::new(Together, &RANGES);
        let refused = DecideError::BeyondGuards { entity: 2, feature: 0 };
        let team = [0, 1, 2, 2, 1].map(|agent| seen(agent, 0b011));
        let mut decisions = [Err(DecideError::BadLength); 5];
        policy.decide_batch(&team, &mut decisions);
        let decided = decisions.map(|decision| decision.map(|decision| decision.action));
        assert_eq!(decided, [Ok(2), Ok(2), Err(refused), Err(refused), Ok(1)]);
        // Answers beyond the shorter slice are not given.
        let mut few = [Err(DecideError::BadLength); 3];
        policy.decide_batch(&team, &mut few);
        assert_eq!(few[2], Err(refused));
    }
}
