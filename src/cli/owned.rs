//! Policies and allocators that bring their memory along, so that a process can change to them in the midst of its work.

use self_cell::{MutBorrow, self_cell};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, Observation, Policy,
};
use sortie_ipc::{SwappedAllocator, SwappedPolicy};

use crate::allocator::DeployedAllocator;
use crate::failure::Failure;
use crate::policy::DeployedPolicy;

type BoundPolicy<'a> = Box<dyn Policy + Send + 'a>;
type BoundAllocator<'a> = Box<dyn Allocator + Send + 'a>;

self_cell!(
    struct OwnedPolicy {
        owner: MutBorrow<DeployedPolicy>,
        #[not_covariant]
        dependent: BoundPolicy,
    }
);

self_cell!(
    struct OwnedAllocator {
        owner: MutBorrow<DeployedAllocator>,
        #[not_covariant]
        dependent: BoundAllocator,
    }
);

/// The policy of one team, over a memory of its own, warm.
pub(crate) fn policy(memory: DeployedPolicy) -> Result<SwappedPolicy, Failure> {
    let owned = OwnedPolicy::try_new(MutBorrow::new(memory), |memory| memory.borrow_mut().team())?;
    owned.warm();
    Ok(Box::new(owned))
}

/// The allocator over a memory of its own.
pub(crate) fn allocator(memory: DeployedAllocator) -> Result<SwappedAllocator, Failure> {
    let memory = MutBorrow::new(memory);
    let owned = OwnedAllocator::try_new(memory, |memory| memory.borrow_mut().allocator())?;
    Ok(Box::new(owned))
}

impl Policy for OwnedPolicy {
    fn actions(&self) -> usize {
        self.with_dependent(|_, policy| policy.actions())
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.with_dependent_mut(|_, policy| policy.utilities(observation, utilities))
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.with_dependent_mut(|_, policy| policy.decide(observation))
    }

    fn decide_batch(
        &mut self,
        observations: &[Observation<'_>],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        self.with_dependent_mut(|_, policy| policy.decide_batch(observations, decisions));
    }

    fn warm(&self) {
        self.with_dependent(|_, policy| policy.warm());
    }

    fn begin_episode(&mut self) -> bool {
        self.with_dependent_mut(|_, policy| policy.begin_episode())
    }
}

impl Allocator for OwnedAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        self.with_dependent_mut(|_, allocator| allocator.allocate(state, allocation))
    }
}
