//! What every operator says of itself.

use super::team::Team;
use super::{Places, Scratch, Sizes};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// One kind of operator. Where it has nothing to say to a question, the answer is a refusal: an operator that
/// computes nothing does not succeed by being left out.
pub(super) trait Operator {
    /// The layout of the weights in plans that have the operator; `None` = any.
    const LAYOUT: Option<u32>;

    /// Whether every place lies inside and sizes agree.
    fn check(&self, sizes: &Sizes) -> bool;

    /// Multiply-adds with `visible` entities, zeros not left out; none where there is no product.
    fn multiply_adds(&self, visible: u64) -> u64 {
        let _ = visible;
        0
    }

    /// What the operator reads of a policy's values.
    fn reads(&self) -> Places {
        Places::default()
    }

    /// What it writes of them; nothing where it stands in no policy.
    fn writes(&self) -> Places {
        Places::default()
    }

    /// Runs as a step of a program.
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let _ = (kernels, weights, observation, scratch);
        Err(DecideError::BadLength)
    }

    /// Whether the operator can work for a team, whose members' own places lie behind the first `shared` floats.
    ///
    /// Operators over all entities know no single agent.
    fn works_for_teams(&self, shared: u32) -> bool {
        let _ = shared;
        false
    }

    /// As [`Self::run`] for all members of a team, whose observations are of one frame.
    fn run_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        observations: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let _ = (kernels, weights, observations, team);
        Err(DecideError::BadLength)
    }
}
