//! How a team's processes share the machine's cores.

use std::time::Duration;

use clap::Args;
use sortie_ipc::RealTime;

use crate::failure::{Exit, Failure};
use crate::output::tell;

/// What processes ask the system for.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(super) struct Scheduling {
    /// Real-time priority of world, runners and allocators: before all ordinary work, in memory that stays
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(1..=99))]
    pub(super) rt: Option<u8>,
    /// Microseconds that world and runners look for a message before they sleep; with --rt or --pin only
    #[arg(long, default_value_t = 0, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    pub(super) spin_us: u64,
}

impl Scheduling {
    pub(super) fn spin(&self) -> Duration {
        Duration::from_micros(self.spin_us)
    }

    pub(super) fn real_time(&self, core: Option<usize>) -> RealTime {
        RealTime { priority: self.rt, core }
    }

    /// The same for a team of so many processes that would spin, or why not.
    pub(super) fn for_team(
        mut self,
        spinning: usize,
        cores: usize,
        is_pinned: bool,
    ) -> Result<Self, Failure> {
        if self.spin_us > 0 && self.rt.is_none() && !is_pinned {
            tell("warning: --spin-us is left out: without --rt or --pin it takes the others' time");
            self.spin_us = 0;
        }
        if (self.spin_us > 0 || is_pinned) && spinning > cores {
            let message = format!(
                "world and runners are {spinning} processes on {cores} cores: leave out --spin-us and --pin, or --isolate"
            );
            return Err(Failure::new(Exit::Usage, message));
        }
        Ok(self)
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
        flag("spin-us", (self.spin_us > 0).then(|| self.spin_us.to_string()));
        flag("core", core.map(|core| core.to_string()));
        flags
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spinning_takes_a_core_for_each_process() {
        let spins = Scheduling { rt: Some(10), spin_us: 50 };
        assert_eq!(spins.for_team(2, 2, false).unwrap().spin_us, 50);
        assert_eq!(spins.for_team(3, 2, false).unwrap_err().exit, Exit::Usage);
        let ordinary = Scheduling { rt: None, ..spins };
        assert_eq!(ordinary.for_team(2, 2, true).unwrap().spin_us, 50);
        assert_eq!(ordinary.for_team(9, 2, false).unwrap().spin_us, 0);
        assert_eq!(spins.flags(Some(1)), ["--rt", "10", "--spin-us", "50", "--core", "1"]);
        assert_eq!(Scheduling::default().flags(None), [""; 0]);
    }
}
