//! Teams whose agents do not all decide by the same policy.

use core::ops::{Deref, DerefMut};

use crate::policy::{DecideError, Decision, Observation, Policy};

/// Agents each of which decides by one of several policies.
///
/// A policy reads the first features of a row, as many as it takes, and chooses among the first actions, as many as it
/// has: the others get utility 0 and are not chosen, available or not.
#[derive(Debug)]
pub struct PolicyByAgent<C, T> {
    policies: C,
    policy_of: T,
    actions: usize,
}

impl<P: Policy, C: DerefMut<Target = [P]>, T: Deref<Target = [u16]>> PolicyByAgent<C, T> {
    /// Agent a decides by `policies[policy_of[a]]`; the team has so many actions.
    pub fn new(policies: C, policy_of: T, actions: usize) -> Self {
        Self { policies, policy_of, actions }
    }

    /// The policy of the agent that observes, and what it observes as far as the policy knows.
    fn own<'o>(
        &mut self,
        seen: &Observation<'o>,
    ) -> Result<(&mut P, Observation<'o>), DecideError> {
        let (agent, agents) = (seen.self_index, self.policy_of.len());
        let unknown = DecideError::UnknownAgent { agents, agent };
        let index = usize::from(*self.policy_of.get(agent).ok_or(unknown)?);
        let policy = self.policies.get_mut(index).ok_or(unknown)?;
        if seen.available.len() != self.actions {
            return Err(DecideError::BadLength);
        }
        let available = seen.available.get(..policy.actions()).ok_or(DecideError::BadLength)?;
        Ok((policy, Observation { available, ..*seen }))
    }
}

