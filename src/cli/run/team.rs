//! The processes of a team: this program again, once for each, and how they share the cores of the machine.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use clap::Args;
use sortie_core::wire::Role;
use sortie_ipc::{Charge, RealTime};

use crate::allocation::AllocatorChoice;
use crate::allocator::ProposalArguments;
use crate::failure::{Exit, Failure, Outcome};
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
    /// Whose signatures each of them asks for, of what it loads itself.
    pub trust: Option<&'a Path>,
    /// Process with which they end.
    pub parent: Option<u32>,
}

/// `agent 0`, `agents 1, 2`.
fn named_agents(agents: &[u16]) -> String {
    format!("agent{} {}", if agents.len() == 1 { "" } else { "s" }, listed(agents, ", "))
}

fn listed(agents: &[u16], between: &str) -> String {
    agents.iter().map(u16::to_string).collect::<Vec<_>>().join(between)
}

impl Team<'_> {
    /// The runner of these agents.
    pub(super) fn runner(&self, agents: &[u16]) -> Charge {
        self.seated("runner", agents)
    }

    /// Who stands for the runner of these agents, which is on another host.
    pub(super) fn stand_in(&self, agents: &[u16]) -> Charge {
        self.seated("stand-in", agents)
    }

    /// A process that holds the seats of these agents.
    fn seated(&self, what: &str, agents: &[u16]) -> Charge {
        let mut command = self.command(what);
        command.arg("--agents").arg(listed(agents, ","));
        Charge {
            name: format!("the {what} of {}", named_agents(agents)),
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
        if let Some(keys) = self.trust {
            command.arg("--trust").arg(keys);
        }
        command.stdin(Stdio::null()).stdout(Stdio::null());
        command
    }
}

/// Agents that are left out.
#[derive(Clone, Debug, Default, Args)]
pub(super) struct Absentees {
    /// Agents for which nobody acts: bodies that stand there, left out of allocations
    #[arg(long, value_delimiter = ',', value_name = "AGENTS")]
    absent: Vec<u16>,
}

impl Absentees {
    /// Bit a for agent a.
    pub(super) fn seats(&self) -> u64 {
        self.absent
            .iter()
            .fold(0, |seats, agent| seats | 1_u64.checked_shl((*agent).into()).unwrap_or(0))
    }

    /// Refuses agents that do not exist.
    pub(super) fn check(&self, agents: usize) -> Outcome {
        match self.absent.iter().find(|agent| usize::from(**agent) >= agents) {
            None => Ok(()),
            Some(agent) => {
                let message =
                    format!("there is no agent {agent} to be absent, but {agents} from 0 on");
                Err(Failure::new(Exit::Usage, message))
            }
        }
    }

    /// The groups of agents that processes act for, without these.
    pub(super) fn leave_out(&self, groups: Vec<Vec<u16>>) -> Vec<Vec<u16>> {
        without(groups, &self.absent)
    }

    /// As a flag for a world.
    pub(super) fn flag(&self) -> Option<String> {
        (!self.absent.is_empty()).then(|| format!("--absent={}", listed(&self.absent, ",")))
    }
}

/// Groups of agents without these.
pub(super) fn without(mut groups: Vec<Vec<u16>>, left_out: &[u16]) -> Vec<Vec<u16>> {
    groups.iter_mut().for_each(|group| group.retain(|agent| !left_out.contains(agent)));
    groups.retain(|group| !group.is_empty());
    groups
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
    fn absent_agents_have_no_runner_and_the_world_is_told() {
        let absentees = Absentees { absent: vec![4, 0] };
        let groups = vec![vec![0, 2, 4], vec![1, 3], vec![0]];
        assert_eq!(absentees.leave_out(groups), [vec![2], vec![1, 3]]);
        assert_eq!(
            (absentees.seats(), absentees.flag().as_deref()),
            (0b1_0001, Some("--absent=4,0"))
        );
        assert!(absentees.check(5).is_ok());
        let refused = absentees.check(4).map_err(|failure| failure.message);
        assert_eq!(refused, Err("there is no agent 4 to be absent, but 4 from 0 on".to_string()));
        assert_eq!(Absentees::default().flag(), None);
    }

    #[test]
    fn processes_are_told_what_differs_from_the_default() {
        let scheduling = Scheduling { rt: Some(10), linger_us: Some(0) };
        assert_eq!(scheduling.flags(Some(1)), ["--rt", "10", "--linger-us", "0", "--core", "1"]);
        let usual = Scheduling { rt: None, linger_us: None };
        assert_eq!(usual.flags(None), [""; 0]);
    }
}
