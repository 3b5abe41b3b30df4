//! What came of observations.

use sortie_core::wire::AnswerStatus;

/// What a server did since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServeCounters {
    /// Answers of the policy, late ones among them.
    pub answered: u64,
    /// Answers of the policy after the deadline.
    pub late: u64,
    /// Observations on which it could not decide.
    pub fallbacks: u64,
    /// Messages that are no observations of this policy.
    pub refused: u64,
    /// Observations that newer ones overtook.
    pub missed: u64,
    /// Clients that came.
    pub sessions: u64,
    /// Times that the recurrent state began anew.
    pub resets: u64,
    /// Answers that could not be sent.
    pub failed_sends: u64,
}

/// One observation that was answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Served {
    /// Its number in the session, from 1.
    pub seq: u64,
    /// What became of it.
    pub status: AnswerStatus,
    /// From its sending to this process running.
    pub wake_ns: u64,
    /// The decision alone.
    pub decide_ns: u64,
}
