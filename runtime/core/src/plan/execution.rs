//! One run of a plan's program, of an agent's network, a policy, or a team's.
//!
//! A run is a plain function of whoever names the set of operators, with all kernels of all builds inside: hundreds of
//! kilobytes. Crates do not share instances of generic functions when they are optimised, so each would compile its own
//! copy. Those of [`AllOperators`](crate::operators::AllOperators), which every host takes, are therefore functions of this
//! crate: see [`OperatorSet`].

use super::{Network, Plan};
use crate::kernels::Kernels;
use crate::kernels::build::Work;
use crate::ops::team::Team;
use crate::ops::{OperatorSet, Scratch};
use crate::policy::{DecideError, Observation};

/// Runs every operator for one observation; those that are steps of policies only where `STEPS` says so.
pub(crate) struct Execution<'p, 'a, 's, S: OperatorSet, const STEPS: bool> {
    pub(crate) plan: &'p Plan<'a, S>,
    pub(crate) observation: &'p Observation<'p>,
    pub(crate) scratch: &'p mut Scratch<'s>,
}

impl<S: OperatorSet, const STEPS: bool> Work for Execution<'_, '_, '_, S, STEPS> {
    type Output = Result<(), DecideError>;

    #[inline(always)]
    fn run(self, kernels: impl Kernels) -> Self::Output {
        let Self { plan, observation, scratch } = self;
        // Where no entity exists there is no row either, not even an agent's own.
        let skip =
            !STEPS && plan.header.network == Network::Entities && observation.visible.is_empty();
        for op in plan.program.ops().skip(usize::from(skip)) {
            op.run::<S, STEPS>(kernels, plan.weights, observation, scratch)?;
        }
        Ok(())
    }
}

/// Runs every operator for all members of a team.
pub(crate) struct TeamExecution<'p, 'a, 's, S: OperatorSet> {
    pub(crate) plan: &'p Plan<'a, S>,
    pub(crate) observations: &'p [Observation<'p>],
    pub(crate) team: &'p mut Team<'s>,
}

impl<S: OperatorSet> Work for TeamExecution<'_, '_, '_, S> {
    type Output = Result<(), DecideError>;

    #[inline(always)]
    fn run(self, kernels: impl Kernels) -> Self::Output {
        for op in self.plan.program.ops() {
            op.run_team::<S>(kernels, self.plan.weights, self.observations, self.team)?;
        }
        Ok(())
    }
}
