//! What a look at a machine or a domain comes to.

use crate::error::Error;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// As it should be.
    Fine,
    /// Works, but is worth a look.
    Warning,
    /// Something will not work.
    Problem,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub check: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What was found.
    pub found: String,
    /// What to do about it; empty where nothing is to be done.
    pub advice: &'static str,
}

impl Finding {
    pub(super) fn new(
        severity: Severity,
        check: &'static str,
        found: impl Into<String>,
        advice: &'static str,
    ) -> Self {
        Self { check, severity, found: found.into(), advice }
    }

    pub(super) fn fine(check: &'static str, found: impl Into<String>) -> Self {
        Self::new(Severity::Fine, check, found, "")
    }

    /// What a check came to.
    pub(super) fn of(check: &'static str, result: Result<(), Error>, advice: &'static str) -> Self {
        match result {
            Ok(()) => Self::fine(check, "enough for a team"),
            Err(error) => Self::new(Severity::Problem, check, error.to_string(), advice),
        }
    }
}