impl<P, C, T> Policy for PolicyByAgent<C, T>
where
    P: Policy,
    C: DerefMut<Target = [P]>,
    T: Deref<Target = [u16]>,
{
    fn actions(&self) -> usize {
        self.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.utilities_with(observation, &mut [], utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn warm(&self) {
        self.policies.iter().for_each(Policy::warm);
    }

    fn begin_episode(&mut self) -> bool {
        self.policies
            .iter_mut()
            .fold(false, |had_memory, policy| policy.begin_episode() | had_memory)
    }

    fn hidden(&self) -> usize {
        self.policies.iter().map(Policy::hidden).max().unwrap_or(0)
    }

    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        if utilities.len() != self.actions {
            return Err(DecideError::BadLength);
        }
        let (policy, seen) = self.own(observation)?;
        let parts = utilities.split_at_mut_checked(policy.actions());
        let (known, unknown) = parts.ok_or(DecideError::BadLength)?;
        policy.utilities_with(&seen, own_memory(policy, hidden)?, known)?;
        unknown.fill(0.0);
        Ok(())
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let (policy, seen) = self.own(observation)?;
        policy.decide_with(&seen, own_memory(policy, hidden)?)
    }
}

/// Of an agent's memory, which has room for that of every policy, as much as its own has.
fn own_memory<'m>(
    policy: &impl Policy,
    memory: &'m mut [f32],
) -> Result<&'m mut [f32], DecideError> {
    let (want, got) = (policy.hidden(), memory.len());
    memory.get_mut(..want).ok_or(DecideError::HiddenState { want, got })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choose::masked_argmax;
    use crate::entity_mask::EntityMask;

    /// Scores its actions from a number on, and remembers how often in the first of its numbers.
    struct Counting {
        from: f32,
        actions: usize,
        memory: usize,
    }

    impl Policy for Counting {
        fn actions(&self) -> usize {
            self.actions
        }

        fn utilities(
            &mut self,
            observation: &Observation<'_>,
            utilities: &mut [f32],
        ) -> Result<(), DecideError> {
            self.utilities_with(observation, &mut [0.0], utilities)
        }

        fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
            self.decide_with(observation, &mut [0.0])
        }

        /// Scores from 0 on from now on.
        fn begin_episode(&mut self) -> bool {
            self.from = 0.0;
            self.memory > 1
        }

        fn hidden(&self) -> usize {
            self.memory
        }

        fn utilities_with(
            &mut self,
            _: &Observation<'_>,
            hidden: &mut [f32],
            utilities: &mut [f32],
        ) -> Result<(), DecideError> {
            assert_eq!([utilities.len(), hidden.len()], [self.actions, self.memory]);
            hidden[0] += 1.0;
            let scores = (0..).map(|action| self.from + action as f32 * hidden[0]);
            utilities.iter_mut().zip(scores).for_each(|(to, score)| *to = score);
            Ok(())
        }

        fn decide_with(
            &mut self,
            observation: &Observation<'_>,
            hidden: &mut [f32],
        ) -> Result<Decision, DecideError> {
            let mut utilities = [0.0; 3];
            let utilities = &mut utilities[..self.actions];
            self.utilities_with(observation, hidden, utilities)?;
            masked_argmax(utilities, observation.available)
        }
    }

    const TEAM: [Counting; 2] = [
        Counting { from: -5.0, actions: 2, memory: 1 },
        Counting { from: 10.0, actions: 3, memory: 1 },
    ];

    fn seen(self_index: usize, available: &[u16]) -> Observation<'_> {
        let visible = EntityMask::EMPTY;
        Observation { rows: &[], stride: 1, last_actions: &[], visible, self_index, available }
    }

    #[test]
    fn every_agent_decides_by_its_own_policy_among_its_own_actions() {
        let (mut policies, policy_of) = (TEAM, [1, 0, 0]);
        let mut team = PolicyByAgent::new(&mut policies[..], &policy_of[..], 3);
        assert_eq!((team.actions(), team.hidden()), (3, 1));
        let mut utilities = |agent| {
            let mut utilities = [9.0; 3];
            team.utilities_with(&seen(agent, &[1; 3]), &mut [0.0], &mut utilities).unwrap();
            utilities
        };
        assert_eq!(utilities(0), [10.0, 11.0, 12.0]);
        assert_eq!(utilities(2), [-5.0, -4.0, 0.0]);
        let mut decide = |agent, available: [u16; 3]| {
            team.decide_with(&seen(agent, &available), &mut [1.0]).map(|decision| decision.action)
        };
        assert_eq!((decide(0, [1; 3]), decide(1, [1; 3])), (Ok(2), Ok(1)));
        assert_eq!(decide(1, [0, 0, 1]), Err(DecideError::NoAvailableAction));
    }

    #[test]
    fn agents_of_a_frame_decide_each_with_its_own_memory() {
        let (mut policies, policy_of) = (TEAM, [1, 0]);
        let mut team = PolicyByAgent::new(&mut policies[..], &policy_of[..], 3);
        let mut decisions = [Err(DecideError::BadLength); 2];
        let mut hidden = [0.0, 4.0];
        let frame = [seen(0, &[1; 3]), seen(1, &[1; 3])];
        team.decide_batch_with(&frame, &mut hidden, &mut decisions);
        assert_eq!(decisions[0], Ok(Decision { action: 2, utility: 12.0 }));
        assert_eq!(decisions[1], Ok(Decision { action: 1, utility: 0.0 }));
        assert_eq!(hidden, [1.0, 5.0]);
    }

    #[test]
    fn every_agent_has_room_for_the_largest_memory() {
        let mut policies = TEAM;
        policies[1].memory = 3;
        let mut team = PolicyByAgent::new(&mut policies[..], &[0, 1][..], 3);
        assert_eq!(team.hidden(), 3);
        let (mut hidden, mut decisions) = ([0.0; 6], [Err(DecideError::BadLength); 2]);
        team.decide_batch_with(&[seen(0, &[1; 3]), seen(1, &[1; 3])], &mut hidden, &mut decisions);
        assert_eq!(decisions.map(|decision| decision.map(|it| it.action)), [Ok(1), Ok(2)]);
        assert_eq!(hidden, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn an_episode_begins_for_all_policies() {
        for with_memory in [0, 1] {
            let mut policies = TEAM;
            policies[with_memory].memory = 2;
            let mut team = PolicyByAgent::new(&mut policies[..], &[0, 1][..], 3);
            assert!(team.begin_episode());
            assert_eq!(policies.map(|policy| policy.from), [0.0; 2]);
        }
        let mut policies = TEAM;
        assert!(!PolicyByAgent::new(&mut policies[..], &[0, 1][..], 3).begin_episode());
    }

    #[test]
    fn others_than_the_teams_agents_and_sizes_are_refused() {
        let (mut policies, policy_of) = (TEAM, [1, 0, 7]);
        let mut team = PolicyByAgent::new(&mut policies[..], &policy_of[..], 3);
        let mut decide = |agent, available: &[u16]| {
            team.decide_with(&seen(agent, available), &mut [0.0]).unwrap_err()
        };
        for agent in [2, 3] {
            let unknown = DecideError::UnknownAgent { agents: 3, agent };
            assert_eq!(decide(agent, &[1; 3]), unknown);
        }
        assert_eq!(decide(0, &[1; 2]), DecideError::BadLength);
        let short = team.utilities_with(&seen(1, &[1; 3]), &mut [0.0], &mut [0.0; 2]);
        assert_eq!(short, Err(DecideError::BadLength));
    }
}
