//! How a team's processes share the machine's cores.

use std::time::Duration;

use clap::Args;
use sortie_ipc::RealTime;

use crate::failure::{Exit, Failure};

/// What processes ask the system for.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct Scheduling {
    /// Real-time priority of world, runners and allocators: before all ordinary work, in memory that stays
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(1..=99))]
    pub(super) rt: Option<u8>,
    /// Microseconds that waits of world and runners linger before they sleep [default: 100 with --rate 0, else 0]
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    pub(super) linger_us: Option<u64>,
}

impl Scheduling {
    pub(super) fn linger(&self) -> Option<Duration> {
        self.linger_us.map(Duration::from_micros)
    }

    pub(super) fn real_time(&self, core: Option<usize>) -> RealTime {
        RealTime { priority: self.rt, core }
    }

    /// The flags of one process.
    pub(super) fn flags(&self, core: Option<usize>) -> Vec<String> {
        let mut flags = Vec::new();
        let mut flag = |name: &str, value: Option<String>| {
            if let Some(value) = value {
                flags.extend([format!("--{name}"), value]);
            }
        };
        flag("rt", self.rt.map(|priority| priority.to_string()));
        flag("linger-us", self.linger_us.map(|linger| linger.to_string()));
        flag("core", core.map(|core| core.to_string()));
        flags
    }
}

/// Refuses to give each of so many processes a core of its own where there are fewer.
pub(super) fn check_cores(processes: usize, cores: usize) -> Result<(), Failure> {
    if processes <= cores {
        return Ok(());
    }
    let message = format!(
        "world and runners are {processes} processes on {cores} cores: leave out --pin, or --isolate"
    );
    Err(Failure::new(Exit::Usage, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_are_told_what_differs_from_the_default() {
        let scheduling = Scheduling { rt: Some(10), linger_us: Some(0) };
        assert_eq!(scheduling.flags(Some(1)), ["--rt", "10", "--linger-us", "0", "--core", "1"]);
        let usual = Scheduling { rt: None, linger_us: None };
        assert_eq!(usual.flags(None), [""; 0]);
    }
}
