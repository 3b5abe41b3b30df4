//! Ctrl-C and SIGTERM.

use sortie_ipc::Stop;

use crate::failure::{Exit, Failure};

/// A flag that the first signal sets; one that comes half a second later, or after that, ends the program at once.
pub fn stop_on_signals() -> Result<Stop, Failure> {
    Stop::on_signals()
        .map_err(|error| Failure::new(Exit::InputOutput, format!("signal handlers: {error}")))
}
