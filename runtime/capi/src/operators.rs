//! Which operators the library has.

/// Every one.
#[cfg(feature = "agents")]
pub(crate) use sortie_core::ops::AllOperators as Operators;
/// Those of policies over inputs of fixed sizes.
#[cfg(not(feature = "agents"))]
pub(crate) use sortie_core::ops::Policies as Operators;
