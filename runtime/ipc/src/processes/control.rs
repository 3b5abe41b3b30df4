//! What every process answers to those who tell it what to do.

use sortie_core::roles::Counters;
use sortie_core::wire::{Command, ControlRep, ControlReq, ControlStatus};

use crate::iox::set_log_level;
use crate::process_info::ProcessInfo;

/// A process that can be told what to do.
pub(crate) trait Controlled {
    /// Hash of the domain's contract and shape.
    fn schema(&self) -> u64;

    /// The newest tick that it knows.
    fn tick(&self) -> u64;

    fn info(&self) -> ProcessInfo;

    fn counters_mut(&mut self) -> &mut Counters;

    /// Obeys a command of its role, to which `text` belongs.
    fn obey(&mut self, command: Command, text: &str) -> ControlStatus;
}

/// Obeys a request, if it is this process that is meant.
pub(crate) fn answer(process: &mut impl Controlled, request: &ControlReq) -> ControlRep {
    let status = status(process, request);
    let answer = request.answer(process.schema(), status, process.tick());
    answer.with_text(&process.info().to_string())
}

fn status(process: &mut impl Controlled, request: &ControlReq) -> ControlStatus {
    if !request.fits(process.schema()) {
        process.counters_mut().schema_rejects += 1;
        return ControlStatus::Foreign;
    }
    if request.arg != 0 && request.arg != std::process::id() {
        return ControlStatus::NotMine;
    }
    match Command::from_number(request.cmd) {
        None => ControlStatus::NotSupported,
        Some(Command::Info) => ControlStatus::Done,
        Some(Command::SetLogLevel) if set_log_level(request.arg64) => ControlStatus::Done,
        Some(Command::SetLogLevel) => ControlStatus::BadArgument,
        Some(command) => process.obey(command, request.text()),
    }
}
