//! How novel it is to be where agents are, what that is worth, and what observations say of where they are: what both
//! learners of MA-Exp explore by.

pub(crate) mod counts;
pub(crate) mod intrinsic;
pub(crate) mod places;
