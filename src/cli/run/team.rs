//! The processes of a team: this program again, once for each, and how they share the cores of the machine.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use clap::Args;
use sortie_core::wire::Role;
use sortie_ipc::{Charge, RealTime};

use crate::allocation::AllocatorChoice;
use crate::allocator::ProposalArguments;
use crate::failure::{Exit, Failure};
use crate::policy::Backend;

/// What all processes of a team are started with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Team<'a> {
    pub bundle: &'a Path,
    pub domain: &'a str,
    /// Who assigns agents to subtasks, if anybody does.
    pub allocation: Option<AllocatorChoice>,
    pub backend: Backend,
    pub proposals: ProposalArguments,
    pub seed: u64,
    /// Whether every agent gets its own frame.
    pub private: bool,
    /// Whether they join a team of another bundle or allocation rule.
    pub mixes_teams: bool,
    /// Process with which they end.
    pub parent: Option<u32>,
}

/// `agent 0`, `agents 1, 2`.
fn named_agents(agents: &[u16]) -> String {
    let list = agents.iter().map(u16::to_string).collect::<Vec<_>>().join(", ");
    format!("agent{} {list}", if agents.len() == 1 { "" } else { "s" })
}

impl Team<'_> {
    /// The runner of these agents.
    pub(super) fn runner(&self, agents: &[u16]) -> Charge {
        let list = agents.iter().map(u16::to_string).collect::<Vec<_>>().join(",");
        let mut command = self.command("runner");
        command.arg("--agents").arg(&list);
        Charge {
            name: format!("the runner of {}", named_agents(agents)),
            role: Role::Runner,
            agents: agents.iter().fold(0, |seats, agent| seats | 1 << agent),
            command,
        }
    }

    /// An allocator, one of several that differ by name only; none for a team that knows of no subtasks.
    pub(super) fn allocator(&self, name: String) -> Option<Charge> {
        self.allocation?;
        Some(Charge { name, role: Role::Allocator, agents: 0, command: self.command("allocator") })
    }

    /// This program as a process of the team.
    pub(super) fn command(&self, role: &str) -> Command {
        // A program that was replaced while it runs is still itself under this name.
        let mut command = Command::new("/proc/self/exe");
        command.arg("process").arg(role).arg(self.bundle);
        command.arg("--domain").arg(self.domain);
        if let Some(parent) = self.parent {
            command.arg("--parent").arg(parent.to_string());
        }
        if let Some(allocation) = self.allocation {
            command.arg("--allocation").arg(allocation.name());
        }
        command.arg("--backend").arg(self.backend.name());
        command.args(self.proposals.flag());
        command.arg("--seed").arg(self.seed.to_string());
        if self.private {
            command.arg("--private");
        }
        if self.mixes_teams {
            command.arg("--mix-teams");
        }
        command.stdin(Stdio::null()).stdout(Stdio::null());
        command
    }
}

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
