//! Its benchmark counts the instructions of decisions.
