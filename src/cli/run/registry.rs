//! The bundles that a process of a team may change to: opened on a thread of their own, they bring their memory along.

use std::path::Path;

use self_cell::{MutBorrow, self_cell};
use sortie_bundle::Bundle;
use sortie_core::wire::ControlStatus;
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, Observation, Policy,
};
use sortie_ipc::{Loaded, LoadedModel, Registry, SwappedAllocator, SwappedPolicy};

use crate::allocator::DeployedAllocator;
use crate::deployment::{beside, is_bundle_name, model_id};
use crate::failure::Failure;
use crate::output::tell;
use crate::policy::{Backend, DeployedPolicy};
use crate::trust::TrustArguments;

/// The policies of bundles beside that of a process.
pub(super) fn policies(
    folder: &Path,
    trust: &TrustArguments,
    backend: Backend,
) -> Result<Registry<SwappedPolicy>, Failure> {
    registry(folder, trust, move |bundle| {
        DeployedPolicy::open(bundle, backend).and_then(owned_policy)
    })
}

/// The allocators of bundles beside that of a process, as `open` opens them.
pub(super) fn allocators(
    folder: &Path,
    trust: &TrustArguments,
    open: impl Fn(&Bundle) -> Result<DeployedAllocator, Failure> + Send + 'static,
) -> Result<Registry<SwappedAllocator>, Failure> {
    registry(folder, trust, move |bundle| open(bundle).and_then(owned_allocator))
}

/// The bundles beside that of a process, which take the same signatures; `load` makes of one what it works with.
fn registry<M: Send + 'static>(
    folder: &Path,
    trust: &TrustArguments,
    load: impl Fn(&Bundle) -> Result<M, Failure> + Send + 'static,
) -> Result<Registry<M>, Failure> {
    let (folder, trust) = (folder.to_path_buf(), trust.clone());
    let load = move |name: &str| -> Loaded<M> {
        let refused = |failure: Failure| {
            tell!("warning: `{name}` is not loaded: {}", failure.message);
            ControlStatus::BadArgument
        };
        if !is_bundle_name(name) {
            return Err(ControlStatus::BadArgument);
        }
        let bundle = trust.open_bundle(&beside(&folder, name)).map_err(refused)?;
        let model = load(&bundle).map_err(refused)?;
        let limits = &bundle.manifest().limits;
        Ok(LoadedModel {
            contract: bundle.contract().hash(),
            id: model_id(&bundle),
            entities_max: limits.n_max.into(),
            tasks_max: limits.t_max.into(),
            model,
        })
    };
    Ok(Registry::start(load)?)
}

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
fn owned_policy(memory: DeployedPolicy) -> Result<SwappedPolicy, Failure> {
    let owned = OwnedPolicy::try_new(MutBorrow::new(memory), |memory| memory.borrow_mut().team())?;
    owned.warm();
    Ok(Box::new(owned))
}

/// The allocator over a memory of its own.
fn owned_allocator(memory: DeployedAllocator) -> Result<SwappedAllocator, Failure> {
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
