//! The guards of a served plan: what they have let through, and what is given out instead.

use sortie_core::plan::{GuardFallback, GuardState, Guards, Trip};
use sortie_core::wire::{Reason, ServedFormat};

use super::Fallback;
use crate::error::Error;

/// Why the policy's answer is not given out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Undecided {
    /// It has none.
    ByPolicy(Reason),
    /// A guard has tripped.
    ByGuard(Trip),
}

impl Undecided {
    /// What clients are told.
    pub(super) fn reason(&self) -> Reason {
        match self {
            Self::ByPolicy(reason) => *reason,
            Self::ByGuard(_) => Reason::Guard,
        }
    }

    /// Which guard.
    pub(super) fn trip(&self) -> Option<Trip> {
        match self {
            Self::ByPolicy(_) => None,
            Self::ByGuard(trip) => Some(*trip),
        }
    }
}

impl From<Reason> for Undecided {
    fn from(reason: Reason) -> Self {
        Self::ByPolicy(reason)
    }
}

impl From<Trip> for Undecided {
    fn from(trip: Trip) -> Self {
        Self::ByGuard(trip)
    }
}

/// What was answered last, and what may be done now.
pub(super) struct Last<'a> {
    pub(super) outputs: &'a mut [f32],
    pub(super) action: Option<u16>,
    pub(super) available: &'a [u16],
}

/// A plan's guards, if it has any, and what they remember of a robot.
pub(super) struct Guarding<'g> {
    guards: Option<Guards<'g>>,
    /// Whether outputs are scores of actions, of which nothing is compared.
    chooses: bool,
    state: GuardState<Vec<f32>>,
}

impl<'g> Guarding<'g> {
    /// Takes all memory that it ever needs.
    ///
    /// # Errors
    /// The guards are about other inputs or outputs.
    pub(super) fn new(guards: Option<Guards<'g>>, format: &ServedFormat) -> Result<Self, Error> {
        let chooses = format.actions() != 0;
        if let Some(guards) = &guards {
            let not_served = |problem: String| Error::NotServed { problem };
            guards
                .check_fits(format.inputs(), format.outputs())
                .map_err(|error| not_served(error.to_string()))?;
            if chooses && (guards.limits_outputs() || guards.safe_outputs().len() > 0) {
                let problem = "its guards are about outputs, and it chooses among actions";
                return Err(not_served(problem.to_owned()));
            }
        }
        Ok(Self { guards, chooses, state: GuardState::new(vec![0.0; format.outputs()]) })
    }

    /// A robot that nobody has commanded yet.
    pub(super) fn begin(&mut self) {
        self.state.begin();
    }

    /// Before the network. `age_ns` is the time since the observation was sent.
    pub(super) fn check_inputs(&self, inputs: &[f32], age_ns: u64) -> Result<(), Trip> {
        match &self.guards {
            Some(guards) => guards.check_inputs(&self.state, inputs, Some(age_ns)),
            None => Ok(()),
        }
    }

    /// Behind the network: says by which guard outputs were brought back to their limits.
    pub(super) fn check_outputs(&mut self, outputs: &mut [f32]) -> Result<Option<Trip>, Trip> {
        match &self.guards {
            Some(guards) if !self.chooses => guards.check_outputs(&mut self.state, outputs),
            _ => Ok(None),
        }
    }

    /// Replaces the last outputs; returns the action. What the plan says counts before what the server was started with.
    pub(super) fn fall_back(
        &mut self,
        undecided: &Undecided,
        callers: Fallback,
        last: Last<'_>,
    ) -> Option<u16> {
        let Last { outputs, action, available } = last;
        let Some(guards) = &self.guards else { return callers.apply(outputs, action, available) };
        let trip = undecided.trip().unwrap_or(Trip::Undecided);
        let fallback = match guards.fallback() {
            GuardFallback::Unsaid => callers,
            GuardFallback::Hold => Fallback::Hold,
            GuardFallback::Zero => Fallback::Zero,
            GuardFallback::Safe => {
                guards.fall_back(&mut self.state, trip, outputs);
                return None;
            }
        };
        let action = fallback.apply(outputs, action, available);
        guards.fell_back(&mut self.state, trip, outputs);
        action
    }
}
