//! Why a team cannot play.

use core::fmt;

use sortie_core::link::LinkError;
use sortie_core::plan::PlanError;
use sortie_core::roles::{AllocatorError, WorldError};
use sortie_core::wire::LayoutError;
use sortie_core::{AllocateError, DecideError};
use sortie_envs::EnvironmentError;

/// Why a team cannot play, or not go on.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StageError {
    /// A plan is damaged, or another network's.
    Plan(PlanError),
    /// There are no frames of this shape.
    Layout(LayoutError),
    /// The world cannot be made.
    Environment(EnvironmentError),
    /// The environment has no rules of allocation that read frames.
    NoRules,
    /// The rules of an agent's options do not hold together.
    NoOptions,
    /// The world ended.
    World(WorldError),
    /// The allocator ended.
    Allocator(AllocatorError),
    /// A runner ended.
    Link(LinkError),
    /// A plan refuses an observation.
    Decide(DecideError),
    /// The network that values teams refuses a state.
    Allocate(AllocateError),
    /// Everybody waits for somebody else.
    Stalled,
}

impl fmt::Display for StageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plan(error) => write!(f, "a plan cannot be used: {error}"),
            Self::Layout(error) => write!(f, "{error}"),
            Self::Environment(error) => write!(f, "{error}"),
            Self::NoRules => f.write_str("the environment has no rules of allocation"),
            Self::NoOptions => f.write_str("the rules of the agent's options do not hold together"),
            Self::World(error) => write!(f, "{error}"),
            Self::Allocator(error) => write!(f, "{error}"),
            Self::Link(error) => write!(f, "{error}"),
            Self::Decide(error) => write!(f, "{error}"),
            Self::Allocate(error) => write!(f, "{error}"),
            Self::Stalled => f.write_str("everybody waits for somebody else"),
        }
    }
}

impl core::error::Error for StageError {}

macro_rules! from {
    ($($error:ident => $variant:ident),+ $(,)?) => {$(
        impl From<$error> for StageError {
            fn from(error: $error) -> Self {
                Self::$variant(error)
            }
        }
    )+};
}
from!(
    PlanError => Plan,
    LayoutError => Layout,
    EnvironmentError => Environment,
    WorldError => World,
    AllocatorError => Allocator,
    LinkError => Link,
    DecideError => Decide,
    AllocateError => Allocate,
);
