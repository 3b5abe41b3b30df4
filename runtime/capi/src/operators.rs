//! Which operators the library has.

#[cfg(feature = "agents")]
use sortie_core::operators::AllOperators as Operators;
#[cfg(not(feature = "agents"))]
use sortie_core::operators::Policies as Operators;

/// A plan, run by the operators of this library.
pub(crate) type Plan<'a> = sortie_core::plan::Plan<'a, Operators>;
