//! The plan that the program is built around.

use sortie_core::include_plan;
use sortie_core::operators::{Needed, OpKind, OperatorSet};

pub(crate) const PLAN: &[u8] = include_plan!(env!("SORTIE_PLAN"));

/// The operators of the plan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OfPlan;

impl OperatorSet for OfPlan {
    const OPERATORS: &[OpKind] = const { &Needed::by(PLAN) }.kinds();
}
