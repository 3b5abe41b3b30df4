//! The processes of a team: this program again, once for each.

use std::path::Path;
use std::process::{Command, Stdio};

use sortie_core::wire::Role;
use sortie_ipc::Charge;

use crate::allocation::AllocatorChoice;
use crate::policy::Backend;
use crate::proposals::ProposalArguments;

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
