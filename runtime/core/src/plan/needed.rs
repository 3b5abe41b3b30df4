//! The operators that plans need.

use super::header::records;
use crate::ops::OpKind;

/// The operators of a plan, or of several, found where they are compiled in: a program with nothing but these links no
/// others.
///
/// ```
/// use sortie_core::include_plan;
/// use sortie_core::operators::{Needed, OpKind, OperatorSet};
/// use sortie_core::plan::Plan;
///
/// const PLAN: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.0.plan");
///
/// #[derive(Clone, Copy, Debug)]
/// struct OfPlan;
///
/// impl OperatorSet for OfPlan {
///     const OPERATORS: &[OpKind] = const { &Needed::by(PLAN) }.kinds();
/// }
///
/// Plan::<OfPlan>::load_with(PLAN)?;
/// # Ok::<(), sortie_core::plan::PlanError>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Needed {
    kinds: [OpKind; OpKind::ALL.len()],
    count: usize,
}

impl Needed {
    /// What the program of a plan names. Of what is no plan that may be nothing: loading refuses it.
    pub const fn by(plan: &[u8]) -> Self {
        Self::by_all(&[plan])
    }

    /// The same of several plans.
    pub const fn by_all(plans: &[&[u8]]) -> Self {
        let mut kinds = [OpKind::EmbedEntities; OpKind::ALL.len()];
        let (mut places, mut all, mut count) = (kinds.as_mut_slice(), OpKind::ALL, 0);
        while let [place, later @ ..] = places {
            let Some((kind, others)) = next(plans, all) else { break };
            *place = kind;
            (places, all, count) = (later, others, count + 1);
        }
        Self { kinds, count }
    }

    /// The kinds, in the order of their numbers.
    pub const fn kinds(&self) -> &[OpKind] {
        match self.kinds.split_at_checked(self.count) {
            Some((kinds, _)) => kinds,
            None => &[],
        }
    }
}

/// The first of some kinds that a program of the plans names, and those behind it.
const fn next<'k>(plans: &[&[u8]], mut kinds: &'k [OpKind]) -> Option<(OpKind, &'k [OpKind])> {
    while let [kind, others @ ..] = kinds {
        let mut rest = plans;
        while let [plan, later @ ..] = rest {
            if names(plan, *kind) {
                return Some((*kind, others));
            }
            rest = later;
        }
        kinds = others;
    }
    None
}

/// Whether a record of the plan's program is of this kind.
const fn names(plan: &[u8], kind: OpKind) -> bool {
    let mut rest = records(plan);
    while let Some((&[low, high, words, more_words], fields)) = rest.split_first_chunk() {
        if u16::from_le_bytes([low, high]) == kind as u16 {
            return true;
        }
        let bytes = 4 * u16::from_le_bytes([words, more_words]) as usize;
        rest = match fields.split_at_checked(bytes) {
            Some((_, rest)) => rest,
            None => &[],
        };
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::{FeedForward, Int8FeedForward, OperatorSet};

    #[test]
    fn a_plan_needs_what_its_program_names() {
        let agent = include_bytes!("../../../../tests/golden/plans/agent-2.0.plan");
        let int8 = include_bytes!("../../../../tests/golden/plans/agent-int8-2.2.plan");
        assert_eq!(Needed::by(agent).kinds(), FeedForward::OPERATORS);
        let mut want = Int8FeedForward::OPERATORS.to_vec();
        want.sort_by_key(|kind| *kind as u16);
        assert_eq!(Needed::by(int8).kinds(), want);
        want.extend(FeedForward::OPERATORS);
        want.sort_by_key(|kind| *kind as u16);
        want.dedup();
        assert_eq!(Needed::by_all(&[int8, agent]).kinds(), want);
        assert!(Needed::by_all(&[]).kinds().is_empty());
        for len in 0..agent.len() {
            assert!(Needed::by(&agent[..len]).kinds().len() <= want.len(), "{len}");
        }
    }
}
